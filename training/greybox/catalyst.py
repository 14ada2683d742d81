"""A catalyst and its downstream sensor with ten constants, as one compiled loop, and their fit.

With x = 1 - 1/lambda + offset, oxygen enters at 0.23 · air flow · x. ``CELLS`` equal cells follow
each other. The part f^fill of lean gas passes a cell that is filled to the part f, and
(1 - f)^release of rich gas; the rest is stored as far as there is room (Brandt, Wang and Grizzle,
IEEE Trans. Control Systems Technology 8, 2000). The gas over the last cell is lean where that is
full and rich where it is empty. A switching sensor sees the gas with a dead time, a shift by
hydrogen and a lag per direction (Auckenthaler, ETH 16018, 2005).

Robust least squares (soft L1) of the voltage in free run, from several capacities and sensors. Only
samples with a warm brick, at moderate flow, and ``SETTLE_S`` after a break count. Standard errors
are those of a sandwich over blocks of ``BLOCK_S``, since errors of the model repeat within a block.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from monitor.base.config import shipped
from monitor.base.errors import RecordingError
from monitor.base.types import BoolArray, FloatArray
from training.greybox.chain import ConstantRange
from training.greybox.fit.constants import sandwich, with_errors
from training.greybox.fit.drive import block_numbers, until
from training.recordings.recording import Recording
from training.recordings.samples.rows import hold

CELLS: Final = 4
SUBSTEPS: Final = 4  # of a sample: a small cell fills within one
OXYGEN_IN_AIR: Final = 0.23  # mass fraction
EQUILIBRIUM_PHI: Final = 0.0014  # x over a full last cell, and its negative over an empty one
WIDTH_PHI: Final = 0.0015  # of the switching characteristic
X_MOST: Final = 0.999
OUTPUT: Final = "downstream_voltage_v"
NEEDED: Final = (OUTPUT, "lambda_measured", "maf_kg_h")
SCHEMA: Final = "o2train.catalyst/1"
SETTLE_S: Final = 20.0
BLOCK_S: Final = 30.0
SAMPLES_LEAST: Final = 600
ROBUST_V: Final = 0.1  # from here on an error of the voltage counts less than its square


class Catalyst(NamedTuple):
    """The constants."""

    capacity_g: float = 0.3
    fill: float = 5.0
    release: float = 5.0
    offset_phi: float = 0.0  # added to the upstream reading
    hydrogen_phi: float = 0.001
    delay_s: float = 0.1
    to_rich_s: float = 0.1
    to_lean_s: float = 0.15
    low_v: float = 0.07
    span_v: float = 0.72


RANGES: Final[dict[str, ConstantRange]] = {  # of each constant, in the order of ``Catalyst``
    "capacity_g": ConstantRange("g", 0.005, 3.0, is_log=True),
    "fill": ConstantRange("", 0.5, 30.0, is_log=True),
    "release": ConstantRange("", 0.5, 30.0, is_log=True),
    "offset_phi": ConstantRange("1 - 1/lambda", -0.06, 0.06),
    "hydrogen_phi": ConstantRange("1 - 1/lambda", -0.003, 0.005),
    "delay_s": ConstantRange("s", 0.0, 2.5),
    "to_rich_s": ConstantRange("s", 0.01, 4.0, is_log=True),
    "to_lean_s": ConstantRange("s", 0.01, 4.0, is_log=True),
    "low_v": ConstantRange("V", -0.1, 0.45),
    "span_v": ConstantRange("V", 0.05, 1.2),
}
STARTS: Final = tuple(
    Catalyst(capacity_g=grams, to_rich_s=lag_s, to_lean_s=lag_s)
    for grams, lag_s in ((0.03, 0.1), (0.12, 0.1), (0.5, 0.1), (0.06, 1.0), (0.4, 1.0))
)
IS_LOG: Final = tuple(each.is_log for each in RANGES.values())
HELD_SHARE: Final = 0.02  # of the range; a constant nearer to its bound ended at it


@njit(cache=True)
def volts(x: FloatArray, air_g_s: FloatArray, period_s: float, c: Catalyst) -> FloatArray:
    """Return the voltage (n,) of a catalyst that begins half full; x is 1 - 1/lambda upstream."""
    n, step_s = len(x), period_s / SUBSTEPS
    room = c.capacity_g / CELLS
    held = np.full(CELLS, 0.5)
    steady, out = np.full(n, 0.5), np.empty(n)
    late = c.delay_s / period_s
    whole = int(late)
    part = late - whole
    rich = 0.5
    for k in range(n):
        entering = min(x[k] + c.offset_phi, X_MOST)
        seen = 0.0
        mass = max(OXYGEN_IN_AIR * air_g_s[k] * step_s, 1e-9)
        for _ in range(SUBSTEPS):
            gas = entering
            for j in range(CELLS):
                f = held[j]
                if gas > 0.0:
                    taken = min(mass * gas * (1.0 - f**c.fill), (1.0 - f) * room)
                else:
                    taken = max(mass * gas * (1.0 - (1.0 - f) ** c.release), -f * room)
                held[j] = min(max(f + taken / room, 0.0), 1.0)
                gas -= taken / mass
            seen += gas / SUBSTEPS
        seen += EQUILIBRIUM_PHI * (2.0 * held[CELLS - 1] - 1.0) - c.hydrogen_phi
        steady[k] = 0.5 - 0.5 * np.tanh(seen / (2.0 * WIDTH_PHI))
        near, far = max(k - whole, 0), max(k - whole - 1, 0)
        now = (1.0 - part) * steady[near] + part * steady[far]
        tau_s = c.to_rich_s if now > rich else c.to_lean_s
        rich += (now - rich) * (1.0 - np.exp(-period_s / tau_s))
        out[k] = c.low_v + c.span_v * rich
    return out


@dataclass(frozen=True, slots=True)
class CatalystDrive:
    """The fit's signals of one recording, (n,) each."""

    name: str
    period_s: float
    x: FloatArray
    air_g_s: FloatArray
    measured_v: FloatArray
    counts: BoolArray


@dataclass(frozen=True, slots=True)
class FittedCatalyst:
    """The content of the file: the constants, and how well the voltage is reproduced."""

    schema: str
    constants: dict[str, dict[str, Any]]  # each: value, standard_error, unit, at_bound
    rmse_v: float
    samples: int
    recordings: list[str]


def drive_of(recording: Recording) -> CatalystDrive:
    """Return the fit's signals; raises RecordingError if a signal is missing."""
    config = shipped().catalyst
    missing = [name for name in NEEDED if name not in recording.known]
    if missing:
        raise RecordingError(
            f"{recording.path}: has no {', '.join(missing)}, the catalyst needs it"
        )
    period_s = recording.period_ns * 1e-9
    columns = np.column_stack([recording.column(name) for name in NEEDED])
    good = np.asarray(np.isfinite(columns).all(axis=1))
    measured_v, lambda_, maf_kg_h = (hold(np.where(good, column, np.nan)) for column in columns.T)
    air_g_s = maf_kg_h / 3.6
    warm = recording.t_s >= config.warm_up_s
    if "catalyst_temperature_degc" in recording.known:
        degc = recording.column("catalyst_temperature_degc")
        warm = np.where(np.isfinite(degc), degc >= config.warm_degc, warm)
    counts = good & warm & (air_g_s <= config.flow_most_g_s)
    counts &= ~until(~good, SETTLE_S, period_s)
    counts[: round(SETTLE_S / period_s) + 1] = False
    x = 1.0 - 1.0 / np.maximum(lambda_, 0.1)
    return CatalystDrive(recording.path.name, period_s, x, air_g_s, measured_v, counts)


def fit(drives: Sequence[CatalystDrive], starts: Sequence[Catalyst] = STARTS) -> FittedCatalyst:
    """Return the constants of the best voltage in free run; RecordingError for too few samples."""
    n = sum(int(d.counts.sum()) for d in drives)
    if n < SAMPLES_LEAST:
        names = ", ".join(d.name for d in drives)
        raise RecordingError(
            f"{names}: {n} samples with a warm catalyst, at least {SAMPLES_LEAST} are wanted"
        )
    _, lows, highs, *_ = zip(*RANGES.values(), strict=True)
    low, high = _transformed(lows), _transformed(highs)

    def residual(theta: FloatArray) -> FloatArray:
        c = _constants(theta)
        read = [volts(d.x, d.air_g_s, d.period_s, c) - d.measured_v for d in drives]
        return np.concatenate([e[d.counts] for e, d in zip(read, drives, strict=True)])

    found = [
        least_squares(
            residual,
            np.clip(_transformed(list(start)), low + 1e-9, high - 1e-9),
            bounds=(low, high),
            loss="soft_l1",
            f_scale=ROBUST_V,
            x_scale=0.1 * (high - low),
            diff_step=np.full(len(RANGES), 1e-4),
            max_nfev=60,
        )
        for start in starts
    ]
    best = min(found, key=lambda each: each.cost)
    share = np.minimum(best.x - low, high - best.x) / (high - low)
    errors = _errors(drives, best.x, np.asarray(best.jac), residual(best.x))
    rows = with_errors(_constants(best.x), errors, RANGES)
    pairs = zip(rows.items(), share.tolist(), strict=True)
    return FittedCatalyst(
        schema=SCHEMA,
        constants={name: row | {"at_bound": near < HELD_SHARE} for (name, row), near in pairs},
        rmse_v=float(np.sqrt((residual(best.x) ** 2).mean())),
        samples=n,
        recordings=[d.name for d in drives],
    )


def _errors(
    drives: Sequence[CatalystDrive], theta: FloatArray, jacobian: FloatArray, error: FloatArray
) -> Catalyst:
    """Return one standard error of each constant, in its unit."""
    blocks = [np.flatnonzero(d.counts) // round(BLOCK_S / d.period_s) for d in drives]
    block = block_numbers(blocks, 1)
    # the rows come scaled by (1 + z²)^-0.75, so that their product is the Hessian of the soft L1
    pull = (1.0 + (error / ROBUST_V) ** 2) ** 0.25 * error
    number = int(block[-1]) + 1
    covariance = sandwich(jacobian, pull, block) * number / max(number - len(theta), 1)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Catalyst(*np.where(IS_LOG, std * np.array(_constants(theta)), std).tolist())


def _transformed(values: Sequence[float]) -> FloatArray:
    return np.array([math.log(v) if log else v for v, log in zip(values, IS_LOG, strict=True)])


def _constants(theta: FloatArray) -> Catalyst:
    pairs = zip(theta.tolist(), IS_LOG, strict=True)
    return Catalyst(*(math.exp(v) if log else v for v, log in pairs))
