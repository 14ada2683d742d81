"""What a model finds, and what it mistakes, on drives of its vehicle that it has not seen.

A model that follows its vehicle poorly makes faults of its own errors. Which ones, its card knows
from the training: there it judged drives that it had not seen, as they were and with each fault put
on. A fault that it saw in one of the healthy drives sets no code with this model, and one that it
found in less than half of the others is not said to be absent.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from monitor.base.counts import counted, plain
from monitor.base.errors import ModelError
from monitor.memory.codes import CONTINUOUS, TEST_OF

OF_MODEL: Final = ("response", "bias")  # tests that judge by the prediction
LEAST_FOUND: Final = 0.5  # of the drives, for a fault to count as tested
_COUNTS: Final = ("found", "false")
SHARE_LEAST: Final = 0.5  # of the least share so far; a drive with less may be another car's


@dataclass(frozen=True, slots=True)
class Trust:
    """Counts of drives that the model had not seen."""

    drives: int = 0  # judged; 0 where nothing is known, as of older models
    found: Mapping[str, int] | None = None  # drives in which each fault set a code; None: not known
    false: Mapping[str, int] | None = None  # healthy drives in which a fault set a code
    explained: float = 0.0  # least share of a healthy drive's reading that the model explained

    @classmethod
    def from_card(cls, given: Mapping[str, Any], where: str) -> "Trust":
        """Return the trust of a card; raises ModelError naming the file if it is none."""
        if not given:
            return cls()
        try:
            found, false = ({str(k): int(n) for k, n in given[key].items()} for key in _COUNTS)
            return cls(int(given["drives"]), found, false, float(given.get("explained", 0.0)))
        except (KeyError, TypeError, ValueError, AttributeError):
            raise ModelError(f"{where}: the model card's trust is no counts of drives") from None

    @property
    def untold(self) -> frozenset[str]:
        """Return the faults that set no code with this model, none of the tests without it."""
        return frozenset(name for name in self.false or () if TEST_OF.get(name) not in CONTINUOUS)

    @property
    def untested(self) -> tuple[str, ...]:
        """Return the faults that this model cannot exclude."""
        missed = [k for k, n in (self.found or {}).items() if n < LEAST_FOUND * self.drives]
        return tuple(dict.fromkeys((*missed, *sorted(self.untold))))

    def is_blind(self, test: str) -> bool:
        """Return whether the model can exclude no fault of a test, which then never passes."""
        faults = {name for name in self.found or () if TEST_OF.get(name) == test}
        return bool(faults) and faults <= set(self.untested)

    @property
    def least_explained(self) -> float:
        """Return the share of a reading below which the model does not describe it."""
        return SHARE_LEAST * self.explained

    def entry(self, explained: float | None = None) -> dict[str, Any]:
        """Return it for a result; {} where nothing is known.

        explained : share of the drive's reading that the model explains
        """
        if not self.drives or self.found is None:
            return {}
        tested = [name for name in self.found if name not in self.untested]
        shares = {"explained": explained, "explained_before": self.explained}
        return {
            **({} if explained is None else shares),
            "drives": self.drives,
            "faults": len(self.found),
            "tested": len(tested),
            "not_tested": list(self.untested),
            "no_code": sorted(self.untold),
        }


def in_words(entry: Mapping[str, Any] | None) -> str:
    """Return what a model finds and mistakes, "" where nothing is known.

    >>> in_words({"drives": 4, "faults": 10, "tested": 8, "not_tested": ["gain_low", "transient"],
    ...           "no_code": ["gain_low"]})
    'tried on 4 drives, this model finds 8 of 10 faults; not tested: gain_low, transient'
    >>> in_words({"drives": 4, "faults": 10, "tested": 10, "not_tested": [],
    ...           "explained": 0.02, "explained_before": 0.996}).split("; ")[1]
    "it explains 2 % of this reading, 100 % and more of those: is it another vehicle's?"
    """
    if not entry:
        return ""
    said = f"finds {entry['tested']} of {entry['faults']} faults"
    if entry["tested"] and entry["not_tested"]:
        said += f"; not tested: {', '.join(entry['not_tested'])}"
    share, before = entry.get("explained"), entry.get("explained_before", 0.0)
    if share is not None and share < SHARE_LEAST * before:
        said += f"; it explains {plain(100 * share, 2)} % of this reading, "
        said += f"{plain(100 * before, 2)} % and more of those: is it another vehicle's?"
    return f"tried on {counted(entry['drives'], 'drive')}, this model {said}"


UNKNOWN: Final = Trust()
