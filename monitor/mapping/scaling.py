"""From a signal's unit and range to the canonical unit."""

import math
from dataclasses import replace
from typing import Final

from cantools.database.can import Signal

from monitor.mapping.candidate import Candidate
from monitor.mapping.meanings import LAMBDA_FAMILY, Meaning
from monitor.mapping.units import Unit, unit_of
from monitor.mapping.words import words_of

STOICHIOMETRIC: Final = 14.7  # kg of air per kg of gasoline, what AFR gauges mostly count with
GAUGE_KPA: Final = (90.0, 110.0)  # the atmosphere
MIXTURE: Final = ("number", "ratio", "afr", "phi")


def scaled(make: Candidate, meaning: Meaning) -> Candidate | None:
    """Return factor and offset to the canonical unit, None if the unit is another quantity's."""
    given = (make.signal.unit or "").strip()
    unit = unit_of(given)
    if meaning.is_flag:
        return _flag(make, given)
    if make.name in LAMBDA_FAMILY and (unit is None or unit.dimension in MIXTURE):
        return _mixture(make, unit, given)
    if unit is not None and unit.dimension in meaning.dimensions:
        return _converted(make, meaning, unit, f"its unit is {given}")
    if unit is not None and unit.dimension not in ("number",):
        return None
    if given and unit is None:
        return replace(
            make,
            confidence=0.4 * meaning.without_unit,
            why=(f"its unit {given!r} is not known, taken as it is: check",),
        )
    return _without_unit(make, meaning)


def _converted(make: Candidate, meaning: Meaning, unit: Unit, why: str) -> Candidate:
    per_base = meaning.dimensions[unit.dimension]
    return replace(make, factor=unit.factor * per_base, offset=unit.offset * per_base, why=(why,))


def _without_unit(make: Candidate, meaning: Meaning) -> Candidate | None:
    """Return the candidate with a unit guessed from its range."""
    if meaning.without_unit == 0.0:
        return None
    low, high = span(make.signal)
    if "pressure" in meaning.dimensions:
        largest = max(abs(low), abs(high))
        steps = (("MPa", 1000.0, 60.0), ("bar", 100.0, 600.0), ("kPa", 1.0, math.inf))
        if meaning.dimensions["pressure"] == 1.0:
            steps = (("bar", 100.0, 8.0), ("kPa", 1.0, 700.0), ("hPa", 0.1, math.inf))
        unit, factor, _ = next(step for step in steps if largest <= step[2])
        return replace(
            make,
            factor=factor * meaning.dimensions["pressure"],
            confidence=meaning.without_unit,
            why=(f"no unit is given; up to {largest:g} it is taken for {unit}: check",),
        )
    factor = 100.0 if "ratio" in meaning.dimensions and high <= 1.5 else 1.0
    return replace(
        make,
        factor=factor,
        confidence=meaning.without_unit,
        why=("no unit is given, taken for the canonical one: check",),
    )


def _flag(make: Candidate, given: str) -> Candidate | None:
    """Return a flag, turned round where 1 stands for the contrary."""
    signal = make.signal
    if signal.length > 8 or signal.is_float or (given and unit_of(given) is None):
        return None
    if given and unit_of(given) != unit_of("-"):
        return None
    words = words_of(signal.name)
    contrary = {"open", "openloop", "not", "inactive", "invalid", "inaktiv"} & set(words)
    why = f"a flag of {signal.length} bits"
    choices = {int(k): str(v).lower() for k, v in (signal.choices or {}).items()}
    if 1 in choices:
        why += f", where 1 is {choices[1]!r}"
        contrary |= {w for w in ("no", "off", "inactive", "open", "aus", "nein") if choices[1] == w}
    if contrary:
        return replace(make, factor=-1.0, offset=1.0, confidence=0.8, why=(why + ", turned round",))
    one_bit = signal.length <= 2 or span(signal)[1] <= 1.0
    return replace(make, confidence=1.0 if one_bit else 0.7, why=(why,))


def _mixture(make: Candidate, unit: Unit | None, given: str) -> Candidate | None:
    """Return lambda, AFR, phi or a trim on the canonical scale."""
    if given and unit is None:
        return None
    if make.name == "lambda_controller":
        return _trim(make, unit, given)
    words = set(words_of(make.signal.name))
    dimension = unit.dimension if unit else ""
    if dimension == "ratio":
        return None
    if dimension == "phi" or words & {"phi", "equivalence", "eqr"}:
        return replace(make, is_phi=True, why=("an equivalence ratio: lambda is 1 / it",))
    is_named_afr = "afr" in words or {"air", "fuel"} <= words
    if dimension == "afr" or (is_named_afr and span(make.signal)[1] > 5.0):
        why = (
            f"an air-fuel ratio, divided by {STOICHIOMETRIC:g}: check what "
            f"{make.signal.name} counts with"
        )
        return replace(make, factor=1 / STOICHIOMETRIC, why=(why,))
    return replace(make, why=(f"its unit is {given}",) if given and given != "-" else ())


def _trim(make: Candidate, unit: Unit | None, given: str) -> Candidate:
    low, high = span(make.signal)
    if unit is not None and unit.dimension == "ratio":
        if low >= 0.0 and high > 110.0:
            sure = 1.0 if high <= 400.0 else 0.5  # without a range of its own nothing is said
            why = f"in {given} and never negative, so 100 is no correction: check"
            return replace(make, factor=unit.factor, confidence=sure, why=(why,))
        why = f"in {given}, 0 is no correction"
        return replace(make, factor=unit.factor, offset=1.0, why=(why,))
    if low < 0.0 < high < 0.9:
        return replace(make, offset=1.0, why=("0 is no correction",))
    return replace(make, why=("1 is no correction",))


def span(signal: Signal, *, declared: bool = True) -> tuple[float, float]:
    """Return the range of the signal's values, in its own unit.

    declared : the one the database states, if it states one, else what its bits can carry
    """
    if declared and signal.minimum is not None and signal.maximum is not None:
        low, high = float(signal.minimum), float(signal.maximum)
        if low < high:
            return low, high
    if signal.is_float:
        return -1e30, 1e30
    bits = signal.length
    raw = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signal.is_signed else (0, (1 << bits) - 1)
    ends = [float(each) * float(signal.scale) + float(signal.offset) for each in raw]
    return min(ends), max(ends)


def in_range(candidate: Candidate, meaning: Meaning) -> Candidate | None:
    """Return the candidate if its values can be what they should be."""
    low, high = meaning.typical
    if meaning.is_flag:
        return candidate if span(candidate.signal, declared=False)[1] >= 1.0 else None
    for declared in (False, True):
        ends = [
            each * candidate.factor + candidate.offset
            for each in span(candidate.signal, declared=declared)
        ]
        if candidate.is_phi:
            ends = [0.5, 2.0] if max(ends) >= 1.1 else [0.0, 0.0]
        if min(ends) <= low and max(ends) >= high:
            continue
        if not declared:
            return None  # its bits cannot carry it
        said = f"its range {min(ends):g} to {max(ends):g} does not hold {low:g} to {high:g}"
        candidate = replace(
            candidate, confidence=0.6 * candidate.confidence, why=(*candidate.why, said)
        )
    if "pressure" in meaning.dimensions and candidate.name.endswith("_kpa"):
        candidate = _absolute(candidate)
    step = abs(float(candidate.signal.scale) * candidate.factor)
    if step > (high - low) / 3 and not candidate.signal.is_float:
        return None  # too coarse
    return candidate


def _absolute(candidate: Candidate) -> Candidate:
    """Return a pressure, less sure if its zero seems to be the atmosphere."""
    lowest = min(
        each * candidate.factor + candidate.offset
        for each in span(candidate.signal, declared=False)
    )
    if not -GAUGE_KPA[1] <= lowest <= -GAUGE_KPA[0]:
        return candidate
    why = f"its values begin at {lowest:g} kPa: a gauge pressure, which needs an offset?"
    return replace(candidate, confidence=0.5 * candidate.confidence, why=(*candidate.why, why))
