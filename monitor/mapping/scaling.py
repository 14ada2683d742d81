"""The way from a signal's unit and range to the canonical unit."""

import math
from dataclasses import dataclass, replace
from typing import Final

from cantools.database.can import Signal

from monitor.base.signals import plausible_range
from monitor.mapping.meanings import LAMBDA_FAMILY, Meaning
from monitor.mapping.vocabulary import UnitWords, unit_of, words_of

STOICHIOMETRIC: Final = 14.7  # kg of air per kg of gasoline, the number of most AFR gauges
GAUGE_KPA: Final = (90.0, 110.0)  # the atmosphere
FILLERS: Final = (1.0, 255.0, 1023.0)  # that editors write where nobody states a range
FILLER_BITS: Final = 10
MOST_ABOVE: Final = 300.0  # times the plausible range; a stated range beyond has another unit
MIXTURE: Final = ("number", "ratio", "afr", "phi")
PRESSURES: Final = (("MPa", 1000.0, 60.0), ("bar", 100.0, 600.0), ("kPa", 1.0, math.inf))
PRESSURES_KPA: Final = (("bar", 100.0, 8.0), ("kPa", 1.0, 700.0), ("hPa", 0.1, math.inf))


@dataclass(frozen=True, slots=True)
class UnitScaling:
    """value = factor * signal + offset, in the canonical unit."""

    why: tuple[str, ...] = ()
    factor: float = 1.0
    offset: float = 0.0
    weight: float = 1.0  # confidence that is left
    is_phi: bool = False  # the signal is 1 / lambda
    doubts: tuple[str, ...] = ()

    def values(self, signal: Signal, *, declared: bool) -> tuple[float, float]:
        """Return the range of the canonical values, see ``span``."""
        ends = [each * self.factor + self.offset for each in span(signal, declared=declared)]
        if self.is_phi:
            return (0.5, 2.0) if max(ends) >= 1.1 else (0.0, 0.0)
        return min(ends), max(ends)

    def less(self, weight: float, why: str) -> "UnitScaling":
        """Return the scaling with a doubt."""
        doubts = (*self.doubts, why)
        return replace(self, weight=weight * self.weight, why=(*self.why, why), doubts=doubts)


def scaling_of(name: str, signal: Signal, meaning: Meaning) -> UnitScaling | None:
    """Return the way to the canonical unit, None if the signal is another quantity."""
    written = (signal.unit or "").strip()
    unit = unit_of(written)
    if meaning.is_flag:
        return _flag(signal, written)
    if name in LAMBDA_FAMILY and (unit is None or unit.dimension in MIXTURE):
        scaling = _mixture(name, signal, unit, written)
    elif unit is not None and unit.dimension in meaning.dimensions:
        per_base = meaning.dimensions[unit.dimension]
        why = (f"its unit is {written}",)
        scaling = UnitScaling(why, unit.factor * per_base, unit.offset * per_base)
    elif unit is not None and unit.dimension != "number":
        return None
    elif written and unit is None:
        why = (f"its unit {written!r} is not known, taken as it is: check",)
        scaling = UnitScaling(why, weight=0.4 * meaning.without_unit)
    else:
        scaling = _without_unit(signal, meaning)
    return scaling and _plausible(scaling, name, signal, meaning)


def span(signal: Signal, *, declared: bool = True) -> tuple[float, float]:
    """Return the range of the signal's values, in its own unit.

    declared : the range that the database states, if it states one, else that of the bits
    """
    if declared and signal.minimum is not None and signal.maximum is not None:
        low, high = float(signal.minimum), float(signal.maximum)
        is_filler = low == 0.0 and high in FILLERS and signal.length > FILLER_BITS
        if low < high and not is_filler:
            return low, high
    if signal.is_float:
        return -1e30, 1e30
    bits = signal.length
    raw = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signal.is_signed else (0, (1 << bits) - 1)
    ends = [float(each) * float(signal.scale) + float(signal.offset) for each in raw]
    return min(ends), max(ends)


def _without_unit(signal: Signal, meaning: Meaning) -> UnitScaling | None:
    """Return the scaling of the unit that the signal's range suggests."""
    if meaning.without_unit == 0.0:
        return None
    low, high = span(signal)
    if "pressure" in meaning.dimensions:
        per_kpa = meaning.dimensions["pressure"]
        largest = max(abs(low), abs(high))
        steps = PRESSURES_KPA if per_kpa == 1.0 else PRESSURES
        unit, factor, _ = next(step for step in steps if largest <= step[2])
        why = f"no unit is given; up to {largest:g} it is taken for {unit}: check"
        return UnitScaling((why,), factor * per_kpa, weight=meaning.without_unit)
    factor = 100.0 if "ratio" in meaning.dimensions and high <= 1.5 else 1.0
    why = "no unit is given, taken for the canonical one: check"
    return UnitScaling((why,), factor, weight=meaning.without_unit)


def _flag(signal: Signal, written: str) -> UnitScaling | None:
    """Return the scaling of a flag, which turns it round where 1 stands for the contrary."""
    if signal.length > 8 or signal.is_float or span(signal, declared=False)[1] < 1.0:
        return None
    if written and unit_of(written) != unit_of("-"):
        return None
    contrary = {"open", "openloop", "not", "inactive", "invalid", "inaktiv"} & set(
        words_of(signal.name)
    )
    why = f"a flag of {signal.length} bits"
    choices = {int(k): str(v).lower() for k, v in (signal.choices or {}).items()}
    if 1 in choices:
        why += f", where 1 is {choices[1]!r}"
        contrary |= {choices[1]} & {"no", "off", "inactive", "open", "aus", "nein"}
    if contrary:
        return UnitScaling((why + ", turned round",), -1.0, 1.0, 0.8)
    one_bit = signal.length <= 2 or span(signal)[1] <= 1.0
    return UnitScaling((why,), weight=1.0 if one_bit else 0.7)


def _mixture(name: str, signal: Signal, unit: UnitWords | None, written: str) -> UnitScaling | None:
    """Return the scaling of lambda, AFR, phi or a trim."""
    dimension = unit.dimension if unit else ""
    if written and unit is None:
        return None
    if name == "lambda_controller":
        return _trim(signal, unit, written)
    if dimension == "ratio":
        return None
    words = set(words_of(signal.name))
    if dimension == "phi" or words & {"phi", "equivalence", "eqr"}:
        return UnitScaling(("an equivalence ratio: lambda is 1 / it",), is_phi=True)
    is_named_afr = "afr" in words or {"air", "fuel"} <= words
    if dimension == "afr" or (is_named_afr and span(signal)[1] > 5.0):
        why = f"an air-fuel ratio, divided by {STOICHIOMETRIC:g}"
        return UnitScaling((f"{why}: check what {signal.name} counts with",), 1 / STOICHIOMETRIC)
    return UnitScaling((f"its unit is {written}",) if written and written != "-" else ())


def _trim(signal: Signal, unit: UnitWords | None, written: str) -> UnitScaling:
    """Return the scaling of a trim, 1 where nothing is corrected."""
    low, high = span(signal)
    if unit is not None and unit.dimension == "ratio":
        if low >= 0.0 and high > 110.0:
            sure = 1.0 if high <= 400.0 else 0.5  # beyond, the range is only that of the bits
            why = f"in {written} and never negative, so 100 is no correction: check"
            return UnitScaling((why,), unit.factor, weight=sure)
        return UnitScaling((f"in {written}, 0 is no correction",), unit.factor, 1.0)
    if low < 0.0 < high < 0.9:
        return UnitScaling(("0 is no correction",), offset=1.0)
    return UnitScaling(("1 is no correction",))


def _plausible(
    scaling: UnitScaling, name: str, signal: Signal, meaning: Meaning
) -> UnitScaling | None:
    """Return the scaling, doubted if its values are odd, None if they are another quantity's."""
    low, high = meaning.typical
    carried, stated = (scaling.values(signal, declared=declared) for declared in (False, True))
    too_coarse = abs(float(signal.scale) * scaling.factor) > (high - low) / 3
    if not carried[0] <= low < high <= carried[1] or (too_coarse and not signal.is_float):
        return None
    most = MOST_ABOVE * max(map(abs, plausible_range(name)))
    is_filler = stated == carried or _is_power_of_two(signal)
    if max(map(abs, stated)) > most and not (is_filler or scaling.is_phi):
        why = f"its range reaches {max(stated, key=abs):g}: another unit?"
        scaling = scaling.less(0.6, why)
    if not stated[0] <= low < high <= stated[1]:
        why = f"its range {stated[0]:g} to {stated[1]:g} does not hold {low:g} to {high:g}"
        scaling = scaling.less(0.6, why)
    if name.endswith("_pressure_kpa") and -GAUGE_KPA[1] <= carried[0] <= -GAUGE_KPA[0]:
        why = f"its values begin at {carried[0]:g} kPa: a gauge pressure, which needs an offset?"
        scaling = scaling.less(0.5, why)
    return scaling


def _is_power_of_two(signal: Signal) -> bool:
    """Return whether the range ends where some bits do: an editor wrote it."""
    if signal.maximum is None or not math.isfinite(signal.maximum):
        return False
    end = int(signal.maximum)
    return signal.maximum == end and end > 0 and (end + 1) & end == 0
