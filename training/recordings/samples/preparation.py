"""From recordings to training samples: mask, split, weight and scale.

A segment ends where an input is invalid. A sample whose output alone is invalid stays, with weight
0. Contiguous blocks of every recording are held out for validation and for the limits.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from monitor.base.counts import counted
from monitor.base.errors import O2Error, RecordingError, UsageError
from monitor.base.runs import runs
from monitor.base.signals import BY_NAME
from monitor.base.types import BoolArray, FloatArray, Quality
from monitor.model.card import Channel
from monitor.model.step import from_model_units, to_model_units
from training.recordings.samples.augmentation import CONTROLLER, FUEL, controller_noise, fuel_turns
from training.recordings.samples.outliers import outlier_mask
from training.recordings.samples.scaling import Scaling, channel_of, scaling_of

if TYPE_CHECKING:
    from training.recordings.recording import Recording

BLOCK_S = 45.0  # length of a block that is held out or trained on as a whole
BLOCK_SAMPLES = (200, 2000)  # least and most samples of a block
GROUP = 7  # of seven blocks one validates and one tests, which networks train on, too
LAMBDA_MEMORY = 50  # samples, one window, after which lambda has forgotten what was before
OTHER_WEIGHT = 0.1  # of samples outside the enabled region: cold start, fuel cut, open loop
ENABLE_COLUMNS = {"closed_loop": 1.0, "sensor_ready": 1.0, "fuel_cut": 0.0}


class Role(IntEnum):
    """The use of a block."""

    TRAIN = 0
    VALIDATE = 1
    TEST = 2


HELD_OUT = (Role.VALIDATE, Role.TEST)


@dataclass(frozen=True, slots=True)
class Samples:
    """Scaled samples of all recordings one after another."""

    u: FloatArray  # (n, n_inputs), finite
    y: FloatArray  # (n,), finite; invalid outputs are interpolated and have weight 0
    weight: FloatArray  # (n,) of the squared error, 0 is not scored


@dataclass(frozen=True, slots=True)
class Segment:
    """An unbroken stretch of one recording within the concatenated samples."""

    recording: int
    first: int  # row of the recording
    start: int  # row of the concatenated samples
    stop: int


@dataclass(frozen=True, slots=True)
class Prepared:
    """The samples of a training, their roles and their scaling."""

    samples: Samples  # scaled; training and validation use the same weight
    segments: tuple[Segment, ...]
    role: np.ndarray  # (n,) Role of each sample
    enabled: np.ndarray  # (n,) bool
    scaling: Scaling
    inputs: tuple[Channel, ...]
    output: Channel
    transform: str
    recordings: tuple["Recording", ...]
    period_ns: int
    outliers: dict[str, int]
    warnings: tuple[str, ...]
    memory: int = 0  # samples after which a model must have forgotten its history; 0: it need not

    @property
    def longest_block(self) -> int:
        """Samples of the longest stretch that is trained on or held out as a whole."""
        edges = np.flatnonzero(np.diff(self.role))
        return int(np.diff(edges, prepend=-1, append=len(self.role) - 1).max())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(channel.name for channel in self.inputs)

    @property
    def n_train(self) -> int:
        """Number of valid samples that train."""
        return int(((self.role == Role.TRAIN) & (self.samples.weight > 0)).sum())

    def training_on(self, *roles: Role) -> "Prepared":
        """Return the samples with those of other roles among the ones that train."""
        role = np.where(np.isin(self.role, roles), Role.TRAIN, self.role)
        return replace(self, role=role.astype(self.role.dtype))


def prepare(
    recordings: Sequence["Recording"],
    inputs: Sequence[str],
    output: str,
    *,
    lags: int = 5,
    seed: int = 0,
    block_s: float = BLOCK_S,
    other_weight: float = OTHER_WEIGHT,
    turn_fuel: bool = False,
) -> Prepared:
    """Return the recordings' samples, ready for training.

    turn_fuel : turn fuel and phi of the training samples up and down together, for a network that
        has to learn their balance; a chain has it in its equations
    Raises UsageError for impossible names, RecordingError for recordings that cannot be used.
    """
    if not recordings:
        raise UsageError("no recordings to train on")
    for _, error in problems(recordings, inputs, output):
        raise error
    period_ns = recordings[0].period_ns
    transform = output_transform(output)
    cut = stretches_of(recordings, inputs, output, transform, 8 * lags)
    u, y, segments = cut.u, cut.y, cut.segments
    valid = np.isfinite(y)
    role = _roles(segments, period_ns, block_s=block_s, seed=seed, lags=lags)
    train = (role == Role.TRAIN) & valid
    recorded = y
    if turn_fuel and transform == "phi" and FUEL in inputs:
        turns = fuel_turns(role == Role.TRAIN, period_ns, seed)
        u[:, list(inputs).index(FUEL)] *= turns
        y = y * turns
    seen = u.copy()
    if transform == "phi" and CONTROLLER in inputs:
        seen[:, list(inputs).index(CONTROLLER)] += controller_noise(role == Role.TRAIN, seed)
    scaling = scaling_of(seen[train], y[train], transform, inputs, recordings)
    weight = np.where(cut.enabled, 1.0, other_weight) * valid
    filled = np.interp(np.arange(len(y)), np.flatnonzero(valid), y[valid])
    return Prepared(
        samples=Samples(scaling.scale_u(seen), scaling.scale_y(filled), weight),
        segments=segments,
        role=role,
        enabled=cut.enabled & valid,
        scaling=scaling,
        inputs=tuple(channel_of(n, u[train, i]) for i, n in enumerate(inputs)),
        output=channel_of(output, from_model_units(transform, recorded[train])),
        transform=transform,
        recordings=tuple(recordings),
        period_ns=period_ns,
        outliers=cut.outliers,
        warnings=(*cut.unused, *_warnings(u[train], y[train], inputs, output, cut.outliers)),
        memory=LAMBDA_MEMORY if output.startswith("lambda") and FUEL in inputs else 0,
    )


@dataclass(frozen=True, slots=True)
class Stretches:
    """Unbroken stretches of all recordings one after another."""

    u: FloatArray  # (n, n_inputs)
    y: FloatArray  # (n,) in model units, NaN where the output is invalid
    enabled: BoolArray  # (n,)
    segments: tuple[Segment, ...]
    outliers: dict[str, int]  # signal → values that were left out
    unused: list[str]  # recordings without a stretch, in words

    def each(self, values: FloatArray) -> list[FloatArray]:
        """Return values of all stretches (n, …) as those of each."""
        return [values[s.start : s.stop] for s in self.segments]


def stretches_of(
    recordings: Sequence["Recording"],
    inputs: Sequence[str],
    output: str,
    transform: str,
    least: int,
) -> Stretches:
    """Return the stretches of at least ``least`` samples with all inputs and some output."""
    outliers = dict[str, int]()
    stretch = f"no stretch of {least} samples with all inputs valid and some {output}"
    u_parts, y_parts, on_parts, segments, at = [], [], [], list[Segment](), 0
    for index, recording in enumerate(recordings):
        u = columns_of(recording, inputs, outliers)
        y = columns_of(recording, [output], outliers)[:, 0]
        y[pinned_rows(recording, output)] = np.nan
        on = enabled_rows(recording)
        for first, stop in runs(np.asarray(np.isfinite(u).all(axis=1))):
            if stop - first < least or not np.isfinite(y[first:stop]).any():
                continue
            u_parts.append(u[first:stop])
            y_parts.append(to_model_units(transform, y[first:stop]))
            on_parts.append(on[first:stop])
            segments.append(Segment(index, first, at, at + stop - first))
            at += stop - first
    if not segments:
        raise RecordingError(f"{', '.join(str(r.path) for r in recordings)}: {stretch}")
    used = {segment.recording for segment in segments}
    return Stretches(
        u=np.concatenate(u_parts),
        y=np.concatenate(y_parts),
        enabled=np.concatenate(on_parts),
        segments=tuple(segments),
        outliers=outliers,
        unused=[
            f"{r.path}: not used, {stretch}" for i, r in enumerate(recordings) if i not in used
        ],
    )


def enabled_rows(recording: "Recording") -> np.ndarray:
    """Return (n,) bool: samples in closed loop, outside fuel cut, with the sensor ready.

    A condition without a column, or without a value, does not block.
    """
    on = np.ones(len(recording.values), dtype=bool)
    for name, wanted in ENABLE_COLUMNS.items():
        if name in recording.names:
            column = recording.column(name)
            on &= np.isnan(column) | ((column >= 0.5) == (wanted >= 0.5))
    return on


def output_transform(output: str) -> str:
    """Return the transform of the output: "phi" for the canonical lambda, else "none"."""
    return "phi" if output.startswith("lambda") and output in BY_NAME else "none"


def pinned_rows(recording: "Recording", output: str) -> np.ndarray:
    """Return (n,) bool: the output stands at the end of its range outside fuel cut.

    In fuel cut the end of the range is the right reading.
    """
    pinned = recording.quality[:, list(recording.names).index(output)] == Quality.PINNED
    if "fuel_cut" in recording.names:
        pinned &= ~(recording.values[:, list(recording.names).index("fuel_cut")] >= 0.5)
    return np.asarray(pinned)


def readings(recording: "Recording", output: str) -> FloatArray:
    """Return the output (n,), NaN where ``pinned_rows`` tell that it is no measurement."""
    column = recording.column(output)
    return np.where(pinned_rows(recording, output), np.nan, column)


def problems(
    recordings: Sequence["Recording"], inputs: Sequence[str], output: str
) -> Iterator[tuple[str, O2Error]]:
    """Yield what keeps a model with these signals from being trained, each with its topic."""
    if output in inputs:
        yield "names", UsageError(f"{output} is both an input and the output")
    if len(set(inputs)) < len(inputs) or not inputs:
        said = f"inputs {' '.join(inputs)}: each must be named once, at least one"
        yield "names", UsageError(said)
    for other in recordings[1:]:
        if other.period_ns != (first := recordings[0]).period_ns:
            said = (
                f"{other.path}: sample period {other.period_ns / 1e9:g} s, {first.path} has "
                f"{first.period_ns / 1e9:g} s; bring them to one grid with --period"
            )
            yield "sample period", RecordingError(said)


def columns_of(
    recording: "Recording", names: Sequence[str], outliers: dict[str, int]
) -> FloatArray:
    """Return columns without their outliers, (n, n_names); add how many there were of each."""
    values = np.column_stack([recording.column(name) for name in names]).astype(np.float64)
    for i, name in enumerate(names):
        bad = outlier_mask(name, values[:, i])
        if bad.any():
            outliers[name] = outliers.get(name, 0) + int(bad.sum())
            values[bad, i] = np.nan
    return values


def _roles(
    segments: Sequence[Segment], period_ns: int, block_s: float, seed: int, lags: int
) -> np.ndarray:
    rng = np.random.default_rng(seed)
    total = segments[-1].stop
    block = int(np.clip(block_s * 1e9 / period_ns, *BLOCK_SAMPLES))
    block = max(min(block, total // (2 * GROUP)), 4 * lags)
    starts = np.concatenate([np.arange(s.start, s.stop, block) for s in segments])
    stops = np.append(starts[1:], total)
    role = np.full(total, Role.TRAIN, dtype=np.int8)
    for at in range(0, len(starts), GROUP):
        members = np.arange(at, min(at + GROUP, len(starts)))
        if len(members) < 3:
            break
        for one, use in zip(rng.choice(members, 2, replace=False), HELD_OUT, strict=True):
            role[starts[one] : stops[one]] = use
    if not (role == Role.TEST).any():
        raise RecordingError(f"{total} usable samples are too few to hold blocks out")
    return role


def _warnings(
    u: FloatArray, y: FloatArray, inputs: Sequence[str], output: str, outliers: dict[str, int]
) -> list[str]:
    warnings = [f"{name}: {counted(count, 'outlier')} masked" for name, count in outliers.items()]
    for i, name in enumerate(inputs):
        r = float(np.corrcoef(u[:, i], y)[0, 1])
        if abs(r) > 0.999:
            warnings.append(f"input {name} nearly duplicates the output {output} (r = {r:.4f})")
    return warnings
