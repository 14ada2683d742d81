"""Errors of the old and the new model on drives no fit saw, and faults that are still found."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from monitor.base.types import BoolArray, FloatArray
from training.gap.verify.error_curve import ErrorCurve


@dataclass(frozen=True, slots=True)
class Error:
    """RMSE in phi of both models in one regime of the held-out drives."""

    kind: str  # "all", "speed and load", "temperature", "after fuel cut", "edge"
    regime: str  # in words
    samples: int
    blocks: int  # of time, that the bounds come from
    before: float
    after: float | None  # None without a new model
    floor: float | None  # what a flexible model leaves; None if it is not known
    change_low: float | None = None  # of after minus before, 95 % for all regimes together
    change_high: float | None = None  # both None if the blocks are too few

    @property
    def worse(self) -> bool:
        """Return whether the new model is worse beyond confidence."""
        return self.change_low is not None and self.change_low > 0.0

    @property
    def better(self) -> bool:
        """Return whether the new model is better beyond confidence."""
        return self.change_high is not None and self.change_high < 0.0


@dataclass(frozen=True, slots=True)
class Count:
    """Drives by the monitor's answer."""

    drives: int
    judged: int  # the response test reached a decision, or a code stands
    found: int  # a code stands at the end
    named: int  # by exactly the fault that was put on
    codes: tuple[str, ...]  # names of the faults that stand, of all drives


@dataclass(frozen=True, slots=True)
class Detection:
    """One fault put on the measured lambda of the held-out drives, before both models."""

    fault: str  # "" is none: whatever is found is a false alarm
    severity: float | None
    before: Count
    after: Count | None  # None without a new model

    @property
    def lost(self) -> bool:
        """Return whether the new model finds a fault in fewer drives than the old one."""
        return bool(self.fault) and self.after is not None and self.after.found < self.before.found


@dataclass(frozen=True, slots=True)
class ErrorTrace:
    """A stretch of a held-out drive with both models."""

    recording: str
    t_s: FloatArray  # (n,)
    measured: FloatArray  # (n,) phi
    before: FloatArray
    after: FloatArray
    scored: BoolArray


@dataclass(frozen=True, slots=True)
class Verification:
    """Old and new model on recordings that no fit saw."""

    overall: Error
    regimes: tuple[Error, ...]
    healthy: Error | None  # on recordings on which the old model was accepted
    faults: tuple[Detection, ...] = ()  # empty if the monitor could not be asked
    alarms: Detection | None = None  # without a fault, on the held-out drives
    healthy_alarms: Detection | None = None  # without a fault, on healthy recordings
    notes: tuple[str, ...] = ()
    trace: ErrorTrace | None = None  # where the new model helps most; None without one
    curve: ErrorCurve | None = None

    @property
    def worse(self) -> tuple[Error, ...]:
        """Return the regimes in which the new model is worse beyond confidence."""
        return tuple(e for e in self.regimes if e.worse)

    @property
    def closed(self) -> float | None:
        """Return how much of the squared error above the floor is gone, None if unknown."""
        return share_gone(self.overall, self.overall.floor)

    @property
    def closed_beyond_healthy(self) -> float | None:
        """Return the same above the old model's error on healthy recordings."""
        return share_gone(self.overall, None if self.healthy is None else self.healthy.before)

    @property
    def rates(self) -> tuple[float | None, float | None]:
        """Return the share of faulty drives in which the old and the new model find a fault."""
        after = [f.after for f in self.faults if f.after is not None]
        return rate([f.before for f in self.faults]), rate(after)

    @property
    def harm(self) -> str | None:
        """Return why the monitor is worse off with the new model, in words; None if it is not.

        If the old model raises codes without a fault, only decisions are compared: a model that
        takes the gap for a fault finds every fault put on.
        """
        quiet = self.alarms is None or not self.alarms.before.found
        for of, words in (("judged", "decides in"), ("found", "finds a fault put on in")):
            runs = [f for f in self.faults if of == "judged" or quiet]
            old = sum(getattr(f.before, of) for f in runs if f.after)
            new = sum(getattr(f.after, of) for f in runs if f.after)
            if new < old:
                drives = sum(f.before.drives for f in runs)
                return (
                    f"the monitor {words} {new} of {drives} drives with the new model, in {old} "
                    "with the old one"
                )
        return None

    def where(self) -> list[dict[str, Any]]:
        """Return the regimes in which the old model's excess error is dense, most of it first.

        ``share_of_excess`` : of the squared error above the floor
        """
        whole = _excess(self.overall)
        if whole <= 0.0:
            return []
        shares = [(min(_excess(e) / whole, 1.0), e) for e in self.regimes]
        dense = [(s, e) for s, e in shares if s > e.samples / self.overall.samples]
        return [
            {"kind": e.kind, "regime": e.regime, "share_of_excess": s}
            for s, e in sorted(dense, key=lambda each: -each[0])
        ]

    def as_json(self) -> dict[str, Any]:
        """Return regimes and detection as ``gap.json`` has them."""
        return {
            "gap_closed": self.closed,
            "harm": self.harm,
            "gap_closed_beyond_healthy": self.closed_beyond_healthy,
            "overall": _error(self.overall),
            "regimes": [_error(e) for e in self.regimes],
            "healthy": None if self.healthy is None else _error(self.healthy),
            "detection": [asdict(f) | {"lost": f.lost} for f in self.faults],
            "false_alarms": self.alarms and asdict(self.alarms),
            "false_alarms_healthy": self.healthy_alarms and asdict(self.healthy_alarms),
            "notes": list(self.notes),
        }


def share_gone(error: Error, level: float | None) -> float | None:
    """Return how much of the squared error above a level in phi is gone, None without a gap."""
    if error.after is None or level is None or error.before <= level:
        return None
    return (error.before**2 - error.after**2) / (error.before**2 - level**2)


def rate(counts: Sequence[Count], of: str = "found") -> float | None:
    """Return the share of drives that were ``found``, ``named`` or ``judged``, None of no drive.

    >>> rate([Count(4, 4, 3, 2, ("gain_low",))])
    0.75
    """
    drives = sum(c.drives for c in counts)
    return sum(int(getattr(c, of)) for c in counts) / drives if drives else None


def _excess(error: Error) -> float:
    """Return the sum of the old model's squared error above the floor; 0 if that is not known."""
    return 0.0 if error.floor is None else error.samples * (error.before**2 - error.floor**2)


def _error(error: Error) -> dict[str, Any]:
    return asdict(error) | {"worse": error.worse}
