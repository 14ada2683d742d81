"""A chain and drives on which effects in the grey-box graph are tested."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from monitor.model.card import TrainingRecording
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from tests.helpers.gap.gap_simulated import simulated
from training.dyno.recording_files import write
from training.dyno.simulation import Experiment
from training.greybox.fit.drive import ChainDrive, make
from training.greybox.model import fit_greybox
from training.recordings.recording import Recording, load

FIT = (TrainingRecording("gap.parquet", "ab" * 32, 6000, "simulated"),)


@cache
def recording() -> Recording:
    """The simulated drive that the chain is fitted to."""
    experiment = Experiment(cycle="micro_trips", seed=2_000_002, vehicle=2001)
    with TemporaryDirectory() as folder:
        return load(write(experiment, Path(folder), "parquet"))


def fitted(out: Path) -> Path:
    """Fit a chain to one simulated drive."""
    return fit_greybox([recording()], out).path


@cache
def driven() -> ChainDrive:
    return simulated("micro_trips", 2_030_001)


@cache
def plain() -> ChainDrive:
    """A drive of plain formulas that is cold at first, with purge, boost and fuel cuts."""
    signals = plain_signals()
    return make("plain", PERIOD_S, signals, np.ones(len(signals["fuel_mass_mg"])))


def ranges_of(*names: str) -> dict[str, tuple[float, float]]:
    """Return low and high of the signals of both drives, or of those named."""
    both = [(driven().signals[n], plain().signals[n]) for n in names or plain().signals]
    ends = [(min(a.min(), b.min()), max(a.max(), b.max())) for a, b in both]
    return dict(zip(names or plain().signals, ends, strict=True))
