"""The page of the tables: heat maps with bounds and blank cells, and the drive that fills them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from monitor.base.counts import counted
from monitor.base.files.outputs import write_text
from training.ecu_tables.drive_plan import plan
from training.ecu_tables.fit import FittedTables
from training.pages.figure import drawing
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
}
PLAIN: Final = (1.0, "mg/ms", 2)
AXES: Final = {
    "battery_voltage_v": "battery voltage [V]",
    "exhaust_flow_kg_h": "exhaust flow [kg/h]",
}


def write_report(
    path: Path,
    fitted: FittedTables,
    tables: Sequence[EcuTable],
    names: Sequence[str],
    notes: Mapping[str, str],
) -> None:
    """Write the page; figures are embedded, nothing is loaded from elsewhere.

    notes : what → text, to stand beside the tables
    """
    subject = fitted.parameters.subject
    period_s = subject.drives[0].period_s
    filled = {t.key: int(np.isfinite(t.estimate).sum()) for t in tables}
    text = page(
        "ecu_tables.html",
        "Tables from recordings",
        verdict=_verdict(tables),
        confidence=_confidence(tables, period_s),
        tables=tables,
        filled=filled,
        heading=heading,
        draw=lambda table: draw(table, period_s),
        legs=plan(tables, period_s),
        subject=subject,
        minutes=subject.samples * period_s / 60.0,
        sigma=fitted.sigma,
        recordings=names,
        notes=notes,
        seconds=lambda t: float(t.samples.sum()) * period_s,
    )
    write_text(path, text)


def heading(table: EcuTable) -> str:
    """Return a table's heading with its band of coolant temperature."""
    band = table.coolant
    at = "" if band is None else f", coolant {band.low_degc:g} to {band.high_degc:g} °C"
    return TITLES[table.name] + at


def _verdict(tables: Sequence[EcuTable]) -> str:
    delay = next(t for t in tables if t.name == "lambda_delay")
    good = delay.estimate[np.isfinite(delay.estimate)]
    if len(good) == 0:
        return "The recordings do not tell the lambda delay of any cell."
    low, high = 1000.0 * good.min(), 1000.0 * good.max()
    cells = counted(len(good), "cell")
    return f"Lambda delay {low:.0f} to {high:.0f} ms in {cells}; blank: not known well enough."


def _confidence(tables: Sequence[EcuTable], period_s: float) -> str:
    """Return how narrow the intervals of the lambda delay are, and how many cells are blank."""
    delay = next(t for t in tables if t.name == "lambda_delay")
    at = np.isfinite(delay.estimate)
    cells = sum(t.estimate.size for t in tables)
    filled = sum(int(np.isfinite(t.estimate).sum()) for t in tables)
    share = f"{filled} of {cells} cells of all tables are filled"
    if not at.any():
        return f"none for the delay; {share}."
    half_ms = 1000.0 * float(np.median((delay.high - delay.low)[at])) / 2.0
    minutes = float(delay.samples[at].sum()) * period_s / 60.0
    return (
        f"a cell's delay is known to ±{half_ms:.0f} ms in the median (90 % interval, "
        f"{minutes:.1f} minutes of driving); {share}."
    )


def draw(table: EcuTable, period_s: float) -> Figure:
    """Return a heat map, or a line with bounds for a table over one axis."""
    return _heat_map(table, period_s) if len(table.axes) == 2 else _line(table)


def _heat_map(table: EcuTable, period_s: float) -> Figure:
    """Return a map whose blank cells show their usable seconds, none where nobody drove."""
    speed, load = table.axes
    factor, unit, digits = SHOWN.get(table.unit, PLAIN)
    values = table.estimate.T * factor
    half = (table.high - table.low).T / 2.0 * factor
    figure, axes = drawing(1.2 + 0.38 * len(load.values))
    axes.set_facecolor("0.93")
    image = axes.pcolormesh(np.ma.masked_invalid(values), cmap="viridis", edgecolors="w", lw=0.6)
    figure.colorbar(image, ax=axes, label=unit)
    size = 7 if len(speed.values) <= 10 else 5
    middle = np.nanmean(values) if np.isfinite(values).any() else 0.0
    for j, i in zip(*np.nonzero(np.isfinite(values)), strict=True):
        colour = "w" if values[j, i] < middle else "k"
        text = f"{values[j, i]:.{digits}f}\n±{half[j, i]:.{digits}f}"
        axes.text(i + 0.5, j + 0.5, text, ha="center", va="center", size=size, color=colour)
    seconds = table.samples.T * period_s
    for j, i in zip(*np.nonzero(~np.isfinite(values) & (seconds > 0.0)), strict=True):
        text = f"{max(seconds[j, i], 1.0):.0f} s"
        axes.text(i + 0.5, j + 0.5, text, ha="center", va="center", size=size, color="0.5")
    axes.set_xticks(np.arange(len(speed.values)) + 0.5, [f"{v:g}" for v in speed.values])
    axes.set_yticks(np.arange(len(load.values)) + 0.5, [f"{v:g}" for v in load.values])
    axes.set(xlabel="engine speed [1/min]", ylabel=f"load [{load.unit}]")
    return figure


def _line(table: EcuTable) -> Figure:
    axis = table.axes[0]
    factor, unit, _ = SHOWN.get(table.unit, PLAIN)
    figure, axes = drawing(2.4)
    at = np.isfinite(table.estimate)
    x, y = np.asarray(axis.values)[at], table.estimate[at] * factor
    bounds = np.abs(np.stack([table.low[at], table.high[at]]) * factor - y)
    axes.errorbar(x, y, yerr=bounds, fmt="o-", capsize=3)
    axes.set(xlabel=AXES[axis.name], ylabel=f"{table.name.replace('_', ' ')} [{unit}]")
    return figure
