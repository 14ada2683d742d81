"""The way from a signal's unit and range to the canonical unit: a stated unit is a constraint."""

import math
from dataclasses import dataclass, field, replace
from typing import Final

from cantools.database.can import Signal

from monitor.base.signals import plausible_range
from monitor.frames.units import UNITS, conversion, unit_of
from monitor.mapping.quantities import GASOLINE_KG_L, LAMBDA_FAMILY, STOICHIOMETRIC, MapQuantity
from monitor.mapping.words import words_of

NO_UNIT: Final = 0.85  # confidence that is left without a unit
UNKNOWN_UNIT: Final = 0.4
ODD: Final = 0.6
GAUGE_KPA: Final = (-110.0, -90.0)  # the atmosphere
FILLERS: Final = (1.0, 255.0, 1023.0)  # that editors write where nobody states a range
FILLER_BITS: Final = 10
MOST_ABOVE: Final = 100.0  # times the plausible range; a stated range beyond has another unit
UNIT_IN_NAME: Final = frozenset({"rpm", "kph", "kmh", "mph"})
TEMPERATURE_OFFSETS: Final = (-40.0, -48.0, -50.0, -60.0)  # usual in degC, in no other unit
LEAST_RPM, MOST_RPM = 5000.0, 20_000.0  # every engine's signal reaches beyond; few that high
FINE: Final = 0.01  # steps of lambda
PRESSURES_KPA: Final = ((8.0, "bar"), (700.0, "kpa"), (math.inf, "hpa"))  # up to, in words
RAIL_KPA: Final = ((60.0, "mpa"), (600.0, "bar"), (math.inf, "kpa"))


@dataclass(frozen=True, slots=True)
class UnitScaling:
    """value = factor * signal + offset, in the canonical unit."""

    why: tuple[str, ...] = ()
    factor: float = 1.0
    offset: float = 0.0
    weight: float = 1.0  # confidence that is left
    is_phi: bool = False  # the signal is 1 / lambda
    doubts: tuple[str, ...] = field(default=())

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


def scaling_of(name: str, signal: Signal, quantity: MapQuantity) -> UnitScaling | None:
    """Return the way to the canonical unit, None if the signal is another quantity."""
    written = (signal.unit or "").strip()
    unit = unit_of(written, STOICHIOMETRIC)
    is_number = unit is not None and unit == UNITS["-"]
    scaling: UnitScaling | None
    if quantity.is_flag:
        return _flag(signal) if is_number or not written else None
    if name in LAMBDA_FAMILY and (unit is None or unit.quantity in ("lambda", "phi", "share")):
        scaling = _mixture(name, signal, written)
    elif unit is None or is_number:
        scaling = _assumed(name, signal, quantity)
        if written and not is_number:
            why = f"its unit {written!r} is not known, taken as it is: check"
            scaling = UnitScaling(
                (why,), weight=UNKNOWN_UNIT, doubts=(f"its unit {written!r} is not known",)
            )
    elif unit.quantity == quantity.unit.quantity:
        scaling = UnitScaling((f"its unit is {written}",), *conversion(unit, quantity.unit))
    elif (unit.quantity, quantity.unit.quantity) in (("volume", "mass"), ("volume flow", "flow")):
        if name not in ("fuel_mass_mg", "fuel_flow_kg_h"):
            return None
        scaling = UnitScaling((f"its unit is {written}",), unit.factor * GASOLINE_KG_L)
    else:
        return None
    return scaling and _plausible(scaling, name, signal, quantity)


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


def _assumed(name: str, signal: Signal, quantity: MapQuantity) -> UnitScaling:
    """Return the scaling of the unit that name and range suggest; doubted if they leave several."""
    low, high = span(signal)
    kind, unit = quantity.unit.quantity, quantity.unit
    if kind == "pressure":
        steps = PRESSURES_KPA if unit == UNITS["kpa"] else RAIL_KPA
        most = max(abs(low), abs(high))
        unit = UNITS[next(text for end, text in steps if most <= end)]
    factor = 100.0 if kind == "share" and high <= 1.5 else 1.0
    factor, offset = conversion(unit, quantity.unit) if kind == "pressure" else (factor, 0.0)
    is_plain = (
        bool(UNIT_IN_NAME & set(words_of(signal.name)))
        or (kind == "temperature" and float(signal.offset) in TEMPERATURE_OFFSETS)
        or (kind == "speed of rotation" and low >= 0.0 and LEAST_RPM < high <= MOST_RPM)
    )
    why = ("no unit is given, taken for the one that its range suggests: check",)
    return UnitScaling(
        why, factor, offset, NO_UNIT, doubts=() if is_plain else ("no unit is given",)
    )


def _flag(signal: Signal) -> UnitScaling | None:
    """Return the scaling of a flag, which turns it round where 1 stands for the contrary."""
    if signal.length > 8 or signal.is_float or span(signal, declared=False)[1] < 1.0:
        return None
    contrary = {"open", "openloop", "not", "inactive", "invalid", "inaktiv"} & set(
        words_of(signal.name)
    )
    why = f"a flag of {signal.length} bits"
    choices = {int(k): str(v).lower() for k, v in (signal.choices or {}).items()}
    if 1 in choices:
        why += f", where 1 is {choices[1]!r}"
        contrary |= {choices[1]} & {"no", "off", "inactive", "open", "aus", "nein"}
    scaling = (
        UnitScaling((why + ", turned round",), -1.0, 1.0, 0.8) if contrary else UnitScaling((why,))
    )
    if signal.length > 2 and span(signal)[1] > 1.0:
        unclear = f"a flag of {signal.length} bits without the meaning of its values"
        return scaling if choices else scaling.less(0.7, unclear)
    return scaling


def _mixture(name: str, signal: Signal, written: str) -> UnitScaling | None:
    """Return the scaling of lambda, AFR or phi, or of a trim."""
    unit = unit_of(written, STOICHIOMETRIC)
    is_share = unit is not None and unit.quantity == "share"
    if written and unit is None:
        return None
    if name == "lambda_controller":
        return _trim(signal, f"in {written}, " if is_share else "")
    words = set(words_of(signal.name))
    if (unit is not None and unit.quantity == "phi") or words & {"phi", "equivalence", "eqr"}:
        return UnitScaling(("an equivalence ratio: lambda is 1 / it",), is_phi=True)
    named = "afr" in words or {"air", "fuel"} <= words
    ratio = unit.factor if unit is not None else 1.0
    if ratio == 1.0 and named and span(signal)[1] > 5.0:
        ratio = 1.0 / STOICHIOMETRIC
    if ratio != 1.0:
        why = f"an air-fuel ratio, divided by {1 / ratio:g}: check what {signal.name} counts with"
        return UnitScaling((why,), ratio)
    is_fine = written or abs(float(signal.scale)) <= FINE
    return None if is_share else UnitScaling(doubts=() if is_fine else ("no unit is given",))


def _trim(signal: Signal, share: str) -> UnitScaling:
    """Return the scaling of a trim, 1 where nothing is corrected; share : its unit of a share."""
    low, high = span(signal)
    if share and low >= 0.0 and high > 110.0:
        sure = 1.0 if high <= 400.0 else 0.5  # beyond, the range is only that of the bits
        return UnitScaling((f"{share}never negative, so 100 is no correction",), 0.01, weight=sure)
    if share or low < 0.0 < high < 0.9:
        return UnitScaling((f"{share}0 is no correction",), 0.01 if share else 1.0, 1.0)
    return UnitScaling(("1 is no correction",))


def _plausible(
    scaling: UnitScaling, name: str, signal: Signal, quantity: MapQuantity
) -> UnitScaling | None:
    """Return the scaling, doubted if its values are odd, None if they are another quantity's."""
    low, high = quantity.typical
    carried, stated = (scaling.values(signal, declared=declared) for declared in (False, True))
    too_coarse = abs(float(signal.scale) * scaling.factor) > (high - low) / 3
    if not carried[0] <= low < high <= carried[1] or (too_coarse and not signal.is_float):
        return None
    most = MOST_ABOVE * max(map(abs, plausible_range(name)))
    end = span(signal)[1]
    is_filler = stated == carried or (
        end == int(min(end, 1e18)) and (int(end) + 1).bit_count() == 1
    )
    if max(map(abs, stated)) > most and not (is_filler or scaling.is_phi):
        scaling = scaling.less(ODD, f"its range reaches {max(stated, key=abs):g}: another unit?")
    if not stated[0] <= low < high <= stated[1]:
        why = f"its range {stated[0]:g} to {stated[1]:g} does not hold {low:g} to {high:g}"
        scaling = scaling.less(ODD, why)
    if name == "engine_speed_rpm" and min(carried[1], stated[1]) <= LEAST_RPM:
        ends = min(carried[1], stated[1])
        scaling = scaling.less(ODD, f"its range ends at {ends:g}: no engine speed, or another unit")
    if name.endswith("_pressure_kpa"):
        if GAUGE_KPA[0] <= carried[0] <= GAUGE_KPA[1]:
            scaling = scaling.less(
                ODD, f"its values begin at {carried[0]:g} kPa: a gauge pressure?"
            )
        elif span(signal)[0] < 0.0:
            scaling = scaling.less(
                1.0, f"its range begins at {span(signal)[0]:g}: a gauge pressure?"
            )
    return scaling
