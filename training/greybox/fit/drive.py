"""Drives for a fit: signals on the model's grid, measured phi, and the samples that count."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from types import MappingProxyType
from typing import Final

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.runs import since
from monitor.base.types import BoolArray, FloatArray, IntArray
from monitor.model.step import PHI_MAX
from training.greybox.chain import (
    RECOVERY_S,
    Constants,
    Path,
    base_path,
    charge_mg,
    simulate,
    with_speed,
)
from training.greybox.effects import LIBRARY, Effect
from training.greybox.effects.air import following
from training.greybox.effects.model_effect import Effects, along
from training.pages.numbers import percent
from training.recordings.recording import Recording
from training.recordings.samples.preparation import readings
from training.recordings.samples.rows import hold

OUTPUT: Final = "lambda_measured"
NEEDED: Final = ("air_mass_mg", "fuel_mass_mg")
CUT_PHI: Final = 0.5  # a sensor reads less in fuel cut only, never of burnt mixture
AFTER_CUT_READ_S: Final = 1.0  # the end of a cut has passed the sensor, whatever the dead time
AFTER_GAP_S: Final = 5.0  # a held value has left the chain
CUT_FUEL_MG: Final = 0.3  # per stroke; below the smallest injection
MIN_SCORED_S: Final = 60.0
KEPT: Final = 32  # paths and readings that are not computed again
BLOCK_S: Final = 30.0  # holds many cycles of the lambda controller and a manoeuvre or two
FOLDS: Final = 5  # of blocks that are held out together


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChainDrive:
    """One recording as the chain needs it."""

    name: str
    period_s: float
    signals: Mapping[str, FloatArray]  # canonical name → (n,), gaps held
    phi_measured: FloatArray  # (n,) 1 / lambda, held where not measured
    scored: BoolArray  # (n,) measured, outside fuel cut and the recovery from it
    moved_phi: FloatArray | float = 0.0  # (n,) by which the model's effects move the chain's phi
    own: Effects = ()  # effects of the healthy vehicle, part of the base
    charged: bool = False  # whether the air per stroke is corrected as healthy drives taught
    meter_s: float | None = None  # time in which the air meter corrects the charge; None: unknown

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return the library for this ECU, see ``following``."""
        return tuple(following(effect, self.meter_s) for effect in LIBRARY.values())

    def __len__(self) -> int:
        return len(self.phi_measured)

    @property
    def kept(self) -> BoolArray:
        """(n,) bool: the sample and the two before it are scored, as a whitened error needs."""
        return np.asarray(since(~self.scored) > 2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison(ChainDrive):
    """A drive beside a model's free run on it, scored where both are known."""

    phi_predicted: FloatArray  # (n,)
    residual: FloatArray = field(init=False)  # (n,) measured minus predicted, 0 where not scored

    @classmethod
    def of(cls, drive: ChainDrive, phi_predicted: FloatArray) -> "Comparison":
        """Return a drive beside a model's prediction (n,) in phi."""
        of_drive = {f.name: getattr(drive, f.name) for f in fields(ChainDrive)}
        return cls(**of_drive, phi_predicted=phi_predicted)

    def __post_init__(self) -> None:
        difference = self.phi_measured - self.phi_predicted
        scored = self.scored & np.isfinite(difference)
        object.__setattr__(self, "scored", scored)
        object.__setattr__(self, "residual", np.where(scored, difference, 0.0))


@lru_cache(KEPT)
def path_of(drive: ChainDrive, base: Constants) -> Path:
    """Return the path of the base on a drive, with the healthy vehicle's own effects."""
    return along(base_path(base, drive.signals), drive.own, drive.signals, drive.period_s)


@lru_cache(KEPT)
def phi_of(drive: ChainDrive, base: Constants) -> FloatArray:
    """Return the phi (n,) that the sensor reads on a drive by the base."""
    return np.asarray(simulate(path_of(drive, base), drive.period_s))


def joined(drives: Sequence[ChainDrive]) -> ChainDrive:
    """Return drives end to end as one of the plain chain, with that chain's signals alone."""
    names = (*NEEDED, "engine_speed_rpm")
    return ChainDrive(
        name=", ".join(drive.name for drive in drives),
        period_s=drives[0].period_s,
        signals={n: np.concatenate([d.signals[n] for d in drives]) for n in names},
        phi_measured=np.concatenate([drive.phi_measured for drive in drives]),
        scored=np.concatenate([drive.scored for drive in drives]),
    )


def from_recording(
    recording: Recording, made: Mapping[str, FloatArray] | None = None
) -> ChainDrive:
    """Return the drive of a recording.

    made : signals (n,) that the model computes; they replace the recorded ones
    A missing charge is computed from air meter and engine speed, a missing engine speed from air
    meter and charge. A sample is scored if lambda and all inputs of the chain have been measured,
    and fuel injected, for some seconds.
    Raises RecordingError if a signal is missing or less than a minute can be scored.
    """
    columns = {name: recording.column(name) for name in recording.names if name != OUTPUT}
    columns |= made or {}
    present = {name: x for name, x in columns.items() if np.isfinite(x).any()}
    if "air_mass_mg" not in present and {"maf_kg_h", "engine_speed_rpm"} <= set(present):
        present["air_mass_mg"] = charge_mg(present)
    for name in NEEDED:
        if name not in present:
            raise RecordingError(
                f"{recording.path}: has no good value of {name}, the gap workflow needs it"
            )
    lambda_measured = readings(recording, OUTPUT)
    return make(recording.path.name, recording.period_ns / 1e9, present, lambda_measured)


def make(
    name: str,
    period_s: float,
    signals: Mapping[str, FloatArray],
    lambda_measured: FloatArray,
    needed: Sequence[str] | None = None,
) -> ChainDrive:
    """Return a drive from signals (n,) and measured lambda (n,), NaN where they are bad.

    needed : signals without which the model predicts nothing, default those of the chain
    Raises RecordingError if less than a minute can be scored.
    """
    good = np.isfinite(lambda_measured) & (lambda_measured > 0.0)
    phi = np.minimum(1.0 / np.where(good, lambda_measured, 1.0), PHI_MAX)
    read = {*NEEDED, *({"engine_speed_rpm"} & signals.keys())} if needed is None else {*needed}
    inputs_good = np.all([np.isfinite(signals[each]) for each in read], axis=0)
    held = {each: hold(values) for each, values in signals.items()}
    if needed is None:
        if not {"engine_speed_rpm", "maf_kg_h"} & set(held):
            raise RecordingError(f"{name}: has neither engine_speed_rpm nor maf_kg_h")
        held = with_speed(held)
    told = in_fuel_cut(held)
    cut = np.zeros(len(phi), dtype=bool) if told is None else told
    scored = good & ~until(cut, RECOVERY_S, period_s)
    scored &= ~until(good & (phi < CUT_PHI), AFTER_CUT_READ_S, period_s)
    stands = np.asarray(held.get("engine_speed_rpm", np.inf) < 400.0)
    scored &= ~until(~inputs_good | stands, AFTER_GAP_S, period_s)
    scored &= held.get("sensor_ready", 1.0) > 0.5
    scored[: round(AFTER_GAP_S / period_s)] = False
    seconds = float(scored.sum()) * period_s
    if seconds < MIN_SCORED_S:
        raise RecordingError(
            f"{name}: {seconds:.0f} s can be scored, {MIN_SCORED_S:.0f} wanted; of its samples "
            f"{percent(good.mean())} have lambda, {percent(inputs_good.mean())} "
            f"{', '.join(sorted(read))}, {percent(1.0 - cut.mean())} are outside fuel cut "
            f"(fuel_mass_mg from {CUT_FUEL_MG:g} mg)"
        )
    return ChainDrive(
        name=name,
        period_s=period_s,
        signals=MappingProxyType(held),
        phi_measured=hold(np.where(good, phi, np.nan)),
        scored=scored,
    )


def in_fuel_cut(signals: Mapping[str, FloatArray]) -> BoolArray | None:
    """Return (n,) bool: the flag or the fuel mass tells a fuel cut; None without both signals."""
    said = [signals["fuel_cut"] > 0.5] if "fuel_cut" in signals else []
    if "fuel_mass_mg" in signals:
        said.append(signals["fuel_mass_mg"] < CUT_FUEL_MG)
    return np.asarray(np.any(said, axis=0)) if said else None


def block_numbers(rows: Sequence[IntArray], samples: int) -> IntArray:
    """Return the block of each row (m,), 0, 1, .. through all recordings.

    rows : those of each recording, rising; samples : length of a block, of a slow grid one
    """
    places = [np.stack([own * 0 + k, own // (samples or 1)]) for k, own in enumerate(rows)]
    both = np.concatenate(places, axis=1)
    return np.asarray(np.cumsum(np.any(np.diff(both, prepend=both[:, :1]), axis=0)))


def until(bad: BoolArray, seconds: float, period_s: float) -> BoolArray:
    """Return (n,) bool: ``bad`` at the sample or within the ``seconds`` before it."""
    steps = round(seconds / period_s)
    return np.asarray(since(bad, steps) <= steps)
