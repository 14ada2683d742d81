"""The words of a name, the quantities, and how sure words are of one, by ``vocabulary.toml``."""

import re
import tomllib
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final

from monitor.base.signals import BY_NAME
from monitor.frames.profiles.profile import STOICH_AFR
from monitor.frames.units import Unit, unit_of

VOCABULARY: Final = tomllib.loads(
    files("monitor.mapping").joinpath("vocabulary.toml").read_text("utf-8")
)
FUEL_FLOW_NAME: Final = "fuel_flow_kg_h"  # not canonical: fuel per stroke follows from it
WORDS: Final = {name: frozenset(text.split()) for name, text in VOCABULARY["words"].items()}
_STEMS: Final = [(s, name) for name, text in VOCABULARY["concepts"].items() for s in text.split()]
_CONCEPTS_OF: Final[dict[str, set[str]]] = {}
for _stem, _concept in _STEMS:
    _CONCEPTS_OF.setdefault(_stem.rstrip("*"), set()).add(_concept)
_FULL: Final = 4  # letters of a word whose ending may be any of as many
_PARTS: Final = {  # words that may fill a longer one
    *(stem[:-1] for stem, _ in _STEMS if stem.endswith("*")),
    *(word for word in (*WORDS["noise"], *_CONCEPTS_OF) if len(word) >= _FULL and word[0] != "="),
}
_STEM: Final = re.compile("|".join(sorted(_PARTS, key=len, reverse=True)))
_LETTER: Final = r"[^\W\d]"
_COMPOUND: Final = re.compile(
    rf"(?:(?:{_STEM.pattern})(?:s|n|en|es)?)+"
    rf"|(?={_LETTER}{{{_FULL}}})(?:{_STEM.pattern}){_LETTER}{{0,{_FULL}}}"
)
_LETTERS: Final = str.maketrans(VOCABULARY["letters"])
_UPPER, _LOWER = "[A-ZА-Я]", r"[^\W\d_A-ZА-Я]"  # of any script
_PART: Final = re.compile(
    rf"(?:(?:h|wb)?o2s?\d{{0,2}}|[khM]Pa|inHg|mmHg|mBar)(?![a-z])|{_UPPER}+(?={_UPPER}{_LOWER})"
    rf"|{_UPPER}?{_LOWER}+\d*|{_UPPER}+\d*|\d+"
)


@cache
def words_of(name: str) -> tuple[str, ...]:
    """Return the words of a name in small letters; a number at a word's end is its own word.

    >>> words_of("MO_Kuehlmitteltemperatur_01")
    ('mo', 'kuehlmittel', 'temperatur', '01')
    >>> words_of("O2SensorB1S1")
    ('o2', 'sensor', 'b1', 's1')
    """
    for pattern, instead in VOCABULARY["spellings"]:
        name = re.sub(pattern, instead, name)
    text = unicodedata.normalize("NFKD", name.translate(_LETTERS))
    text = "".join(letter for letter in text if not unicodedata.combining(letter))
    words: list[str] = []
    for part in _PART.findall(text):
        word = part.lower()
        numbered = re.fullmatch(r"(?!(?:h|wb)?o2s?\d*$)([^\W\d]{2,})(\d+)", word)
        bare, *number = numbered.groups() if numbered else [word]
        words += (*_filled(bare), *number)
    return tuple(words)


@cache
def _filled(word: str) -> tuple[str, ...]:
    """Return the known words that fill a word, else the word.

    >>> _filled("motordrehzahl"), _filled("trailer")
    (('motor', 'drehzahl'), ('trailer',))
    """
    if word in _CONCEPTS_OF or word in WORDS["noise"] or not _COMPOUND.fullmatch(word):
        return (word,)
    return tuple(_STEM.findall(word))


def match(phrases: Mapping[str, float], words: tuple[str, ...]) -> tuple[float, list[str]]:
    """Return how sure a name's words are of the best phrase, 0 to 1, and the words left over.

    phrases : concepts, separated by spaces, and how sure they are if nothing else is said
    Words that no concept of the phrase carries and that are not noise count against it, and so does
    a number above 1: a second sensor.

    >>> match({"engine revolutions": 1.0}, words_of("Motordrehzahl"))
    (1.0, [])
    >>> match({"engine speed": 1.0}, words_of("EngineSpeedGearboxInput"))[1]
    ['gearbox', 'input']
    >>> match({"engine speed": 1.0}, words_of("VehicleSpeed"))
    (0.0, [])
    """
    of_whole = _CONCEPTS_OF.get("=" + "".join(words), set())
    here = {word: _CONCEPTS_OF.get(word, set()) for word in words}
    known, own = of_whole.union(*here.values()), set(" ".join(phrases).split())
    sure = max(
        (weight for each, weight in phrases.items() if known.issuperset(each.split())), default=0.0
    )
    rest = [] if own & of_whole or not sure else [w for w in words if not here[w] & own]
    rest = [w for w in rest if not (w in WORDS["noise"] or (w.isdigit() and int(w) <= 1))]
    return sure * (1.0 - 0.35 * len(rest) / max(1, len(words))), rest


@dataclass(frozen=True, slots=True)
class MapQuantity:
    """One canonical signal as a database may describe it."""

    name: str
    unit: Unit  # the canonical one
    phrases: dict[str, float]  # see ``match``
    typical: tuple[float, float]  # a signal that cannot carry these values is another quantity
    also: frozenset[str]  # words that may stand beside those of a phrase
    one_sensor: bool = False  # must be upstream, of the first bank
    volume: str = ""  # quantity of units that the density converts
    most: float = 0.0  # of a usual median, 0: 1.5 times the highest typical value

    @property
    def usual(self) -> tuple[float, float]:
        """Return the range of the median of a drive."""
        return 0.7 * self.typical[0], self.most or 1.5 * self.typical[1]

    @property
    def is_flag(self) -> bool:
        """Return whether it is 0 or 1."""
        return self.typical[0] == self.typical[1]


def _quantity(name: str, row: dict[str, Any]) -> MapQuantity:
    unit = unit_of(row.pop("unit", "") or BY_NAME[name].unit, STOICH_AFR)
    assert unit is not None
    (low, high), also = row.pop("typical"), frozenset(row.pop("also", "").split())
    return MapQuantity(name, unit, typical=(low, high), also=also, **row)


QUANTITIES: Final = {
    name: _quantity(name, {**row}) for name, row in VOCABULARY["quantities"].items()
}
