"""The constants of catalyst and downstream sensor from recordings, with standard errors.

Robust least squares (soft L1) of the voltage in free run, from several capacities and sensors. Only
samples with a warm brick, at moderate flow, and ``SETTLE_S`` after a break count. Standard errors
are those of a sandwich over blocks of ``BLOCK_S``, since errors of the model repeat within a block.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.optimize import least_squares

from monitor.base.config import CatalystConfig, shipped
from monitor.base.errors import RecordingError
from monitor.base.files.outputs import write_text
from monitor.base.types import BoolArray, FloatArray
from training.greybox.catalyst.chain import RANGES, Catalyst, volts
from training.greybox.fit.constants import sandwich

if TYPE_CHECKING:
    from training.recordings.recording import Recording

OUTPUT: Final = "downstream_voltage_v"
NEEDED: Final = (OUTPUT, "lambda_measured", "maf_kg_h")
SCHEMA: Final = "o2train.catalyst/1"
SETTLE_S: Final = 20.0
BLOCK_S: Final = 30.0
SAMPLES_LEAST: Final = 600
ROBUST_V: Final = 0.1  # from here on an error of the voltage counts less than its square
STARTS: Final = tuple(
    Catalyst(capacity_g=grams, to_rich_s=lag_s, to_lean_s=lag_s)
    for grams, lag_s in ((0.03, 0.1), (0.12, 0.1), (0.5, 0.1), (0.06, 1.0), (0.4, 1.0))
)
NAMES: Final = Catalyst._fields
HELD_SHARE: Final = 0.02  # of the range; a constant nearer to its bound ended at it


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
    """Constants, their standard errors, and how well the voltage is reproduced."""

    constants: Catalyst
    errors: Catalyst
    rmse_v: float
    samples: int
    recordings: tuple[str, ...]
    at_bound: tuple[str, ...]
    spread: float  # of the starts' costs over the best, relative

    def tree(self) -> dict[str, Any]:
        """Return the content of the file."""
        rows = {
            name: {
                "value": float(getattr(self.constants, name)),
                "standard_error": float(getattr(self.errors, name)),
                "unit": RANGES[name].unit,
                "at_bound": name in self.at_bound,
            }
            for name in NAMES
        }
        return {
            "schema": SCHEMA,
            "constants": rows,
            "rmse_v": self.rmse_v,
            "samples": self.samples,
            "recordings": list(self.recordings),
        }


def drive_of(recording: "Recording", config: CatalystConfig | None = None) -> CatalystDrive:
    """Return the fit's signals; raises RecordingError if a signal is missing."""
    config = config or shipped().catalyst
    missing = [name for name in NEEDED if name not in recording.known]
    if missing:
        raise RecordingError(
            f"{recording.path}: has no {', '.join(missing)}, the catalyst needs it"
        )
    period_s = recording.period_ns * 1e-9
    columns = np.column_stack([recording.column(name) for name in NEEDED])
    good = np.asarray(np.isfinite(columns).all(axis=1))
    rows = np.where(good, np.arange(len(good)), 0)
    held = columns[np.maximum.accumulate(rows)]
    held = np.where(np.isfinite(held), held, np.array([0.45, 1.0, 20.0]))
    air_g_s = held[:, 2] / 3.6
    counts = good & _warm(recording, config) & (air_g_s <= config.flow_most_g_s)
    n_settle = round(SETTLE_S / period_s)
    since = np.arange(len(good)) - np.maximum.accumulate(np.where(good, -1, np.arange(len(good))))
    counts &= (since > n_settle) & (np.arange(len(good)) > n_settle)
    x = 1.0 - 1.0 / np.maximum(held[:, 1], 0.1)
    return CatalystDrive(recording.path.name, period_s, x, air_g_s, held[:, 0], counts)


def _warm(recording: "Recording", config: CatalystConfig) -> BoolArray:
    run = recording.t_s >= config.warm_up_s
    if "catalyst_temperature_degc" not in recording.known:
        return np.asarray(run)
    degc = recording.column("catalyst_temperature_degc")
    return np.where(np.isfinite(degc), degc >= config.warm_degc, run)


def fit(drives: Sequence[CatalystDrive], starts: Sequence[Catalyst] = STARTS) -> FittedCatalyst:
    """Return the constants that reproduce the voltage best in free run.

    Raises RecordingError if too few samples count.
    """
    n = sum(int(d.counts.sum()) for d in drives)
    if n < SAMPLES_LEAST:
        names = ", ".join(d.name for d in drives)
        raise RecordingError(
            f"{names}: {n} samples with a warm catalyst, at least {SAMPLES_LEAST} are wanted"
        )
    low, high = (
        _transformed([getattr(r, end) for r in RANGES.values()]) for end in ("low", "high")
    )

    def residual(theta: FloatArray) -> FloatArray:
        return np.concatenate([_error_v(d, _constants(theta))[d.counts] for d in drives])

    found = [
        least_squares(
            residual,
            np.clip(_transformed(list(start)), low + 1e-9, high - 1e-9),
            bounds=(low, high),
            loss="soft_l1",
            f_scale=ROBUST_V,
            x_scale=0.1 * (high - low),
            diff_step=np.full(len(NAMES), 1e-4),
            max_nfev=60,
        )
        for start in starts
    ]
    best = min(found, key=lambda each: each.cost)
    constants = _constants(best.x)
    share = np.minimum(best.x - low, high - best.x) / (high - low)
    return FittedCatalyst(
        constants=constants,
        errors=_errors(drives, best.x, np.asarray(best.jac), residual(best.x)),
        rmse_v=float(np.sqrt((residual(best.x) ** 2).mean())),
        samples=n,
        recordings=tuple(d.name for d in drives),
        at_bound=tuple(name for name, near in zip(NAMES, share, strict=True) if near < HELD_SHARE),
        spread=float(np.std([each.cost / best.cost for each in found])),
    )


def _error_v(drive: CatalystDrive, constants: Catalyst) -> FloatArray:
    return volts(drive.x, drive.air_g_s, drive.period_s, constants) - drive.measured_v


def _errors(
    drives: Sequence[CatalystDrive], theta: FloatArray, jacobian: FloatArray, error: FloatArray
) -> Catalyst:
    """Return one standard error of each constant, in its unit."""
    blocks, first = [], 0
    for d in drives:
        own = np.arange(len(d.x)) // round(BLOCK_S / d.period_s) + first
        blocks.append(own[d.counts])
        first = int(own[-1]) + 1
    block = np.concatenate(blocks)
    # the rows come scaled by (1 + z²)^-0.75, so that their product is the Hessian of the soft L1
    pull = (1.0 + (error / ROBUST_V) ** 2) ** 0.25 * error
    number = len(np.unique(block))
    covariance = sandwich(jacobian, pull, block) * number / max(number - len(theta), 1)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    values = list(_constants(theta))
    return Catalyst(
        *(
            float(s * value if r.is_log else s)
            for s, value, r in zip(std, values, RANGES.values(), strict=True)
        )
    )


def _transformed(values: Sequence[float]) -> FloatArray:
    return np.array(
        [math.log(v) if r.is_log else v for v, r in zip(values, RANGES.values(), strict=True)]
    )


def _constants(theta: FloatArray) -> Catalyst:
    pairs = zip(theta.tolist(), RANGES.values(), strict=True)
    return Catalyst(*(math.exp(v) if r.is_log else v for v, r in pairs))


def write(path: Path, fitted: FittedCatalyst, further: Mapping[str, Any]) -> None:
    """Write constants, errors and fit as JSON."""
    write_text(path, json.dumps(fitted.tree() | dict(further), indent=1) + "\n")
