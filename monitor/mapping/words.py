"""What signal names mean: English, German and the abbreviations of this trade.

A stem ending in ``*`` matches anywhere in a name, any other a whole word of it; ``=name`` is the
whole name but for endings such as ``_w``. Each phrase is a set of concepts that all must occur.
"""

import re
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
    "geschwindigkeit": "geschw* fahrgeschw* vss =vfzg vfzg tacho* kmh kph",
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
    "ambient": "env ambient* amb outside* aussen* umgebung* umg outdoor* exterior*",
    "aat": "aat oat tumg tam",
    "baro": "baro* bap atm atmos* luftdruck* =pu pu barometric*",
    "battery": "batt* bat ub vbat wub ubat bordnetz* kl30 kl15 supply* module* vbatt accu*",
    "voltage": "v potential* volt* spannung* vbat vbatt ub wub ubat u tension*",
    "purge": "purge* evap* tev tankentl* canister* cpv aktivkohle* akf",
    "duty": "duty* valve* dc pwm ventil* tastverh* ratio* flow* pct ansteuerung*",
    "closed": "closed* clsd cl geschlossen* closedloop*",
    "loop": "loop* lp regelkreis* closedloop*",
    "open": "open* openloop*",
    "active": "active* aktiv* actv act status* state* on enabled* enable* freigabe*",
    "cut": "cut* cutoff* fuelcut* abschalt* shutoff* off",
    "dfco": "dfco dfso schubabschalt* schub* overrun* =b_sa sa decel*",
    "ready": "ready* rdy valid* betriebsbereit* bereit* operational* warm",
    "b_lr": "=b_lr =blr",
    "b_sbb": "=b_sbbvk =bsbbvk",
    "outside_air": "aussentemp* aussenluft*",
}

# words that tell nothing apart
_NOISE: Final = (
    "value val act actual ist istwert w l raw sig signal filt filtered abs absolute sensor sens "
    "ecu ecm pcm dme ems dde obd measured meas gemessen cur current est estimated calc msr x the "
    "of in at b1s1 b1 s1 bank sensor1 bank1 upstream us pre front vor vk vorkat precat primary "
    "status pct percent degc kpa bar rpm kmh kph commanded per and to u16 s16 u8 wert"
)


NOISE: Final = frozenset(_NOISE.split())


@dataclass(frozen=True, slots=True)
class Phrase:
    """Concepts that together mean a canonical signal."""

    concepts: tuple[str, ...]
    weight: float  # how sure they make it


@cache
def words_of(name: str) -> tuple[str, ...]:
    """Return the words of a name in small letters, digits at their ends apart.

    >>> words_of("MO_KuehlmittelTemp_01")
    ('mo', 'kuehlmittel', 'temp', '01')
    >>> words_of("O2SensorB1S1")
    ('o2', 'sensor', 'b1', 's1')
    """
    text = re.sub(r"(?i)wheel_?based", "", name)  # J1939's speed over ground
    for umlaut, plain in (
        ("ä", "ae"),
        ("ö", "oe"),
        ("ü", "ue"),
        ("ß", "ss"),
        ("Ä", "Ae"),
        ("Ö", "Oe"),
        ("Ü", "Ue"),
        ("λ", " lambda "),
        ("φ", " phi "),
    ):
        text = text.replace(umlaut, plain)
    found: list[str] = []
    for part in re.findall(
        r"h?o2s?\d{0,2}(?![a-z])|[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+\d*|[A-Z]+\d*|\d+",
        re.sub(r"(?i)(?<![a-z])(h?o2s?)", lambda m: " " + m[1].lower(), text),
    ):
        word = part.lower()
        match = re.fullmatch(r"([a-z]{2,})(\d+)", word)
        if match and not re.fullmatch(r"h?o2s?\d*", word) and match[1] not in ("u", "s"):
            found += [match[1], match[2]]
        else:
            found.append(word)
    return tuple(found)


def whole(words: tuple[str, ...]) -> str:
    """Return a name without separators and endings that say nothing."""
    kept = [word for word in words if word not in ("w", "l", "raw", "01", "1")]
    return "".join(kept)


@cache
def _stems(concept: str) -> tuple[str, ...]:
    return tuple(CONCEPTS[concept].split())


def explained(concept: str, words: tuple[str, ...]) -> frozenset[str]:
    """Return the words of a name that carry the concept, none if it does not."""
    found: set[str] = set()
    name = "".join(words)
    for stem in _stems(concept):
        if stem.startswith("="):
            if whole(words) == stem[1:].replace("_", ""):
                found.update(words)
        elif stem.endswith("*"):
            if stem[:-1] in name:
                found.update(w for w in words if stem[:-1] in w or (w in stem[:-1] and len(w) > 2))
                found.add("*")
        elif stem in words:
            found.add(stem)
    return frozenset(found)


def match(phrases: tuple[Phrase, ...], words: tuple[str, ...]) -> float:
    """Return how sure the words make it, 0 to 1; words that say something else count against it.

    >>> match((Phrase(("engine", "speed"), 1.0),), words_of("EngineSpeed"))
    1.0
    >>> match((Phrase(("engine", "speed"), 1.0),), words_of("Motordrehzahl"))
    1.0
    >>> 0 < match((Phrase(("engine", "speed"), 1.0),), words_of("EngineSpeedGearboxInput")) < 0.9
    True
    >>> match((Phrase(("engine", "speed"), 1.0),), words_of("VehicleSpeed"))
    0.0
    """
    best = 0.0
    for phrase in phrases:
        parts = [explained(concept, words) for concept in phrase.concepts]
        if not all(parts):
            continue
        told = frozenset().union(*parts)
        rest = [w for w in words if w not in told and w not in NOISE and not w.isdigit()]
        share = len(rest) / max(len(words), 1)
        best = max(best, phrase.weight * (1.0 - 0.35 * share))
    return best
