"""Findings on a window, and the events of a decision."""

from dataclasses import dataclass
from typing import Literal

from monitor.judge.bias import Bias
from monitor.judge.response.movement import Moved
from monitor.judge.response.rule import Estimates
from monitor.judge.window import Outcome, Window
from monitor.memory.dtc import Dtc


@dataclass(frozen=True, slots=True)
class WindowJudged:
    """A window of residuals is full and judged."""

    window: Window
    mean: float  # of the residual, output's unit
    std: float
    paper_failed: bool
    outcome: Outcome
    fault: str | None
    also: tuple[str, ...]
    excited: bool  # the prediction moves clearly
    response: Estimates
    bias: Bias
    moved: Moved

    @property
    def statistics(self) -> dict[str, float | str | None]:
        """Return the estimates of all rules by name."""
        return self.response._asdict() | {
            "offset": self.bias.offset,
            "offset_std": self.bias.offset_std,
            "offset_beyond": self.bias.beyond,
            "dead": self.moved.dead,
            "holds": self.moved.holds,
        }


@dataclass(frozen=True, slots=True)
class CutJudged:
    """The response test has judged a window around a fuel cut."""

    window: Window
    std: float  # of the residual, oriented like phi
    outcome: Outcome
    fault: str | None
    response: Estimates


@dataclass(frozen=True, slots=True)
class DtcChanged:
    """A trouble code has a new status."""

    t_ns: int
    dtc: Dtc


@dataclass(frozen=True, slots=True)
class Counted:
    """The fault memory has counted something that is to be stored."""

    t_ns: int
    what: Literal["ignition_cycle", "warm_up", "general_denominator", "numerator"]
    test: str = ""  # of a numerator


@dataclass(frozen=True, slots=True)
class RuleOff:
    """A plug-in's rule failed and judges no further window of this driving cycle."""

    t_ns: int
    said: str  # which rule, and how it failed


Change = DtcChanged | Counted | RuleOff
