"""A NARX study that is done in a second: two recordings, five small models."""

from typing import Any

from tests.helpers.recordings import recording_of
from tests.helpers.tanks import TANK_PERIOD_S, leaking_tank
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, prepare
from training.study.narx.candidates import BAYES, CONJUGATE, DESCENT, LM, PAPER, ModelCandidate
from training.study.task import Settings

FEW = (
    ModelCandidate(number=1, algorithm=LM, lags=3, hidden=(4,), rate=0.2, origin=PAPER),
    ModelCandidate(2, LM, 3, (4,), 0.01),
    ModelCandidate(3, BAYES, 2, (3,)),
    ModelCandidate(4, CONJUGATE, 3, (3, 3)),
    ModelCandidate(5, DESCENT, 3, (4,), 0.05),
)
SETTINGS = Settings(starts=2, iterations=25, n_samples=900, tune_best=1)


def drive(n: int, seed: int, name: str) -> Recording:
    """A recording of a tank with a valve and a leak."""
    columns = zip(("valve", "leak", "level_m"), leaking_tank(n, seed, 0.5), strict=True)
    return recording_of(dict(columns), name, TANK_PERIOD_S)


def two_drives() -> Prepared:
    """Return a longer and a shorter recording, prepared."""
    recordings = [drive(1500, 1, "morning"), drive(900, 2, "evening")]
    return prepare(recordings, ["valve", "leak"], "level_m", block_s=25.0)


def timeless(tree: Any) -> Any:
    """Return a result without its times."""
    if isinstance(tree, dict):
        return {k: timeless(v) for k, v in tree.items() if k not in ("seconds", "cpu_s")}
    return [timeless(v) for v in tree] if isinstance(tree, list) else tree
