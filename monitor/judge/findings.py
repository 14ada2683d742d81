"""Findings on a window, and the events of a decision."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

from monitor.judge.bias import Bias
from monitor.judge.response.movement import Moved
from monitor.judge.response.rule import Estimates, Response
from monitor.judge.window import Outcome, Window
from monitor.memory.dtc import Dtc


class WindowEstimates(NamedTuple):
    """Estimates of all rules after a window."""

    response: Estimates
    bias: Bias
    moved: Moved

    def as_dict(self) -> dict[str, float | str | None]:
        """Return the estimates by name."""
        return self.response._asdict() | {
            "offset": self.bias.offset,
            "offset_std": self.bias.offset_std,
            "offset_beyond": self.bias.beyond,
            "dead": self.moved.dead,
            "holds": self.moved.holds,
        }


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
    statistics: WindowEstimates


@dataclass(frozen=True, slots=True)
class CutJudged:
    """The response test has judged a window around a fuel cut."""

    window: Window
    std: float  # of the residual, oriented like phi
    outcome: Outcome
    fault: str | None
    statistics: Estimates


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


class Facts(NamedTuple):
    """The findings of a window, before a decision."""

    mean: float  # of the residual, output's unit; around fuel cuts oriented like phi
    std: float
    no_evidence: bool  # the measurement does not move
    offset: float  # mean of the measurement against the likeliest sensor, output's unit
    response: Response
    moved: Moved


class Evidence(NamedTuple):
    """How far the response test is from a decision about one fault."""

    log_odds: float  # of the fault over all that is no fault
    needed: float  # log odds, or their negative where they are below 0, that decide
    seconds_to_decision: float | None  # of enabled driving like that so far, None if it shows none
