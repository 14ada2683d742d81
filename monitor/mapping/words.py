"""The words of this trade, and how sure a name is of a quantity.

Names are English, German or abbreviations. A concept is a set of words; one that ends in ``*`` may
stand inside of a longer word that known words fill, ``=name`` is a whole name without underscores.
A phrase is a set of concepts that must all occur.
"""

import re
from collections.abc import Mapping
from functools import cache
from typing import Final

CONCEPTS: Final[dict[str, str]] = {
    "engine": "engine* eng motor* mot mo moteur* crank* ice",
    "speed": "regime* speed* spd drehzahl* rpm revs revolution* vitesse*",
    "rpm": "rpm =n =nw upm",
    "revolutions": "drehzahl* nmot neng =motrpm",
    "n": "n",
    "v": "v",
    "vehicle": "vehicul* vehicle* veh fahrzeug* fzg car road* vhcl",
    "geschwindigkeit": "fahrgeschwindigkeit* geschwindigkeit* geschw* fahrgeschw* vss vfzg "
    "tacho* kmh kph",
    "torque": "torque* trq tq drehmoment* motormoment* moment mmot",
    "throttle": "throttle* thr tps tp drosselklappe* dk wdkba droka* papillon*",
    "position": "position* pos angle* winkel* stellung* valve*",
    "lambda": "lambda* lam lmbd lmd afr uego wideband* lsu ego wbo2 lamsoni",
    "sensor": "sensor* sens snsr sonde* o2 ho2s o2s oxygen*",
    "ratio": "ratio* afr",
    "equivalence": "equivalence* phi eqr",
    "target": "target* tgt trg soll* setpoint* setp sp desired* des demand* dmd command* cmd cmded "
    "request* req wanted* ref reference* nominal*",
    "lambda_target": "afrtgt afrtarget lamsoll* lamsons* lamsbg*",
    "control": "control* ctrl ctl cntrl correct* corr cor regler* regel* trim* faktor* factor* fbk "
    "feedback* adj mod modifier* mult multiplier* comp",
    "trim": "trim* stft shortft* sft",
    "short": "short* stft st kurz*",
    "oxygen": "o2 ho2s o2s oxygen*",
    "fr": "egocor* =frw =frmw =fraw",
    "fuel": "fuel* fl kraftstoff* krst carburant* benzin* afr",
    "mass": "mass* masse* msg qty quantity* menge* am amt amount* charge* fuellung*",
    "air": "air* luft* intake* aspir* afr",
    "cylinder": "cyl cylinder* zyl* stroke* stk hub*",
    "maf": "maf luftmassenstrom* ml mshfm* hfm* airmassflow*",
    "flow": "flow* flw strom* durchfluss* rate*",
    "consumption": "consumption* verbrauch* kvs fco",
    "injection": "inj injection* injected* einspritz* injector*",
    "rail": "frp rail* prist* hdp highpress* fphigh*",
    "high": "high hi hd hoch*",
    "pressure": "frp prist* pressure* press* prs pres druck* fp p",
    "manifold": "manifold* mnfld saugrohr* sgr intake* inlet* imp ansaug* mfld",
    "map": "map saugrohrdruck* =psw psr mapsensor*",
    "temperature": "te temperature* temp* tmp temperatur* t degc",
    "iat": "iat mat tans act",
    "coolant": "coolant* cool kuehlmittel* kuehlwasser* water* clnt ect clt ect cts",
    "ect": "ect clt tmot cts",
    "ambient": "env ambient* amb ots outside* outsd aussen* umgebung* umg outdoor* exterior*",
    "aat": "aat oat tumg tam",
    "baro": "baro* bap atm atmos* luftdruck* pu barometric*",
    "battery": "batt* battery* batterie* bat ub vbat wub ubat bordnetz* kl30 kl15 supply* module* "
    "vbatt accu*",
    "voltage": "v potential* volt* voltage* spannung* vbat vbatt ub wub ubat u tension*",
    "purge": "purge* evap* tev tankentl* canister* cpv aktivkohle* akf",
    "heater": "heater* heating* heiz* heizung* htr",
    "duty": "duty* valve* dc pwm ventil* tastverh* ratio* flow* pct ansteuerung*",
    "closed": "closed* clsd cl geschlossen* closedloop*",
    "loop": "loop* lp regelkreis* closedloop*",
    "active": "active* aktiv* actv act status* state* on enabled* enable* freigabe*",
    "cut": "cut* cutoff* fuelcut* abschalt* shutoff* off",
    "dfco": "dfco dfso schubabschalt* =bsa",
    "ready": "ready* rdy valid* betriebsbereit* bereit* operational* warm",
    "other": "max min lim limit* error* err diff* dev deviation* avg average* mean rel set pre inh "
    "new oil oel egr exh exhaust* abgas* fan",
    "b_lr": "=blr",
    "b_sbb": "=bsbbvk",
}
_NOISE: Final = (  # words that tell no signal from another
    "value val act actual actl is ist istwert w l raw sig signal filt filtered abs absolute sensor "
    "sens ecu ecm pcm dme ems dde obd measured meas gemessen cur current est estimated estmd calc "
    "msr x the of in at b1s1 b1 s1 bank sensor1 bank1 upstream us front vor vk vorkat precat "
    "primary pct percent degc kpa bar rpm kmh kph per and to u16 s16 u8 wert data "
    "info msr crct flt ext rng cst coast ungef approx linear bordnetzbatter snsr analog dig fast "
    "slow high hs ls crk no crankshaft fixed engine eng motor vehicle car pcm has bit "
    "flag rate metering estimate estimated com clu real diag module mdule aout out kombi vlt mph"
)
NOISE: Final = frozenset(_NOISE.split())
_STEMS: Final = {concept: stems.split() for concept, stems in CONCEPTS.items()}
_CONCEPTS_OF: Final[dict[str, set[str]]] = {}
for _concept, _stems in _STEMS.items():
    for _stem in _stems:
        _CONCEPTS_OF.setdefault(_stem.rstrip("*"), set()).add(_concept)
KNOWN: Final = frozenset(_CONCEPTS_OF)
OTHER: Final = frozenset(word for word, of in _CONCEPTS_OF.items() if of & {"other", "target"})
_FULL: Final = 4  # letters of a word whose ending may be any of as many
_PARTS: Final = frozenset(  # words that may fill a longer one
    [stem[:-1] for stems in _STEMS.values() for stem in stems if stem.endswith("*")]
    + [word for word in (*NOISE, *_CONCEPTS_OF) if len(word) >= _FULL and word[0] != "="]
)
_GLUE: Final = ("", "s", "n", "en", "es")
_SPELLINGS: Final = (
    *zip("äöüßÄÖÜ", ("ae", "oe", "ue", "ss", "Ae", "Oe", "Ue"), strict=True),
    ("λ", " lambda "),
    ("φ", " phi "),
)
_PART: Final = re.compile(
    r"(?:h|wb)?o2s?\d{0,2}(?![a-z])|[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+\d*|[A-Z]+\d*|\d+"
)


@cache
def words_of(name: str) -> tuple[str, ...]:
    """Return the words of a name in small letters; a number at a word's end is its own word.

    >>> words_of("MO_Kuehlmitteltemperatur_01")
    ('mo', 'kuehlmittel', 'temperatur', '01')
    >>> words_of("O2SensorB1S1")
    ('o2', 'sensor', 'b1', 's1')
    """
    # J1939's speed over ground; OBD's number of a value
    text = re.sub(r"(?i)wheel_?based|(?<![a-z])pid_?[0-9a-f]{1,2}_", "", name)
    text = re.sub(r"(?i)\ba/f\b|air/fuel", " afr ", text)
    for letter, plain in _SPELLINGS:
        text = text.replace(letter, plain)
    text = re.sub(r"(?i)(?<![a-z])((?:h|wb)?o2s?)", lambda m: " " + m[1].lower(), text)
    words: list[str] = []
    for part in _PART.findall(text):
        word = part.lower()
        numbered = re.fullmatch(r"(?!(?:h|wb)?o2s?\d*$)([a-z]{2,})(\d+)", word)
        name, *number = numbered.groups() if numbered else [word]
        words += (*(_filled(name) or (name,)), *number)
    return tuple(words)


@cache
def _filled(word: str) -> tuple[str, ...] | None:
    """Return the known words that fill a word, None if none do.

    >>> _filled("motordrehzahl"), _filled("trailer")
    (('motor', 'drehzahl'), None)
    """
    if not word or word in _CONCEPTS_OF or word in NOISE:
        return (word,) if word else ()
    if not word.isalpha():
        return None
    beginnings = [word[:n] for n in range(len(word), 2, -1) if word[:n] in _PARTS]
    for stem in beginnings:
        rest = word[len(stem) :]
        for glue in _GLUE:
            if rest.startswith(glue) and (after := _filled(rest[len(glue) :])) is not None:
                return (stem, *after)
    known = (s for s in beginnings if len(s) >= _FULL and len(word) - len(s) <= _FULL)
    return next(((stem,) for stem in known), None)


def match(phrases: Mapping[str, float], words: tuple[str, ...]) -> tuple[float, list[str]]:
    """Return how sure a name's words are of the best phrase, 0 to 1, and the words left over.

    phrases : concepts, separated by spaces, and how sure they are if nothing else is said
    Words that no concept of the phrase carries and that are not noise count against it, and so does
    a number above 1: a second sensor.

    >>> match({"engine speed": 1.0}, words_of("Motordrehzahl"))
    (1.0, [])
    >>> match({"engine speed": 1.0}, words_of("EngineSpeedGearboxInput"))[1]
    ['gearbox', 'input']
    >>> match({"engine speed": 1.0}, words_of("VehicleSpeed"))
    (0.0, [])
    """
    of_whole = _CONCEPTS_OF.get("=" + "".join(words), set())
    here = {word: _CONCEPTS_OF.get(word, set()) for word in words}
    best: tuple[float, list[str]] = (0.0, [])
    for phrase, weight in phrases.items():
        concepts = set(phrase.split())
        if not concepts <= of_whole.union(*here.values()):
            continue
        rest = [] if concepts & of_whole else [w for w in words if not here[w] & concepts]
        rest = [w for w in rest if not (w in NOISE or (w.isdigit() and int(w) <= 1))]
        sure = weight * (1.0 - 0.35 * len(rest) / len(words))
        if sure > best[0]:
            best = sure, rest
    return best
