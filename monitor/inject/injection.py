"""One injected fault: name, severity and time span."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from monitor.base.errors import UsageError
from monitor.base.faults import DEFAULT_DISTURBANCE, DEFAULT_SEVERITY, resolve, severity_of

INVALID: Final = "signal_invalid"  # the ECU sends "not available" although the sensor is ready
FRAME_FAULTS: Final = {
    "frame_loss": 0.1,  # share of frames
    "frame_delay": 0.1,  # s
    "frame_duplication": 0.1,  # share of frames
    "frame_corruption": 0.1,  # share of frames
    "frame_flood": 200.0,  # frames/s
}
MOST: Final = {
    **dict.fromkeys(("frame_loss", "frame_duplication", "frame_corruption"), 1.0),
    "drop_outs": 0.95,
    "frame_flood": 20_000.0,
}
USUAL: Final = DEFAULT_SEVERITY | {INVALID: 1.0} | DEFAULT_DISTURBANCE | FRAME_FAULTS
NAMES: Final = tuple(USUAL)
ALL: Final = "all"


@dataclass(frozen=True, slots=True)
class Injection:
    """One fault with its severity and time span.

    Raises UsageError if the name is unknown or a value impossible.
    """

    name: str
    severity: float
    start_s: float = 0.0  # after the first frame
    end_s: float = math.inf
    messages: tuple[str, ...] = ()  # of a frame fault: names, or "all"; () means lambda's message
    can_id: int = 0  # of frame_flood
    drives: tuple[int, ...] = ()  # numbers from 1; () means every drive

    def __post_init__(self) -> None:
        severity_of(self.name, self.severity, USUAL)
        if not 0.0 <= self.start_s < self.end_s or math.isinf(self.start_s):
            raise UsageError(
                f"fault {self.name}: acts from {self.start_s:g} s to {self.end_s:g} s, "
                "wanted a start from 0 on and an end after it"
            )
        if self.name in DEFAULT_SEVERITY:
            resolve(self.name, self.severity)
        if self.severity > (most := MOST.get(self.name, math.inf)):
            raise UsageError(
                f"fault {self.name}: severity {self.severity:g}, at most {most:g} is wanted"
            )
        if self.messages and (self.name not in FRAME_FAULTS or self.name == "frame_flood"):
            raise UsageError(f"fault {self.name}: messages are for faults of frames")
        if self.can_id and self.name != "frame_flood":
            raise UsageError(f"fault {self.name}: can_id is for frame_flood")
        if not 0 <= self.can_id < 1 << 29:
            raise UsageError(f"fault {self.name}: can_id 0x{self.can_id:X} has more than 29 bits")

    @classmethod
    def of(cls, name: str, severity: float | None = None, **others: object) -> "Injection":
        """Return the injection; without a severity, the default of its name holds."""
        return cls(name, severity_of(name, severity, USUAL), **others)  # type: ignore[arg-type]

    def acts(self, since_ns: float) -> bool:
        """Return whether the fault acts at this time after the first frame."""
        return self.start_s * 1e9 <= since_ns < self.end_s * 1e9

    def __str__(self) -> str:
        end = f" to {self.end_s:g} s" if math.isfinite(self.end_s) else ""
        begin = f" from {self.start_s:g} s" if self.start_s or end else ""
        return f"{self.name}={self.severity:g}{begin}{end}"


def check_begun(injections: Iterable[Injection], end_ns: int) -> None:
    """Raise UsageError if a drive ends, this long after its first frame, before a fault begins."""
    for each in injections:
        if each.start_s * 1e9 > end_ns:
            raise UsageError(f"fault {each}: begins after the drive's end, {end_ns / 1e9:.0f} s")
