"""An effect of the library: its place on the path, parameters, signals and equation."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

from monitor.base.types import FloatArray
from training.greybox.chain import MG_RPM_PER_KG_H, Path
from training.greybox.quantity import dynamics
from training.greybox.quantity.value import Quantity, clip, maximum

FLOW_MIN_KG_H: Final = 3.0
SPEED_MIN_RPM: Final = 400.0  # of injection; below it the engine stands
STANDARD_KPA: Final = 101.3
GAS_KG_PER_M3: Final = 0.44  # exhaust at 800 K and ambient pressure
KG_PER_H_AND_LITRE_PER_S: Final = 3.6 * GAS_KG_PER_M3
AIR_FACTOR_MIN, AIR_FACTOR_MAX = 0.5, 2.0


@dataclass(frozen=True, slots=True)
class Place:
    """The surroundings of an effect; each lag starts settled at its first input."""

    path: Path
    signals: Mapping[str, Quantity]
    period_s: float

    def of(self, name: str) -> Quantity:
        """Return a field of the path."""
        return getattr(self.path, name)

    def signal(self, name: str) -> Quantity:
        """Return a signal that must be present."""
        return self.signals[name]

    def lag(self, u: Quantity, time_s: Quantity) -> Quantity:
        """Return ``u`` behind a first-order lag, see ``dynamics.lag``."""
        return dynamics.lag(u, time_s, self.period_s)

    def injecting(self) -> Quantity:
        """Return whether fuel is injected; in a fuel cut, fuel from the walls may still enter."""
        return self.signal("fuel_mass_mg") > 0.0

    def strokes_per_s(self) -> Quantity:
        """Return the intake strokes of all four cylinders per second."""
        return maximum(self.signal("engine_speed_rpm"), SPEED_MIN_RPM) / 30.0

    def ambient_kpa(self, without: float = STANDARD_KPA) -> Quantity:
        """Return the ambient pressure, or ``without`` if it is not measured."""
        return self.signals.get("ambient_pressure_kpa", without)

    def flow_kg_h(self) -> Quantity:
        """Return the exhaust's mass flow from charge and engine speed."""
        flow = self.of("air_mg") * self.signal("engine_speed_rpm") * (1.0 / MG_RPM_PER_KG_H)
        return maximum(flow, FLOW_MIN_KG_H)

    def passage_s(self, litres: float) -> Quantity:
        """Return the time in s in which the exhaust passes through a volume."""
        return litres * KG_PER_H_AND_LITRE_PER_S / self.flow_kg_h()

    def air_times(self, factor: Quantity) -> dict[str, Quantity]:
        """Return the change of the cylinder's air by a factor, limited to 0.5 .. 2."""
        return {"air_mg": self.of("air_mg") * clip(factor, AIR_FACTOR_MIN, AIR_FACTOR_MAX)}


Values = Sequence[float]  # of an effect's parameters, in their order
Changed = Mapping[str, Quantity]  # fields of the path with their new values
Equation = Callable[[Place, Values], Changed]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """One entry of the library."""

    equation: Equation = field(kw_only=False)
    name: str = ""  # that of the equation if none is given
    says: str  # effect on the vehicle, as the end of a sentence
    look_at: str = ""  # causes of a size below 0 that is another effect, as the end of a sentence
    parameters: tuple[Parameter, ...]
    needs: tuple[str, ...] = ()  # signals without which the effect cannot be fitted
    optional: tuple[str, ...] = ()  # signals that the effect reads if they are present
    superseded: tuple[tuple[str, str], ...] = ()  # (optional signal, signal that replaces it)
    tag: Literal["physics", "fault-like", "either"]
    source: str = ""  # where the equation is from, in words
    like: tuple[str, ...] = ()  # names from which the effect cannot be told by construction
    gain_class: bool = False  # a constant factor on the mixture: seen against a reference only
    varies: bool = False  # from drive to drive, so that the effect may begin between two drives

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
