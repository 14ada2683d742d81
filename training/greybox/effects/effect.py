"""An effect of the library: parameters, signals, equation, and the memory that it needs."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from monitor.base.types import FloatArray
from training.greybox.chain import Path
from training.greybox.effects.place import Place
from training.greybox.quantity.value import Quantity

Values = Sequence[float]  # of an effect's parameters, in their order
Changed = Mapping[str, Quantity]  # fields of the path with their new values
Equation = Callable[[Place, Values], Changed]
Tag = Literal["physics", "fault-like", "either"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One constant of an effect."""

    name: str
    unit: str
    low: float
    high: float
    start: tuple[float, ...]  # a fit begins from each of these
    positive: bool = False  # a value below 0 is another effect
    spread: float | None = None  # standard deviation about its start; None if any value may be


def _none(values: Values) -> float:
    return 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """One entry of the library."""

    equation: Equation = field(kw_only=False)
    name: str = ""  # that of the equation if none is given
    says: str  # effect on the vehicle, as the end of a sentence
    look_at: str = ""  # causes of a size below 0 that is another effect, as the end of a sentence
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...]  # signals without which the effect cannot be fitted
    optional: tuple[str, ...] = ()  # signals that the effect reads if they are present
    superseded: tuple[tuple[str, str], ...] = ()  # (optional signal, signal that replaces it)
    tag: Tag
    source: str = ""  # where the equation is from, in words
    like: tuple[str, ...] = ()  # names from which the effect cannot be told by construction
    gain_class: bool = False  # a constant factor on the mixture: seen against a reference only
    varies: bool = False  # from drive to drive, so that the effect may begin between two drives
    dead_time_s: Callable[[Values], float] = _none  # at most, beside the base's
    lag_s: Callable[[Values], float] = _none  # at most, beside the base's lags
    slower: Callable[[Values], float] = _none  # relative growth of the base's lags, at most

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.name or self.equation.__name__)

    def apply(
        self, path: Path, values: FloatArray, signals: Mapping[str, Quantity], period_s: float
    ) -> Path:
        """Return a path with the effect; values (k,) of the parameters in their order."""
        place = Place(path, signals, period_s)
        return replace(path, **self.equation(place, values.tolist()))

    def signals_of(self, present: Collection[str]) -> tuple[str, ...]:
        """Return the signals that the effect reads beside the chain's, if those are present.

        >>> from training.greybox.effects import LIBRARY
        >>> LIBRARY["purge"].signals_of(["purge_duty_percent", "coolant_temperature_degc"])
        ('manifold_pressure_kpa', 'engine_speed_rpm', 'purge_duty_percent')
        """
        better = dict(self.superseded)
        optional = (n for n in self.optional if n in present and better.get(n) not in present)
        return (*self.needs, *optional)
