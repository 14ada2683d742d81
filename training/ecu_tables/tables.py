"""Tables from a fit: each cell with estimate, 90 % bounds and samples, blank where data are silent.

A cell is blank if too few usable samples lie nearest to it, or if its interval is so wide that the
recordings say nothing about it. The bounds hold the fit's covariance, widened by a factor per
table that stands in the settings: it was set on simulated vehicles of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from monitor.base.types import BoolArray, FloatArray, IntArray
from training.ecu_tables import parameters as laws
from training.ecu_tables.config import TablesConfig
from training.ecu_tables.fields import Weights
from training.ecu_tables.fit import FittedTables
from training.ecu_tables.parameters import Parameters, Point
from training.ecu_tables.signals import WARM_DEGC
from training.recordings.ecu_table import (
    COOLANT_BANDS,
    MG_PER_STROKE,
    Axis,
    CoolantBand,
    EcuTable,
    TableAxes,
)

Quantity = Callable[[FloatArray], FloatArray]  # parameters → value of each cell, above 0
STEP: Final = 1e-4
FILM_LEAST: Final = 0.04  # fraction below which no time constant can be told


class CellSamples:
    """The usable samples of all drives, as cells count them; each array (n,)."""

    def __init__(self, fitted: FittedTables) -> None:
        self.rpm = _joined(fitted, lambda c: c.drive.rpm)
        self.load = _joined(fitted, lambda c: c.drive.load)
        self.flow = _joined(fitted, lambda c: c.point.flow_kg_h)
        self.volts = _joined(fitted, lambda c: c.drive.volts)
        self.degc = WARM_DEGC - 60.0 * _joined(fitted, lambda c: c.drive.cold)
        self.seconds = _joined(fitted, lambda c: np.full(len(c.drive), c.drive.period_s))
        self.per_load = self.flow / self.rpm / np.maximum(self.load, 1.0)


def _joined(fitted: FittedTables, of: Callable[..., FloatArray]) -> FloatArray:
    return np.concatenate([of(c)[c.drive.usable] for c in fitted.cases])


def tables(fitted: FittedTables, axes: TableAxes, config: TablesConfig) -> list[EcuTable]:
    """Return all tables that the vehicle's signals allow."""
    samples = CellSamples(fitted)
    return [
        *over_operation(fitted, axes, samples, config),
        *of_injectors(fitted, axes, samples, config),
        _sensor_lag(fitted, axes, samples, config),
    ]


def over_operation(
    fitted: FittedTables, axes: TableAxes, samples: CellSamples, config: TablesConfig
) -> list[EcuTable]:
    """Return delay, lag and wall film over speed and load."""
    p = fitted.parameters
    over = (axes.speed, axes.load)
    at = (axes.speed.nearest(samples.rpm), axes.load.nearest(samples.load))
    made = []
    for name, quantity in (("lambda_delay", _delay), ("lambda_lag", _lag)):
        point = _nodes(axes, samples, at, 0.0)
        weights = p.grid.weights(point.rpm, point.load)
        made.append(
            _table(
                name,
                "s",
                axes=over,
                fitted=fitted,
                cells=quantity(p, point, weights),
                at=at,
                samples=samples,
                config=config,
            )
        )
    bands = COOLANT_BANDS if p.subject.has_coolant else COOLANT_BANDS[-1:]
    for band in bands:
        inside = (samples.degc >= band.low_degc) & (samples.degc < band.high_degc)
        cold = max(WARM_DEGC - band.at_degc, 0.0) / 60.0
        point = _nodes(axes, samples, at, cold)
        weights = p.grid.weights(point.rpm, point.load)
        for name, unit, quantity in (
            ("wall_film_fraction", "-", _share),
            ("wall_film_time", "s", _time),
        ):
            cells = quantity(p, point, weights)
            made.append(
                _table(
                    name,
                    unit,
                    axes=over,
                    fitted=fitted,
                    cells=cells,
                    at=at,
                    samples=samples,
                    config=config,
                    counted=inside,
                    band=band,
                )
            )
    return _without_film(made)


def of_injectors(
    fitted: FittedTables, axes: TableAxes, samples: CellSamples, config: TablesConfig
) -> list[EcuTable]:
    """Return dead time and flow scale of the injectors, none without a pulse width."""
    p = fitted.parameters
    if not p.subject.has_pulse:
        return []
    volts = np.asarray(axes.volts.values)
    at = (axes.volts.nearest(samples.volts),)
    made = [
        _table(
            "injector_dead_time",
            "ms",
            axes=(axes.volts,),
            fitted=fitted,
            cells=lambda x: laws.dead_ms(p, x, volts),
            at=at,
            samples=samples,
            config=config,
            counted=np.full(len(samples.rpm), p.subject.has_volts),
        )
    ]
    if p.subject.absolute_air:
        made.append(
            _table(
                "injector_flow_scale",
                "mg/ms",
                axes=(axes.pressure(direct=p.subject.has_rail),),
                fitted=fitted,
                cells=lambda x: np.exp(x[p.at["flow"]]),
                at=(np.zeros(len(samples.rpm), dtype=np.int64),),
                samples=samples,
                config=config,
            )
        )
    return made


def _sensor_lag(
    fitted: FittedTables, axes: TableAxes, samples: CellSamples, config: TablesConfig
) -> EcuTable:
    p, axis = fitted.parameters, axes.exhaust_flow
    flow = np.asarray(axis.values)
    at = (axis.nearest(samples.flow),)

    def cells(x: FloatArray) -> FloatArray:
        return laws.sensor_s(p, x, flow)

    return _table(
        "sensor_lag",
        "s",
        axes=(axis,),
        fitted=fitted,
        cells=cells,
        at=at,
        samples=samples,
        config=config,
    )


def _nodes(axes: TableAxes, samples: CellSamples, at: tuple[IntArray, ...], cold: float) -> Point:
    """Return the operating points of the cells, flat; the charge of a cell is its samples' own."""
    rpm, load = (m.ravel() for m in np.meshgrid(axes.speed.values, axes.load.values, indexing="ij"))
    cell = np.ravel_multi_index(at, (len(axes.speed.values), len(axes.load.values)))
    usual = float(np.median(samples.per_load))
    per_load = np.full(len(rpm), usual)
    if axes.load.name != MG_PER_STROKE:
        for k in np.unique(cell):
            per_load[k] = np.median(samples.per_load[cell == k])
    flow = np.maximum(per_load * rpm * load, laws.FLOW_LEAST_KG_H)
    return Point(rpm, load, flow, np.full(len(rpm), cold))


def _delay(p: Parameters, at: Point, weights: Weights) -> Quantity:
    return lambda x: laws.delay_s(p, x, at, weights.apply(x[p.at["delay"]]))


def _lag(p: Parameters, at: Point, weights: Weights) -> Quantity:
    def cells(x: FloatArray) -> FloatArray:
        field = weights.apply(x[p.at["lag"]])
        sensor = laws.sensor_s(p, x, at.flow_kg_h) * np.exp(field)
        return np.asarray(laws.mixing_s(p, x, at, field) + sensor)

    return cells


def _share(p: Parameters, at: Point, weights: Weights) -> Quantity:
    return lambda x: laws.film_share(p, x, at, weights.apply(x[p.at["share"]]))


def _time(p: Parameters, at: Point, weights: Weights) -> Quantity:
    return lambda x: laws.film_time_s(p, x, at, weights.apply(x[p.at["tau"]]))


def _table(
    name: str,
    unit: str,
    axes: tuple[Axis, ...],
    fitted: FittedTables,
    cells: Quantity,
    at: tuple[IntArray, ...],
    samples: CellSamples,
    config: TablesConfig,
    counted: BoolArray | None = None,
    band: CoolantBand | None = None,
) -> EcuTable:
    """Return a table; bounds are symmetric in the logarithm, for all values are above 0.

    An estimate whose upper bound is small is told, however wide the interval is as a ratio: a film
    of at most 5 % says that there is almost none. Its lower bound is 0. An interval as wide as
    the prior's comes from no data, however small its bound is. A delay that is known as a ratio,
    but not within what an ECU can use, is blank, too.
    """
    shape = tuple(len(a.values) for a in axes)
    flat = np.ravel_multi_index(at, shape)
    chosen = np.ones(len(flat), dtype=bool) if counted is None else counted
    number = np.bincount(flat[chosen], minlength=int(np.prod(shape)))
    seconds = np.bincount(flat[chosen], samples.seconds[chosen], minlength=len(number))
    value = cells(fitted.x)
    air = fitted.parameters.subject.air
    log_sd = _log_sd(fitted, cells) * config.factor(name, air)
    half = config.z90 * log_sd
    wide = half > np.log1p(config.widest[name])
    wide |= value * np.expm1(half) > config.bluntest.get(name, np.inf)
    small = wide & (value * np.exp(half) < config.small.get(name, 0.0))
    small &= half < np.log1p(config.small_widest)
    silent = (seconds < config.least_s) | (wide & ~small)
    estimate = np.where(silent, np.nan, value)
    low = np.where(silent, np.nan, np.where(small, 0.0, value * np.exp(-half)))
    high = estimate * np.exp(half)
    return EcuTable(
        name=name,
        unit=unit,
        axes=axes,
        estimate=estimate.reshape(shape),
        low=low.reshape(shape),
        high=high.reshape(shape),
        samples=number.reshape(shape),
        coolant=band,
    )


def _log_sd(fitted: FittedTables, cells: Quantity) -> FloatArray:
    """Return the standard deviation of each cell's logarithm (n_cells,)."""
    base = np.log(cells(fitted.x))
    slopes = np.empty((len(base), len(fitted.x)))
    for k in range(len(fitted.x)):
        moved = fitted.x.copy()
        moved[k] += STEP
        slopes[:, k] = (np.log(cells(moved)) - base) / STEP
    variance = np.einsum("ij,jk,ik->i", slopes, fitted.covariance, slopes)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _without_film(made: Sequence[EcuTable]) -> list[EcuTable]:
    """Return the tables with blank film times where there may be no film to evaporate."""
    wet = {t.coolant: t.low > FILM_LEAST for t in made if t.name == "wall_film_fraction"}
    return [_masked(t, wet[t.coolant]) if t.name == "wall_film_time" else t for t in made]


def _masked(table: EcuTable, kept: BoolArray) -> EcuTable:
    """Return the table with blank cells where it is not kept."""
    return replace(
        table,
        estimate=np.where(kept, table.estimate, np.nan),
        low=np.where(kept, table.low, np.nan),
        high=np.where(kept, table.high, np.nan),
    )
