"""Axes of an ECU's own tables, and its injectors, from a TunerStudio tune (.msq, XML).

TunerStudio writes every table axis as a ``constant`` with a name of the firmware. The first pair
of the list that the tune holds is taken: a lambda delay table's own axes, else those of the fuel
table (rusEFI, Speeduino, MegaSquirt). A document type declaration is refused, so no entity is ever
expanded.
"""

from itertools import pairwise
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from monitor.base.counts import plain
from monitor.base.errors import UsageError
from monitor.base.files.inputs import read_small
from monitor.frames.units import unit_of
from training.greybox.chain import STOICHIOMETRIC
from training.recordings.ecu_table import LOAD_UNITS

PAIRS: Final = (
    ("lambdaDelayRpmBins", "lambdaDelayLoadBins"),
    ("veRpmBins", "veLoadBins"),
    ("rpmBins", "fuelLoadBins"),
    ("rpmBins", "mapBins"),
    ("frpm_table1", "fmap_table1"),
    ("frpm_table", "fmap_table"),
    ("rpm_table1", "map_table1"),
    ("rpmBins8", "mapBins8"),
)
AIR_MG_PER_L: Final = 1184.0  # at 21 °C and 100 kPa, for which reqFuel holds
PETROL_MG_PER_CM3: Final = 745.0
BATTERY_V: Final = 13.2  # at which injOpen holds, where battFac is its slope
LARGEST: Final = 64  # values of one axis
MOST_BYTES: Final = 50_000_000


def read_axes(path: Path, load: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return speeds in 1/min and loads of the tune's table, both rising.

    load : name of the load axis, whose unit is wanted where the tune states one
    Raises UsageError if the file is no tune, has none of the known pairs of axes, or another load.
    """
    constants, unit = _constants(path), LOAD_UNITS[load]
    for speeds, loads in PAIRS:
        if speeds in constants and loads in constants:
            stated = constants[loads].get("units", "").partition("{")[0]  # none of an expression
            if stated and unit_of(stated, STOICHIOMETRIC) != unit_of(unit, STOICHIOMETRIC):
                raise UsageError(f"{path}: {loads} is in {stated}, for these logs {unit} is wanted")
            return _axis(path, constants[speeds]), _axis(path, constants[loads])
    known = ", ".join(f"{a} with {b}" for a, b in PAIRS)
    bins = [name for name in constants if "bins" in name.lower() or "rpm_table" in name.lower()]
    raise UsageError(
        f"{path}: no axes of speed and load; known are {known}; the tune has "
        f"{', '.join(bins[:8]) or 'no axes'}"
    )


def injectors_text(path: Path, displacement_l: float | None, cylinders: int) -> str:
    """Return flow and dead time at 14 V that the tune states, "" if it states neither.

    Names of MegaSquirt and Speeduino (reqFuel, injOpen, battFac) and of rusEFI (injector_flow).
    """
    values = {name: _numbers(each) for name, each in _constants(path).items()}
    stated = {name: v[0] for name, v in values.items() if len(v) == 1 and v[0] > 0.0}
    told = []
    if "reqFuel" in stated and displacement_l is not None:
        charge_mg = displacement_l / cylinders * AIR_MG_PER_L
        per_ms = charge_mg / stated.get("stoich", STOICHIOMETRIC) / stated["reqFuel"]
        told.append(f"flow {plain(per_ms, 3)} mg/ms (reqFuel {stated['reqFuel']:g} ms)")
    if "injector_flow" in stated:
        told.append(f"flow {plain(stated['injector_flow'] * PETROL_MG_PER_CM3 / 6e4, 3)} mg/ms")
    if "injOpen" in stated:
        dead_ms = stated["injOpen"] + stated.get("battFac", 0.0) * (BATTERY_V - 14.0)
        told.append(f"dead time {plain(dead_ms, 3)} ms (injOpen {stated['injOpen']:g} ms)")
    return ", ".join(told)


def _numbers(constant: ElementTree.Element) -> list[float]:
    try:
        return [float(word) for word in "".join(constant.itertext()).replace('"', " ").split()]
    except ValueError:
        return []


def _constants(path: Path) -> dict[str, ElementTree.Element]:
    """Return every constant by its name."""
    try:
        data = read_small(path, MOST_BYTES)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from None
    try:
        root = ElementTree.fromstring(data, ElementTree.XMLParser(target=_Tune()))
    except ElementTree.ParseError as error:
        raise UsageError(f"{path}: no tune in XML: {error}") from None
    if (tag := root.tag.rpartition("}")[2]) != "msq":
        raise UsageError(f"{path}: the root is <{tag}>, a tune's is <msq>")
    return {each.get("name", ""): each for each in root.iterfind(".//{*}constant")}


class _Tune(ElementTree.TreeBuilder):
    """The elements of a tune, which declares no document type and so no entities."""

    def doctype(self, *_: object) -> None:
        """Refuse the file."""
        raise ElementTree.ParseError("it has a document type declaration")


def _axis(path: Path, constant: ElementTree.Element) -> tuple[float, ...]:
    values, name = _numbers(constant), constant.get("name")
    if not values:
        text = "".join(constant.itertext()).strip()
        raise UsageError(f"{path}: {name} holds {text[:40]!r}, numbers are wanted")
    rising = all(a < b for a, b in pairwise(values))
    if not 2 <= len(values) <= LARGEST or not rising or not values[-1] < float("inf"):
        raise UsageError(
            f"{path}: {name} has {len(values)} values, 2 to {LARGEST} rising are wanted"
        )
    return tuple(values)
