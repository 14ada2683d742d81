"""The words of this trade: the meaning of names and units in a database.

Names are English, German or abbreviations. A concept is a set of stems: one that ends in ``*``
matches anywhere in a name, any other one a whole word; ``=name`` is the whole name but for endings
such as ``_w``. A phrase is a set of concepts that must all occur.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

CONCEPTS: Final[dict[str, str]] = {
    "engine": "engine* eng motor* mot mo moteur* crank* ice",
    "speed": "regime* speed* spd drehzahl* rpm revs revolution* vitesse*",
    "rpm": "rpm =n upm",
    "revolutions": "drehzahl* =nmot nmot =neng neng =motrpm",
    "n": "n",
    "v": "v",
    "vehicle": "vehicul* vehicle* veh fahrzeug* fzg car road* vhcl",
    "geschwindigkeit": "fahrgeschwindigkeit* geschwindigkeit* geschw* fahrgeschw* vss =vfzg vfzg "
    "tacho* kmh kph",
    "torque": "torque* trq tq drehmoment* motormoment* moment mmot",
    "throttle": "throttle* thr tps tp drosselklappe* dk wdkba droka* papillon*",
    "position": "position* pos angle* winkel* stellung* valve*",
    "lambda": "lambda* lam lmbd lmd afr uego wideband* lsu ego wbo",
    "lambda_measured": "lamsoni* lambdaist* lambdasonde*",
    "lambda_target": "afrtgt* afrtarget* lamsoll* lamsons* lambdasoll* lamsbg*",
    "sensor": "sensor* sens snsr sonde* o2 ho2s o2s oxygen*",
    "ratio": "ratio*",
    "equivalence": "equivalence* phi eqr",
    "airfuel": "airfuel* afr",
    "target": "target* tgt trg soll* setpoint* setp sp desired* des demand* dmd command* cmd cmded "
    "request* req wanted* ref reference* nominal*",
    "control": "control* ctrl ctl cntrl correct* corr cor regler* regel* trim* faktor* factor* fbk "
    "feedback* adj",
    "trim": "trim* stft shortft* sft",
    "short": "short* stft st kurz*",
    "oxygen": "o2 ho2s o2s oxygen*",
    "fr": "egocor* =fr =frm =fra",
    "fuel": "fuel* fl kraftstoff* krst carburant* benzin*",
    "mass": "mass* masse* msg qty quantity* menge* am amt amount* charge* fuellung*",
    "air": "air* luft* intake* aspir*",
    "cylinder": "cyl cylinder* zyl* stroke* stk hub* perstroke*",
    "maf": "maf luftmassenstrom* =ml ml mshfm* hfm* airmassflow*",
    "flow": "flow* flw strom* durchfluss* rate* massflow*",
    "consumption": "consumption* verbrauch* kvs fco",
    "injection": "inj injection* injected* einspritz* injector*",
    "rail": "frp rail* prist* hdp highpress* fphigh*",
    "high": "high hi hd hoch*",
    "pressure": "frp pressure* press prs pres druck* fp p",
    "manifold": "manifold* mnfld saugrohr* sgr intake* inlet* imp ansaug* mfld",
    "map": "map saugrohrdruck* =ps psr mapsensor*",
    "boost": "boost* ladedruck* ldr",
    "temperature": "te temperature* temp tmp temperatur* t degc",
    "iat": "iat mat tans act",
    "coolant": "coolant* cool kuehlmittel* kuehlwasser* water* clnt ect clt ect cts",
    "ect": "ect clt tmot cts",
    "ambient": "env ambient* amb ots outside* outsd aussen* umgebung* umg outdoor* exterior*",
    "aat": "aat oat tumg tam",
    "baro": "baro* bap atm atmos* luftdruck* =pu pu barometric*",
    "battery": "batt* bat ub vbat wub ubat bordnetz* kl30 kl15 supply* module* vbatt accu*",
    "voltage": "v potential* volt* spannung* vbat vbatt ub wub ubat u tension*",
    "purge": "purge* evap* tev tankentl* canister* cpv aktivkohle* akf",
    "heater": "heater* heating* heiz* htr",
    "duty": "duty* valve* dc pwm ventil* tastverh* ratio* flow* pct ansteuerung*",
    "closed": "closed* clsd cl geschlossen* closedloop*",
    "loop": "loop* lp regelkreis* closedloop*",
    "open": "open* openloop*",
    "active": "active* aktiv* actv act status* state* on enabled* enable* freigabe*",
    "cut": "cut* cutoff* fuelcut* abschalt* shutoff* off",
    "dfco": "dfco dfso schubabschalt* =b_sa =sa",
    "ready": "ready* rdy valid* betriebsbereit* bereit* operational* warm",
    "b_lr": "=b_lr =blr",
    "b_sbb": "=b_sbbvk =bsbbvk",
    "outside_air": "aussentemp* aussenluft* otsair*",
}

_NOISE: Final = (  # words that tell no signal from another
    "value val act actual actl ist istwert w l raw sig signal filt filtered abs absolute sensor "
    "sens ecu ecm pcm dme ems dde obd measured meas gemessen cur current est estimated calc msr x "
    "the of in at b1s1 b1 s1 bank sensor1 bank1 upstream us pre front vor vk vorkat precat primary "
    "status pct percent degc kpa bar rpm kmh kph commanded per and to u16 s16 u8 wert"
)
NOISE: Final = frozenset(_NOISE.split())
_STEMS: Final = {concept: stems.split() for concept, stems in CONCEPTS.items()}
_EVERY_STEM: Final = frozenset(stem for stems in _STEMS.values() for stem in stems)
_INSIDE: Final = [
    (stem[:-1], concept)
    for concept, stems in _STEMS.items()
    for stem in stems
    if stem.endswith("*") and not stem.startswith("=")
]
_SPELLINGS: Final = (
    *zip("äöüßÄÖÜ", ("ae", "oe", "ue", "ss", "Ae", "Oe", "Ue"), strict=True),
    ("λ", " lambda "),
    ("φ", " phi "),
)
_PART: Final = re.compile(
    r"h?o2s?\d{0,2}(?![a-z])|[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+\d*|[A-Z]+\d*|\d+"
)
_LEAST_LETTERS: Final = 3  # of a stem inside of a longer word
_ENDINGS: Final = ("w", "l", "raw", "01", "1")  # of a name, without a meaning


@cache
def words_of(name: str) -> tuple[str, ...]:
    """Return the words of a name in small letters; a number at a word's end is its own word.

    >>> words_of("MO_KuehlmittelTemp_01")
    ('mo', 'kuehlmittel', 'temp', '01')
    >>> words_of("O2SensorB1S1")
    ('o2', 'sensor', 'b1', 's1')
    """
    text = re.sub(r"(?i)wheel_?based", "", name)  # J1939's speed over ground
    for letter, plain in _SPELLINGS:
        text = text.replace(letter, plain)
    text = re.sub(r"(?i)(?<![a-z])(h?o2s?)", lambda m: " " + m[1].lower(), text)
    words: list[str] = []
    for part in _PART.findall(text):
        word = part.lower()
        numbered = re.fullmatch(r"(?!h?o2s?\d*$)([a-z]{2,})(\d+)", word)
        words += numbered.groups() if numbered else [word]
    return tuple(words)


@cache
def _letters() -> re.Pattern[str]:
    """Return the pattern of a word that known words fill but for an ending of the last."""
    stems = {stem.strip("=*").replace("_", "") for stems in _STEMS.values() for stem in stems}
    long = sorted((s for s in stems | NOISE if len(s) >= _LEAST_LETTERS), key=len, reverse=True)
    short, full = ("|".join(s for s in long if (len(s) > 3) == more) for more in (False, True))
    return re.compile(rf"(?:(?:{full}|{short})(?:en|es|s|n)?|(?:{full})\w{{0,4}})+")


def is_made_of_known(word: str) -> bool:
    """Return whether known words fill a word; a stem behind other letters says nothing.

    >>> is_made_of_known("motordrehzahl"), is_made_of_known("battery"), is_made_of_known("trailer")
    (True, True, False)
    """
    return _letters().fullmatch(word) is not None


@cache
def _concepts(words: tuple[str, ...]) -> frozenset[str]:
    """Return the concepts that a name may carry: ``_told`` of any other one is empty."""
    name = "".join(words)
    found = {concept for stem, concept in _INSIDE if stem in name}
    for each in (*words, f"={_without_endings(words)}"):
        found.update(_BY_WORD.get(each, ()))
    return frozenset(found)


def _without_endings(words: tuple[str, ...]) -> str:
    return "".join(word for word in words if word not in _ENDINGS)


def _by_word() -> dict[str, list[str]]:
    """Return the concepts of each stem that is a whole word, or with ``=`` a whole name."""
    found: dict[str, list[str]] = {}
    for concept, stems in _STEMS.items():
        for stem in stems:
            if stem.startswith("="):
                found.setdefault(stem.replace("_", ""), []).append(concept)
            elif not stem.endswith("*"):
                found.setdefault(stem, []).append(concept)
    return found


_BY_WORD: Final = _by_word()


def _told(concept: str, words: tuple[str, ...]) -> set[str]:
    """Return the words of a name that carry the concept, none if it does not occur."""
    told: set[str] = set()
    name = "".join(words)
    for stem in _STEMS[concept]:
        if stem.startswith("="):
            if _without_endings(words) == stem[1:].replace("_", ""):
                told.update(words)
        elif stem.endswith("*"):
            part = stem[:-1]
            if part in name:
                told |= {w for w in words if part in w or (w in part and len(w) > 2)} | {"*"}
        elif stem in words:
            told.add(stem)
    return told


def carried(phrases: Mapping[str, float]) -> frozenset[str]:
    """Return the stems of the concepts that occur in phrases, without their marks.

    A stem that a meaning's own concepts carry does not speak against it.

    >>> "heiz" in carried({"sensor heater": 1.0}), "heiz" in carried({"lambda": 1.0})
    (True, False)
    """
    concepts = {concept for phrase in phrases for concept in phrase.split()}
    return frozenset(stem.strip("=*") for concept in concepts for stem in _STEMS[concept])


def match(phrases: Mapping[str, float], words: tuple[str, ...]) -> float:
    """Return how sure a name's words are of the best phrase, 0 to 1.

    phrases : concepts, separated by spaces, and how sure they are if nothing else is said
    Words that no concept explains and that are not noise count against a phrase.

    >>> match({"engine speed": 1.0}, words_of("EngineSpeed"))
    1.0
    >>> match({"engine speed": 1.0}, words_of("Motordrehzahl"))
    1.0
    >>> 0 < match({"engine speed": 1.0}, words_of("EngineSpeedGearboxInput")) < 0.9
    True
    >>> match({"engine speed": 1.0}, words_of("VehicleSpeed"))
    0.0
    """
    found = _best(phrases, words)
    return found[0] if found else 0.0


@cache
def _split(phrase: str) -> tuple[str, ...]:
    return tuple(phrase.split())


def _best(phrases: Mapping[str, float], words: tuple[str, ...]) -> tuple[float, list[str]] | None:
    """Return how sure the best phrase is, and the words that it does not explain."""
    best: tuple[float, list[str]] | None = None
    carried_here = _concepts(words)
    for phrase, weight in phrases.items():
        concepts = _split(phrase)
        if not carried_here.issuperset(concepts):
            continue
        told = NOISE.union(*(_told(concept, words) for concept in concepts))
        rest = [w for w in words if w not in told and not w.isdigit()]
        sure = weight * (1.0 - 0.35 * (len(rest) / max(len(words), 1)))
        if best is None or sure > best[0]:
            best = sure, rest
    return best


def unexplained(phrases: Mapping[str, float], words: tuple[str, ...]) -> list[str] | None:
    """Return the words that the best phrase and noise leave over, None if no phrase fits.

    >>> unexplained({"engine speed": 1.0}, words_of("EngineSpeedGearboxInput"))
    ['gearbox', 'input']
    """
    found = _best(phrases, words)
    if found is None:
        return None
    odd = [
        w
        for w in words
        if w not in found[1] and not w.isdigit() and w not in _EVERY_STEM | NOISE
        if not is_made_of_known(w)
    ]
    return found[1] + odd


@dataclass(frozen=True, slots=True)
class UnitWords:
    """A unit: value in the dimension's base unit = factor * value + offset."""

    dimension: str
    factor: float = 1.0
    offset: float = 0.0


# base units: kPa, degC, kg/h, l/h, mg and mm3 per stroke of one cylinder, 1/min, km/h, Nm, V, 1
UNITS: Final[dict[UnitWords, str]] = {  # and the ways databases write them
    UnitWords("pressure"): "kpa kpaa kpaabs kpa(abs) kpa_abs kpag kilopascal",
    UnitWords("pressure", 100.0): "bar bara barabs barg",
    UnitWords("pressure", 0.1): "hpa millibar mbar mbarabs hpaabs hpa_abs mbara",
    UnitWords("pressure", 0.001): "pa",
    UnitWords("pressure", 1000.0): "mpa",
    UnitWords("pressure", 6.894757): "psi psia psig",
    UnitWords("pressure", 3.386389): "inhg",
    UnitWords("pressure", 0.1333224): "mmhg torr",
    UnitWords("pressure", 98.0665): "kgf/cm2 kg/cm2 at",
    UnitWords("temperature"): (
        "degc c °c cel celsius gradc grad_c gradcelsius deg_c ºc grdc degrecelsi degreecelsius "
        "degreescelsius"
    ),
    UnitWords("temperature", 5 / 9, -160 / 9): "degf f °f fahrenheit deg_f ºf",
    UnitWords("temperature", 1.0, -273.15): "k kelvin degk °k",
    UnitWords("mass_flow"): "kg/h kgh kg/hr kgph kg/std",
    UnitWords("mass_flow", 3.6): "g/s gps g/sec grams/sec grams/s gram/s",
    UnitWords("mass_flow", 3600.0): "kg/s",
    UnitWords("mass_flow", 60.0): "kg/min",
    UnitWords("mass_flow", 0.06): "g/min",
    UnitWords("mass_flow", 0.0036): "mg/s",
    UnitWords("mass_flow", 0.001): "g/h",
    UnitWords("mass_flow", 27.21554): "lb/min lbs/min lb/m ppm_air",
    UnitWords("mass_flow", 0.4535924): "lb/h lb/hr lbs/h lbs/hr pph",
    UnitWords("volume_flow"): "l/h lph l/hr l/std liter/h",
    UnitWords("volume_flow", 0.06): "ml/min cc/min ccm cm3/min",
    UnitWords("volume_flow", 3.6): "ml/s cc/s cm3/s",
    UnitWords("volume_flow", 0.0036): "ul/s mm3/s µl/s",
    UnitWords("volume_flow", 3.785412): "gal/h gph gal/hr",
    UnitWords("mass"): "mg mg/stk mg/stroke mg/str mg/hub mg/cyl mg/zyl mg/inj mg/asp mg/cycle",
    UnitWords("mass", 1000.0): "g g/stroke g/stk g/cyl g/hub",
    UnitWords("volume"): "mm3 mm3/stk mm3/stroke mm3/hub ul µl mm^3/stroke mm³/hub",
    UnitWords("rotation"): (
        "rpm 1/min u/min /min min-1 min^-1 upm r/min rev/min tr/min umin rev/minute umdr/min "
        "minutinver"
    ),
    UnitWords("rotation", 60.0): "1/s rps hz u/s rev/s",
    UnitWords("rotation", 9.549297): "rad/s",
    UnitWords("speed"): "km/h kmh kph kmph km/std kilometerperhour kilometperhour",
    UnitWords("speed", 1.609344): "mph mi/h miles/h",
    UnitWords("speed", 3.6): "m/s",
    UnitWords("torque"): "nm n.m n*m newtonmeter n-m newtometer",
    UnitWords("torque", 1.355818): "lbft lb-ft lb*ft ftlb ft-lb lbfft ft.lb",
    UnitWords("voltage"): "v volt volts vdc",
    UnitWords("voltage", 0.001): "mv millivolt",
    UnitWords("ratio", 0.01): "% percent pct prozent proz",
    UnitWords("ratio", 0.001): "‰ permille promille",
    UnitWords("number"): (
        "- 1 la ratio none lambda lam λ unitless factor n/a bit bool boolean on/off flag lambdas"
    ),
    UnitWords("afr"): "afr :1 a/f kg/kg g/g af afratio",
    UnitWords("phi"): "phi φ er eqr",
    UnitWords("other"): (
        "microliter ms s sec min h us km m mm a ma w kw hp ps ohm kohm deg ° °kw degkw degca "
        "°crk grd grad l ml kg count counts g/km l/100km mpg mw rad j kj n kn km/l day month "
        "year hour minute second ca degbtdc m/s2 m/s^2 deg/s °/s kwh ah %/s nm/s"
    ),
}
_UNIT_OF: Final = {written: unit for unit, names in UNITS.items() for written in names.split()}


def _read_again(text: str) -> str:
    """Return UTF-8 that was read as Windows text as it was meant."""
    try:
        return text.encode("cp1252").decode("utf-8")
    except UnicodeError:
        return text


def unit_of(text: str | None) -> UnitWords | None:
    """Return the unit that a database writes, None if it writes none or an unfamiliar one.

    >>> unit_of("U/min").dimension
    'rotation'
    >>> round(unit_of("°F").factor * 212 + unit_of("°F").offset, 9)
    100.0
    >>> unit_of("pressure:kPa").dimension
    'pressure'
    >>> unit_of("furlong") is None
    True
    """
    plain = re.sub(r"[\s\[\]]", "", _read_again(text or "").lower()).replace("unit_", "")
    plain = plain.replace("grad c", "degc").replace("\xba", "°")
    kind_left_out = re.sub(r"^[a-z]+:", "", plain)  # "pressure:kPa" of several ECU makers
    tries = (plain, plain.strip("()"), kind_left_out)
    return next((unit for each in tries if (unit := _UNIT_OF.get(each))), None)
