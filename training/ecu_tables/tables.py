"""Tables from a fit: each cell with estimate, 90 % bounds and samples, blank where data are silent.

A cell is blank if too few usable samples lie nearest to it, or if its interval is so wide that the
recordings say nothing about it. The bounds hold the fit's covariance, widened by a factor per
table that stands in the settings: it was set on simulated vehicles of its own.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.types import BoolArray, FloatArray, IntArray
from training.ecu_tables import parameters as laws
from training.ecu_tables.config import TablesConfig
from training.ecu_tables.fit import FittedTables
from training.ecu_tables.parameters import Parameters, Point, Vector
from training.ecu_tables.signals import AIR_NEEDS, PULSE, WARM_DEGC
from training.greybox.chain import SPEED_LEAST_RPM
from training.greybox.quantity.value import Quantity, exp, log
from training.recordings.ecu_table import (
    COOLANT_BANDS,
    KPA,
    MG_PER_STROKE,
    Axis,
    CoolantBand,
    EcuTable,
    TableAxes,
)

LAWS: Final[Mapping[str, Callable[..., Quantity]]] = {  # of each table, by Vector and Point
    "lambda_delay": laws.delay_s,
    "lambda_lag": lambda v, at: sum(laws.lags_s(v, at)),
    "wall_film_fraction": laws.film_odds,
    "wall_film_time": laws.film_level,
}
LINKS: Final = {"wall_film_fraction": laws.share_of, "wall_film_time": laws.time_of}  # else exp
FILM_LEAST: Final = 0.04  # fraction below which no time constant can be told


class CellSamples:
    """The usable samples of all drives, as cells count them; each array (n,)."""

    def __init__(self, fitted: FittedTables) -> None:
        drives = [case.drive for case in fitted.cases]
        places = [np.flatnonzero(d.usable) for d in drives]

        def joined(arrays: Iterable[FloatArray]) -> FloatArray:
            return np.concatenate([own[at] for own, at in zip(arrays, places, strict=True)])

        *points, _ = zip(*(case.point for case in fitted.cases), strict=True)
        self.rpm, self.load, self.flow, cold = map(joined, points)
        self.degc, self.volts = WARM_DEGC - 60.0 * cold, joined(d.volts for d in drives)
        self.per_load = self.flow / self.rpm / np.maximum(self.load, 1.0)
        self.at_s = joined(d.period_s * np.arange(float(len(d))) for d in drives)
        n_of = [len(at) for at in places]
        self.seconds = np.repeat([d.every * d.period_s for d in drives], n_of)
        self.log = np.repeat([d.name for d in drives], n_of)

    def stays(self, cell: IntArray, n_cells: int) -> tuple[NDArray[np.str_], FloatArray]:
        """Return the log and the time of the longest stay in each cell, "" and NaN if none.

        cell : (n,) number of each sample's cell, ``n_cells`` for none
        """
        log, at_s = np.full(n_cells + 1, "", self.log.dtype), np.full(n_cells + 1, np.nan)
        goes_on = (np.diff(cell) == 0) & (self.log[1:] == self.log[:-1])
        goes_on &= np.diff(self.at_s) < 1.5 * self.seconds[1:]
        begins = np.flatnonzero(np.concatenate([[True], ~goes_on]))
        rising = begins[np.argsort(np.diff([*begins, len(cell)]), kind="stable")]
        log[cell[rising]], at_s[cell[rising]] = self.log[rising], self.at_s[rising]
        return log[:-1], at_s[:-1]


class _Law(NamedTuple):
    """What a table holds: the value of each cell, and the cell of each sample."""

    name: str
    unit: str
    axes: tuple[Axis, ...]
    value: Callable[[Vector], Quantity]  # of each cell; its log odds or level, of a film
    at: IntArray | tuple[IntArray, ...]
    counted: BoolArray | None = None
    coolant: CoolantBand | None = None


class _Cells(NamedTuple):
    """The cells of a table, flat: on the free scale, its variance by the samples, the samples."""

    free: FloatArray
    variance: FloatArray
    samples: IntArray
    seconds: FloatArray
    log: NDArray[np.str_]
    at_s: FloatArray


def tables(fitted: FittedTables, axes: TableAxes, config: TablesConfig) -> list[EcuTable]:
    """Return all tables that the vehicle's signals allow."""
    fits = [(f, CellSamples(f)) for f in (fitted, *fitted.alone)]
    made = list[EcuTable]()
    for of_all in zip(*(_laws(f.parameters, samples, axes) for f, samples in fits), strict=True):
        pairs = zip(of_all, fits, strict=True)
        whole, *logs = (_cells(law, *seen, config) for law, seen in pairs)
        is_time = of_all[0].name == "wall_film_time"  # of the film before it
        dry = ~(made[-1].low > FILM_LEAST).ravel() if is_time else np.zeros(1, dtype=bool)
        made.append(_table(of_all[0], whole, logs, config, dry))
    delay, per_s = made[0], np.asarray(axes.speed.values)[:, None] / 120.0  # of two revolutions
    cycles = {name: getattr(delay, name) * per_s for name in ("estimate", "low", "high")}
    return [*made, replace(delay, name="lambda_delay_cycles", unit="cycles", **cycles)]


def _laws(p: Parameters, samples: CellSamples, axes: TableAxes) -> list[_Law]:
    """Return delay, lag and wall film over speed and load, the injectors, the sensor's lag.

    Injectors need a pulse width; their flow and the exhaust's, an axis, an absolute air.
    """
    at = (axes.speed.nearest(samples.rpm), axes.load.nearest(samples.load))
    nodes = _nodes(p, axes, samples, at)

    def law(name: str, unit: str, cold: float, *counted: Any) -> _Law:
        value = partial(LAWS[name], at=nodes._replace(cold=np.full(len(nodes.rpm), cold)))
        return _Law(name, unit, (axes.speed, axes.load), value, at, *counted)

    made = [law("lambda_delay", "s", 0.0), law("lambda_lag", "s", 0.0)]
    known = p.subject.known
    for band in COOLANT_BANDS if "coolant_temperature_degc" in known else COOLANT_BANDS[-1:]:
        inside = (samples.degc >= band.low_degc) & (samples.degc < band.high_degc)
        cold = max(WARM_DEGC - band.at_degc, 0.0) / 60.0
        made.append(law("wall_film_fraction", "-", cold, inside, band))
        made.append(law("wall_film_time", "s", cold, inside, band))
    if PULSE in known:
        at_volts, told = axes.volts.nearest(samples.volts), "battery_voltage_v" in known
        dead_ms = partial(laws.dead_ms, volts=np.asarray(axes.volts.values))
        counted = np.full(len(at_volts), told)
        made.append(_Law("injector_dead_time", "ms", (axes.volts,), dead_ms, (at_volts,), counted))
    if not p.subject.absolute_air:
        return made
    if PULSE in known:
        axis = axes.pressure(direct="rail_pressure_mpa" in known)
        mg_ms = lambda v: exp(v["flow"] + np.zeros(1))  # noqa: E731
        made.append(_Law("injector_flow_scale", "mg/ms", (axis,), mg_ms, (0 * at_volts,)))
    lag_s = partial(laws.sensor_s, flow_kg_h=np.asarray(axes.exhaust_flow.values))
    at_flow = axes.exhaust_flow.nearest(samples.flow)
    return [*made, _Law("sensor_lag", "s", (axes.exhaust_flow,), lag_s, (at_flow,))]


def _nodes(p: Parameters, axes: TableAxes, samples: CellSamples, at: tuple[IntArray, ...]) -> Point:
    """Return the warm points of the cells, flat; the charge of a cell is its samples' own."""
    speeds = np.maximum(axes.speed.values, SPEED_LEAST_RPM)
    rpm, load = (m.ravel() for m in np.meshgrid(speeds, axes.load.values, indexing="ij"))
    cell = np.ravel_multi_index(at, (len(axes.speed.values), len(axes.load.values)))
    per_load = np.full(len(rpm), np.median(samples.per_load))
    if axes.load.name != MG_PER_STROKE:
        for k in np.unique(cell):
            per_load[k] = np.median(samples.per_load[cell == k])
    flow = np.maximum(per_load * rpm * load, laws.FLOW_LEAST_KG_H)
    return Point(rpm, load, flow, np.zeros(len(rpm)), p.grid.shares(rpm, load))


def _cells(law: _Law, fitted: FittedTables, seen: CellSamples, config: TablesConfig) -> _Cells:
    """Return the cells by one fit; the variance holds what the air does not tell of the flow."""
    shape = tuple(len(a.values) for a in law.axes)
    flat = np.ravel_multi_index(law.at, shape)
    chosen = np.ones(len(flat), dtype=bool) if law.counted is None else law.counted
    number = np.bincount(flat[chosen], minlength=int(np.prod(shape)))
    seconds = np.bincount(flat[chosen], seen.seconds[chosen], minlength=len(number))
    by = "density" if KPA in AIR_NEEDS[fitted.parameters.subject.air] else "meter"
    factor = config.widening[by][law.name]
    value = law.value(Vector(fitted.parameters, fitted.x, moving=True))
    free = value if law.name in LINKS else log(value)
    slopes = fitted.parameters.jacobian(free)
    squares = np.einsum("ij,jk,ik->i", slopes, fitted.covariance, slopes)
    variance = np.maximum(squares, 0.0) * factor**2
    if law.name == "injector_flow_scale":
        variance += config.air_scale**2
    stays = seen.stays(np.where(chosen, flat, len(number)), len(number))
    return _Cells(free.value, variance, number, np.asarray(seconds, float), *stays)


def between_logs(whole: _Cells, logs: Sequence[_Cells], least_s: float) -> FloatArray:
    """Return the variance between logs of each cell on its free scale (n_cells,).

    It is what the logs' own estimates differ from that of all by, beyond their own variances, by
    moments (DerSimonian and Laird, Controlled Clinical Trials 7, 1986); the larger one of the
    table's and the cell's own. A cell that fewer than two logs saw has the table's.
    """
    if not logs:
        return np.zeros(len(whole.free))
    seen = np.stack([c.seconds >= least_s for c in logs])
    variance = np.stack([c.variance for c in logs])
    weight = np.where(seen & (seen.sum(axis=0) > 1), 1.0 / variance, 0.0)
    excess = weight * ((np.stack([c.free for c in logs]) - whole.free) ** 2 - variance)
    least = np.finfo(float).tiny
    own = excess.sum(axis=0) / np.maximum(weight.sum(axis=0), least)
    return np.maximum(np.maximum(own, excess.sum() / max(float(weight.sum()), least)), 0.0)


def _table(
    law: _Law, whole: _Cells, logs: Sequence[_Cells], config: TablesConfig, dry: BoolArray
) -> EcuTable:
    """Return a table; bounds are symmetric on the free scale: the logarithm, for a film without the
    limits that the law sets to its value.

    A delay that is known as a ratio, but not within what an ECU can use, is blank, too.

    dry : where there may be no film to evaporate, (n_cells,) or (1,) for all
    """
    link = LINKS.get(law.name, np.exp)
    value = link(whole.free)
    variance = whole.variance + between_logs(whole, logs, config.least_s)

    def wide(half: FloatArray) -> BoolArray:
        low, high = link(whole.free - half), link(whole.free + half)
        ratio = np.maximum(high / value, value / low)
        blunt = high - value > config.bluntest.get(law.name, np.inf)
        return np.asarray(blunt | (ratio > 1.0 + config.widest[law.name]))

    half, alike = config.z90 * np.sqrt(variance), config.z90 * np.sqrt(whole.variance)
    blank = {
        "not driven": whole.samples == 0,
        f"less than {config.least_s:g} s": whole.seconds < config.least_s,
        "the interval is too wide": wide(alike),
        "the logs disagree": wide(half),
        "there may be no film": np.broadcast_to(dry, value.shape),
    }
    kept = ~np.any(list(blank.values()), axis=0)
    first = np.argmax([*blank.values(), kept], axis=0)
    shape = tuple(len(a.values) for a in law.axes)
    estimate, low, high = (
        np.where(kept, link(whole.free + by), np.nan).reshape(shape) for by in (0, -half, half)
    )
    return EcuTable(
        name=law.name,
        unit=law.unit,
        axes=law.axes,
        estimate=estimate,
        low=low,
        high=high,
        samples=whole.samples.reshape(shape),
        seconds=whole.seconds.reshape(shape),
        coolant=law.coolant,
        blank={why: int((first == k).sum()) for k, why in enumerate(blank)},
        log=whole.log.reshape(shape),
        at_s=whole.at_s.reshape(shape),
        widened=float(np.median((half / alike)[kept])) if kept.any() else 1.0,
    )
