"""The page of the tables: heat maps with bounds and blank cells, and the drive that fills them.

That drive tells which speeds, loads, temperatures and voltages are missing, and for how long. Only
loads between visited ones of the same speed are asked for: a car that never came to 20 kPa at 7,000
rpm may not be able to.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from monitor.base.counts import counted
from monitor.base.files.outputs import write_text
from training.ecu_tables.fit import FittedTables
from training.pages.heat import Heat, HeatCell, level
from training.pages.page import page
from training.recordings.ecu_table import EcuTable

TITLES: Final = {
    "lambda_delay": "Lambda delay: dead time from injection to sensor",
    "lambda_delay_cycles": "Lambda delay in engine cycles",
    "lambda_lag": "Lambda lag: time constants of exhaust mixing and sensor together",
    "wall_film_fraction": "Wall film: fraction of the fuel that wets the wall",
    "wall_film_time": "Wall film: time constant of evaporation",
    "injector_dead_time": "Injector dead time over battery voltage",
    "injector_flow_scale": "Injector flow",
    "sensor_lag": "The sensor's own lag over exhaust flow",
}
SHOWN: Final = {
    "s": (1000.0, "ms", 0),
    "-": (100.0, "%", 1),
    "ms": (1.0, "ms", 2),
    "cycles": (1.0, "cycles", 2),
    "mg/ms": (1.0, "mg/ms", 2),
}
WANTED_S: Final = 40.0  # usable seconds that fill most cells
LEGS_MOST: Final = 12


def write_report(
    path: Path, fitted: FittedTables, tables: Sequence[EcuTable], notes: Mapping[str, str]
) -> None:
    """Write the page of tables, the lambda delay first, with notes (what → text) beside them."""
    subject = fitted.parameters.subject
    filled = {t.key: int(np.isfinite(t.estimate).sum()) for t in tables}
    share = f"{sum(filled.values())} of {sum(t.estimate.size for t in tables)} cells"
    verdict, confidence = _told(tables[0])
    text = page(
        "ecu_tables.html",
        "Tables from recordings",
        verdict=verdict,
        confidence=f"{confidence}; {share} of all tables are filled.",
        tables=tables,
        filled=filled,
        heading=heading,
        heat=heat,
        legs=plan(tables),
        subject=subject,
        sigma=fitted.sigma,
        notes=notes,
    )
    write_text(path, text)


def heading(table: EcuTable) -> str:
    """Return a table's heading with its band of coolant temperature."""
    band = table.coolant
    at = "" if band is None else f", coolant {band.low_degc:g} to {band.high_degc:g} °C"
    return TITLES[table.name] + at


def _told(delay: EcuTable) -> tuple[str, str]:
    """Return between which values the lambda delay lies, and how narrow its intervals are."""
    at = np.isfinite(delay.estimate)
    if not at.any():
        return "The recordings do not tell the lambda delay of any cell.", "none for the delay"
    low, high = 1000.0 * delay.estimate[at].min(), 1000.0 * delay.estimate[at].max()
    half_ms = 1000.0 * float(np.median((delay.high - delay.low)[at])) / 2.0
    cells = counted(int(at.sum()), "cell")
    return (
        f"Lambda delay {low:.0f} to {high:.0f} ms in {cells}; blank: not known well enough.",
        f"a cell's delay is known to ±{half_ms:.0f} ms in the median (90 % interval)",
    )


def heat(table: EcuTable) -> Heat:
    """Return the map of a table over two axes, or its row over one."""
    factor, unit, digits = SHOWN[table.unit]
    shape = (len(table.axes[0].values), -1)
    values = table.estimate.reshape(shape) * factor
    half = (table.high - table.low).reshape(shape) / 2.0 * factor
    seconds = table.seconds.reshape(shape)
    logs, at_s = table.log.reshape(shape), table.at_s.reshape(shape)

    def cell(i: int, j: int) -> HeatCell:
        place = f"{logs[i, j]} from {at_s[i, j]:.0f} s" if logs[i, j] else ""
        if np.isfinite(values[i, j]):
            texts = f"{values[i, j]:.{digits}f}", f"±{half[i, j]:.{digits}f}"
            return HeatCell(*texts, level(values[i, j], values), place)
        spent = f"{max(seconds[i, j], 1.0):.0f} s" if seconds[i, j] > 0.0 else ""
        return HeatCell(spent, place=place)

    first, *second = table.axes
    loads = second[0].values if second else (0.0,)
    of_load = f", load [{second[0].unit}]" if second else ""
    corner = f"{unit}{of_load} over {' '.join(first.name.split('_')[:2])} [{first.unit}]"
    rows = [
        (f"{load:g}" if second else unit, [cell(i, j) for i in range(shape[0])])
        for j, load in reversed([*enumerate(loads)])
    ]
    return Heat(corner, [f"{v:g}" for v in first.values], rows)


class Leg(NamedTuple):
    """One part of the drive."""

    place: str
    seconds: float
    fills: str


def plan(tables: Sequence[EcuTable]) -> list[Leg]:
    """Return the legs of the drive, the longest gaps first."""
    legs = _operating_points(tables[0])
    return sorted(legs, key=lambda leg: -leg.seconds)[:LEGS_MOST] + _elsewhere(tables)


def _operating_points(table: EcuTable) -> list[Leg]:
    """Return one leg per speed with the loads that lack samples."""
    speed, load = table.axes
    visited = table.samples > 0
    below, above = (np.maximum.accumulate(v, axis=1) for v in (visited, visited[:, ::-1]))
    lacking = below & above[:, ::-1] & np.isnan(table.estimate)
    legs = []
    for rpm, at, seconds in zip(speed.values, lacking, table.seconds, strict=True):
        if at.any():
            loads = ", ".join(f"{value:g}" for value in np.asarray(load.values)[at])
            missing = float(np.maximum(WANTED_S - seconds[at], 5.0).sum())
            cells = counted(int(at.sum()), "cell")
            legs.append(Leg(f"{rpm:g} rpm at {loads} {load.unit}", missing, cells))
    return legs


def _elsewhere(tables: Sequence[EcuTable]) -> list[Leg]:
    """Return legs for cold coolant and other battery voltages."""
    legs = []
    for table in tables:
        band = table.coolant
        if band is not None and table.name == "wall_film_fraction" and not table.samples.any():
            place = f"a drive with coolant at {band.low_degc:g} to {band.high_degc:g} °C"
            legs.append(Leg(place, WANTED_S * 4, f"wall film at {band.at_degc:g} °C"))
        if table.name == "injector_dead_time":
            blank = np.isnan(table.estimate) & (table.samples > 0)
            volts = ", ".join(f"{v:g}" for v in np.asarray(table.axes[0].values)[blank])
            if volts:
                place = f"idle with loads switched on and off until the voltage is {volts} V"
                seconds = float(blank.sum()) * WANTED_S
                legs.append(Leg(place, seconds, "injector dead time"))
    return legs
