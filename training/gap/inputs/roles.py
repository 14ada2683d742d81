"""A model, recordings in their roles, and the user's choices."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from monitor.base.errors import UsageError
from monitor.base.faults import Fault, resolve
from training.gap.config import CONFIG
from training.greybox.effects import LIBRARY
from training.limits.trust import LIMIT_FAULTS
from training.recordings.recording import Recording

LIMITS: Final = CONFIG.inputs
FAULTS: Final = tuple(  # of lag and gain together both are there by themselves
    resolve(name, severity) for name, severity in LIMIT_FAULTS if name != "transient"
)
ACCEPTED: Final = "the recordings of the fit"


@dataclass(frozen=True, slots=True)
class GapOptions:
    """How a gap is named and what is added; raises UsageError if the choices make no sense."""

    steps: int = 1  # highest number of effects to add, one after the other: 1 to 3
    sensor_known_good: bool = False  # the sensor was checked: no fault of it is tried
    add: Sequence[str] = ()  # effects that may be faults, and are known to be none
    faults: Sequence[Fault] = FAULTS  # put on for verifying; none leaves the monitor out

    def __post_init__(self) -> None:
        if not 1 <= self.steps <= LIMITS.effects_max:
            raise UsageError(f"--steps is 1 to {LIMITS.effects_max}")
        unknown = [name for name in self.add if name not in LIBRARY]
        if unknown:
            raise UsageError(f"effect {unknown[0]!r} is unknown; there are {', '.join(LIBRARY)}")


@dataclass(frozen=True, slots=True)
class Material:
    """The model under study and its recordings by role."""

    model: Path
    recordings: Sequence[Recording]
    healthy: Sequence[Recording] = ()
    verify: Sequence[Recording] = ()  # seen by no fit

    @property
    def roles(self) -> dict[str, Sequence[Recording]]:
        """Return the recordings by the command's names of their roles."""
        return {"RECORDING": self.recordings, "--healthy": self.healthy, "--verify": self.verify}
