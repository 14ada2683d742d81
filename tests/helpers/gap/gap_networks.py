"""A small network of a simulated vehicle, and drives of it with the plant's own effects."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from monitor.base import config
from monitor.base.signals import NARX_INPUTS, OUTPUT
from monitor.base.types import FloatArray
from monitor.judge.limits import NO_LIMITS
from monitor.model.card import TrainingRecording
from monitor.model.step import Model
from tests.helpers.drives.recordings import recording_of_samples
from tests.helpers.drives.simulated_drives import sampled
from tests.helpers.shared import shared
from training.dyno import vehicle
from training.dyno.effects import from_severities
from training.dyno.simulation import Experiment
from training.greybox.chain import Constants
from training.greybox.effects import LIBRARY
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit import joint
from training.greybox.fit.drive import ChainDrive, from_recording
from training.limits.judging import judge_recordings
from training.narx.fit import FitOptions, FitResult, FitSource, fit
from training.recordings.recording import Recording

VEHICLE = 2011
FILM = ("wall_film", 4.0)
CYCLES = ("wltc_3b", "micro_trips", "us06")
FIT = (TrainingRecording("gap.log", "ab" * 32, 4000, "simulated"),)
CHAIN = Constants(
    gain=1.0, dead_time_s=0.1, dead_time_revolutions=1.3, mixing_s=0.08, sensor_s=0.09, span=0.98
)


@cache
def drive(
    cycle: str,
    seed: int,
    effect: tuple[str, float] | None = None,
    duration_s: float = 400.0,
    coolant_degc: float | None = None,
    of_vehicle: int = VEHICLE,
) -> Recording:
    """Return a recording as the monitor's grid sees it, the plant's own effect inside the loop."""
    weather = vehicle.conditions(seed)
    start_degc = weather.coolant_start_degc if coolant_degc is None else coolant_degc
    experiment = Experiment(
        cycle=cycle,
        vehicle=of_vehicle,
        seed=seed,
        effects=from_severities(dict([effect] if effect else [])),
        duration_s=duration_s,
        conditions=weather._replace(coolant_start_degc=start_degc),
    )
    block, names = sampled(experiment, np.random.default_rng([5, seed]))
    return recording_of_samples(block, names, f"{experiment.name}.log", f"{seed:064x}")


def small_network(folder: Path) -> FitResult:
    """Return a network of the healthy vehicle, with boxes and a linear path, kept in ``folder``."""
    result, content = _trained_once()
    path = folder / "base.onnx"
    path.write_bytes(content)
    return replace(result, path=path)


@shared
def _trained_once() -> tuple[FitResult, bytes]:
    with TemporaryDirectory() as folder:
        result = trained_on(healthy_drives(), Path(folder))
        return result, result.path.read_bytes()


def trained_on(recordings: Sequence[Recording], folder: Path) -> FitResult:
    """Return a network of recordings."""
    options = FitOptions(lags=5, hidden=(5,), starts=1, threads=1, budget_minutes=0.05, seed=2)
    return fit(FitSource(recordings, NARX_INPUTS, OUTPUT), folder / "base.onnx", options)


@shared
def healthy_drives() -> tuple[Recording, ...]:
    """Return drives with nothing hidden."""
    return tuple(drive(cycle, 2_020_110 + i) for i, cycle in enumerate(CYCLES))


@shared
def gap_drives(hidden: tuple[str, float] = FILM) -> tuple[Recording, ...]:
    """Return drives with a hidden effect of a severity."""
    return tuple(drive(cycle, 2_020_120 + i, hidden) for i, cycle in enumerate(CYCLES))


@shared
def fitted(hidden: tuple[str, float] = FILM) -> tuple[Constants, ModelEffect]:
    """Return the library's form of an effect in the chain, fitted to drives with the plant's."""
    name, drives = hidden[0], tuple(map(from_recording, gap_drives(hidden)))
    nothing = tuple(np.zeros(len(each)) for each in drives)
    case = joint.Case(drives, nothing, ar=(0.9, 0.0), sigma=0.005)
    alone = joint.fit(case, (), [CHAIN])
    found = joint.fit(case, (LIBRARY[name],), [alone])
    return found.base, ModelEffect.with_values(name, found.parameters[0].tolist())


def ranges(*recordings: Recording) -> dict[str, tuple[float, float]]:
    """Return low and high of every signal."""
    drives = [from_recording(each) for each in recordings]
    return {
        name: (
            min(float(each.signals[name].min()) for each in drives),
            max(float(each.signals[name].max()) for each in drives),
        )
        for name in drives[0].signals
    }


def inputs_of(model: Model, driven: ChainDrive) -> FloatArray:
    """Return the model's inputs (n, n_inputs)."""
    return np.column_stack([driven.signals[name] for name in model.card.input_names])


def rmse(phi: FloatArray, driven: ChainDrive) -> float:
    """Return the RMSE in phi on the scored samples."""
    return float(np.sqrt(np.mean((phi - driven.phi_measured)[driven.scored] ** 2)))


def assert_judged_alike(path: Path) -> None:
    """Hold streaming and batched runs of a model to the same bits, and let the monitor judge."""
    model, recording = Model.load(path), drive("micro_trips", 2_020_131, FILM, coolant_degc=85.0)
    u = inputs_of(model, from_recording(recording))
    both = np.stack([u[1000:1400], u[2000:2400]])
    together = model.with_batch(2)
    together.reset(both[:, 0])
    batch = together.run_batch(both)
    for i, rows in enumerate(both):
        model.reset(rows[0])
        assert np.array_equal([model.step(each) for each in rows], batch[i])
    judged = judge_recordings([recording], model, NO_LIMITS, config.load())[0]
    assert len(judged.windows) > 5
