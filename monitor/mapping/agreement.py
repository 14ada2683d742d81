"""Where name and unit of a signal do not agree with a canonical one: the doubts of a candidate.

A line of the map stands only without a doubt. What makes a name say something else is a word that
the quantity does not explain: a wish, a limit, another machine, a display.
"""

import re
from collections.abc import Iterator
from typing import Final

from cantools.database.can import Message, Signal

from monitor.mapping.meanings import Meaning
from monitor.mapping.own_names import own_name
from monitor.mapping.scaling import span
from monitor.mapping.vocabulary import unexplained, unit_of, words_of

# parts of words that make a signal another quantity, its wish, its limit or a copy of it
_TARGET_WORDS: Final = (
    r"wunsch|soll|target|tgt|desir|request|rqst|reqd|rqd|\breq\b|cmd|command|demand|setpoint|"
    r"\bset\b"
)
_OF_SIGNAL: Final = (
    rf"{_TARGET_WORDS}|limit|\blim\b|lmt|\bmax|\bmin\b|average|\bavg|group|\bgrp|test|"
    r"display|\bdisp\b|"
    r"angez|\bhud\b|\bui\b|rough|low ?res|lores|unterst|\bunt\b|support|assist|\binh|verhinder|"
    r"prevent|disable|invalid|\binv\b|\bpre\b|\brel\b|relativ|lead|object|\bobj\b|track|\bnav|"
    r"toggle|reserve|ladedruck|boost|driver|predict|\bpred|model|calc|raw|offset|"
    r"filter|default|threshold|schwelle|gradient|change|delta|diff|trend|avail|valid|quality|"
    r"\bqf\b|status_|fault|error|fail|backup|redundan|copy|\bfake|unknown|\bnew\b|mode\b|button|"
    r"switch|schalter|cancel|resume|toggl|enable|pedal"
)
# of the signal: another part of the car
_PART: Final = (
    r"wheel|\brad\b|tire|tyre|tpms|steer|lenk|\beps\b|brake|bremse|pump|oil|\boel|turbin|turbo|"
    r"compressor|\bac\b|aircon|cabin|exhaust|abgas|\bnox\b|\begr\b|\bagr\b|gear|getriebe|trans|"
    r"clutch|kuppl|camshaft|nockenw|\bfan|luefter|window|fenster|mirror|spiegel|wiper|wisch|light|"
    r"licht|lamp|(?<!out)door|\btuer|trailer|anhaeng"
)
# of the signal or of its message: an electric machine, other traffic, comfort
_ELSEWHERE: Final = (
    r"seat|sitz|massage|lane|\blka|\bldw|\blda\b|depart|radar|cruise|\bacc\b(?! pedal)|\badr\b|"
    r"hybrid|\bhyb\b|\bhv|\bev\b|\bem ?\d|\bmcu\b|motact|inverter|traction|\bdcdc\b|\bbms\b|"
    r"electric|elektr|charger|heater|heiz|htr|\btrack|\bobj|\blead\b"
)
# what the quantity itself may say of these
_ALLOWED: Final = {
    "lambda_target": _TARGET_WORDS,
    "lambda_measured": r"\bpre\b|valid",
    "lambda_controller": r"\bpre\b|term",
    "sensor_ready": r"\bpre\b|valid|heiz",
    "closed_loop": r"enable|mode\b",
    "purge_duty_percent": r"cmd|command",
    "sensor_heater_percent": r"heater|heiz|htr",
    **dict.fromkeys(
        ("manifold_pressure_kpa", "manifold_temperature_degc", "ambient_temperature_degc"),
        r"int|intk|inlet|air",
    ),
    **dict.fromkeys(("fuel_mass_mg", "rail_pressure_mpa"), r"inj|injector"),
    **dict.fromkeys(("air_mass_mg", "maf_kg_h"), r"int|inlet|intake|air"),
    "battery_voltage_v": r"u?lo|lv",  # of a car with a traction battery
    "vehicle_speed_km_h": r"\bbrk\b|\babs\b|\besp\b|\bdsc\b|speed",  # the ECU that measures it
}
_ENGINE: Final = r"eng|mot|mo\b|\bmd|\b(ecm|ems|dme|cmm)\b"
_HARMLESS_WORDS: Final = (  # of a name; they say nothing against the quantity
    "data info signal sig val value msr act actual cur current ist crct flt ext rng cst coast "
    "ungef approx linear bordnetzbatter sensor snsr analog dig fast slow high hs ls obd crk no "
    "crankshaft fixed engine eng motor vehicle car ems ecm pcm x state on is has bit flag rate "
    "metering est estimated estimate com clu real diag meas module mdule aout out "
    "kombi vlt mph kph kmh"
)
_HARMLESS: Final = frozenset(_HARMLESS_WORDS.split())
_THING_WORDS: Final = "engine eng motor vehicle car crankshaft crk ems ecm pcm"
_ENGLISH: Final = frozenset({"rpm", "speed", "torque"})
_SHORT: Final = 3  # letters of an abbreviation
_PREFIX_LETTERS: Final = 4  # a name may begin with so short an abbreviation of its ECU
_BARE_WORDS: Final = (  # of any machine; an unknown word beside them says of which
    "rpm speed spd torque trq tq temp temperature pressure press voltage volt drehzahl n v t u p "
    "trim air flow geschw"
)
_BARE: Final = frozenset(_BARE_WORDS.split()) | (_HARMLESS - set(_THING_WORDS.split()))
_TEMPERATURE_OFFSETS: Final = (-40.0, -48.0, -50.0, -60.0)  # usual in degC, in no other unit
_UNIT_IN_NAME: Final = {
    "rotation": frozenset({"rpm"}),
    "speed": frozenset({"kph", "kmh", "mph"}),
}
_LEAST_RPM: Final = 5000.0  # every engine's signal reaches beyond
_HIGHEST_RPM: Final = 20_000.0  # a range below it and above 4000 is in 1/min


def doubts(name: str, meaning: Meaning, message: Message, signal: Signal) -> Iterator[str]:
    """Yield why a signal may not be the canonical one ``name``, in words."""
    words = words_of(own_name(message, signal))
    yield from _by_name(name, meaning, message, signal, words)
    yield from _by_unit(name, meaning, signal, words)
    end = min(span(signal, declared=declared)[1] for declared in (False, True))
    if name == "engine_speed_rpm" and end * _per_min(signal) <= _LEAST_RPM:
        yield f"its range ends at {end:g}: no engine speed, or another unit"
    if name.endswith("_pressure_kpa") and span(signal)[0] < 0.0:
        yield f"its range begins at {span(signal)[0]:g}: a gauge pressure?"
    if name == "vehicle_speed_km_h" and _is_bare(words) and unit_of(signal.unit) == unit_of("m/s"):
        yield "any speed in m/s: perhaps of an object ahead"


def _per_min(signal: Signal) -> float:
    unit = unit_of(signal.unit)
    return unit.factor if unit is not None and unit.dimension == "rotation" else 1.0


def _is_bare(words: tuple[str, ...]) -> bool:
    return not {"vehicle", "veh", "car", "fahrzeug"} & set(words)


def _by_name(
    name: str, meaning: Meaning, message: Message, signal: Signal, words: tuple[str, ...]
) -> Iterator[str]:
    allowed = _ALLOWED.get(name, r"(?!)")
    own, full, of_message = (
        re.sub(allowed, "", " ".join(w))
        for w in (words, words_of(signal.name), words_of(message.name))
    )
    # a prefix that all signals of a message have may name the device
    for pattern, text in ((_OF_SIGNAL, own), (_PART, own), (_ELSEWHERE, full)):
        if qualified := re.search(pattern, text):
            yield f"its name says {qualified[0].strip()!r}"
            return
    if "motor" in words and _ENGLISH & set(words):
        yield "its name says 'motor', which is an electric one in English"
        return
    if name == "engine_torque_nm" and not re.search(_ENGINE, f"{own} {of_message}"):
        yield "its name does not say that the torque is the engine's"
        return
    # an abbreviation says little: its message must not name another part of the car
    is_short = max(map(len, words), default=0) <= _SHORT
    about = f"{_ELSEWHERE}|{_PART}" if is_short else _ELSEWHERE
    if elsewhere := re.search(about, of_message):
        yield f"its message {message.name} says {elsewhere[0].strip()!r}"
        return
    rest = unexplained(meaning.phrases, words)
    if rest is None:
        rest = _beside_message(meaning, message, words)
    if rest is None:
        yield "only its message or its comment says so"
        return
    rest = [w for w in rest if not re.fullmatch(allowed, w)]
    own_prefix = words[0] in words_of(message.name) or not _is_bare_quantity(words[1:])
    odd = [w for w in rest if w not in _HARMLESS and not (own_prefix and _is_prefix(w, words))]
    if odd:
        yield f"its name says {odd[0]!r}, too"


def _beside_message(meaning: Meaning, message: Message, words: tuple[str, ...]) -> list[str] | None:
    """Return the words that name and message leave over of the name; None if it says nothing."""
    rest = unexplained(meaning.phrases, words + words_of(message.name))
    own = [w for w in words if rest is not None and w in rest]
    return own if rest is not None and len(own) < len(words) else None


def _is_bare_quantity(words: tuple[str, ...]) -> bool:
    """Return whether the words name a quantity, but not of which thing."""
    return all(w in _BARE or w.isdigit() for w in words)


def _is_prefix(word: str, words: tuple[str, ...]) -> bool:
    return word == words[0] and len(word) <= _PREFIX_LETTERS


def _by_unit(name: str, meaning: Meaning, signal: Signal, words: tuple[str, ...]) -> Iterator[str]:
    if meaning.is_flag:
        if signal.length > 2 and span(signal)[1] > 1.0 and not signal.choices:
            yield f"a flag of {signal.length} bits without the meaning of its values"
        return
    written = (signal.unit or "").strip()
    if unit_of(written) is not None:
        if unit_of(written) == unit_of("-") and not {"number", "afr", "phi"} & set(
            meaning.dimensions
        ):
            yield "it has no unit"
        return
    if written:
        yield f"its unit {written!r} is not known"
    elif not _is_plain_without_unit(name, meaning, signal, words):
        yield "no unit is given"


def _is_plain_without_unit(
    name: str, meaning: Meaning, signal: Signal, words: tuple[str, ...]
) -> bool:
    """Return whether range and steps leave one unit only."""
    low, high = span(signal)
    for dimension in meaning.dimensions:
        if _UNIT_IN_NAME.get(dimension, frozenset()) & set(words):
            return True
    if "temperature" in meaning.dimensions:
        return float(signal.offset) in _TEMPERATURE_OFFSETS
    if "rotation" in meaning.dimensions:
        return low >= 0.0 and 5000.0 < high <= _HIGHEST_RPM
    if name.startswith("lambda_"):
        return abs(float(signal.scale)) <= 0.01
    return False
