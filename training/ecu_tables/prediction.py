"""The reading that the parameters predict on a drive, with its derivatives: a wall film before the
grey-box chain. The delayed mixture is read smoothly, so that the derivative over the dead time is
continuous."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.ecu_tables import parameters as laws
from training.ecu_tables.parameters import Parameters, Point, Vector
from training.ecu_tables.signals import PULSE, Air, TableDrive
from training.greybox.chain import KG_H_PER_MG_RPM, Path, simulate
from training.greybox.quantity.dual import Dual, value_of
from training.greybox.quantity.dynamics import ramp_lag
from training.greybox.quantity.value import Quantity, exp, maximum

STEP: Final = 1e-5  # of the pipe's difference quotients


@dataclass(frozen=True, slots=True)
class PredictionCase:
    """A drive with the quantities that a fit does not change."""

    drive: TableDrive
    point: Point

    @staticmethod
    def of(drive: TableDrive, p: Parameters) -> "PredictionCase":
        """Return the case of a drive."""
        flow = air_mg(Vector(p, p.mean()), drive) * drive.rpm * KG_H_PER_MG_RPM * drive.cylinders
        shares, kg_h = p.grid.shares(drive.rpm, drive.load), np.maximum(flow, laws.FLOW_LEAST_KG_H)
        return PredictionCase(drive, Point(drive.rpm, drive.load, kg_h, drive.cold, shares))


def reading(v: Vector, case: PredictionCase) -> Quantity:
    """Return the predicted phi of the sensor (n,)."""
    d, at = case.drive, case.point
    fuel = injected_mg(v, d)
    landed = fuel * laws.share_of(laws.film_odds(v, at))
    film_s, strokes = laws.time_of(laws.film_level(v, at)), d.rpm / 30.0
    film_mg = ramp_lag(landed * strokes * film_s, film_s, d.period_s)
    pipe_s = _pipe_s(laws.gas_flow(v, at), laws.pipe_kg_h_s(v, at), d.period_s)
    mixing_s, sensor_s = laws.lags_s(v, at)
    path = Path(
        fuel_mg=fuel - landed + film_mg / (film_s * strokes),
        air_mg=air_mg(v, d),
        factor=exp(v.field("gain", at)),
        dead_time_s=laws.near_delay_s(v, at) + pipe_s,
        mixing_s=mixing_s,
        sensor_rising_s=sensor_s,
        sensor_falling_s=sensor_s,
        span=v["span"],
    )
    return simulate(path, d.period_s, smooth=True)


def _pipe_s(flow: Quantity, volume: Quantity, period_s: float) -> Quantity:
    """Return the time in the pipe (n,) in s.

    flow : (n,) volume flow; volume : (n,) of the pipe, in flow times s
    A dual of the volume has one of the flow, whose change counts along the whole way.
    """
    f, v = value_of(flow), value_of(volume)
    out = _passage_s(f, v, period_s)
    if not isinstance(volume, Dual):
        return out
    slopes = {}
    for group in {**flow.slopes, **volume.slopes}:
        by_flow, by_volume = (STEP * each.slopes.get(group, 0.0) for each in (flow, volume))
        slopes[group] = (_passage_s(f + by_flow, v + by_volume, period_s) - out) / STEP
    return Dual(out, slopes)


def _passage_s(flow: FloatArray, volume: FloatArray, period_s: float) -> FloatArray:
    """Return how many s ago the gas at the sensor entered: one volume less had passed by then."""
    passed = np.cumsum(flow) * period_s
    t_s = np.arange(len(flow)) * period_s
    entered = passed - volume
    before = np.maximum(passed[0] - entered, 0.0) / flow[0]
    return np.asarray(t_s - np.interp(entered, passed, t_s) + before)


def injected_mg(v: Vector, d: TableDrive) -> Quantity:
    """Return the injected fuel per stroke (n,) in mg."""
    flow = exp(v["flow"])
    if PULSE not in v.p.subject.known:
        return flow * (d.command * d.commanded)
    opened = maximum(d.commanded - laws.dead_ms(v, d.volts), 0.0)
    return flow * opened * (d.command * d.pressure * (d.commanded > 0.0))


def air_mg(v: Vector, d: TableDrive) -> Quantity:
    """Return the air per stroke in the cylinder (n,) in mg.

    Behind the air meter stands the filling of the manifold; the meter's own lag is taken back.
    The filled mass follows the flow by (flow - charge) / time, so its lead needs no derivative.
    A charge from the manifold's pressure is that of a moment ago: valves close after the ECU has
    read the pressure, and a logger reads pressure and pulse one after the other.
    """
    if v.p.subject.air is not Air.METER:
        rate = np.gradient(np.log(np.maximum(d.air, 1.0)), d.period_s)
        return d.air * exp(-v["charge_s"] * rate)
    filling_s = exp(v["filling"]) / d.rpm
    charge = ramp_lag(d.air, filling_s, d.period_s)
    return charge + exp(v["meter"]) / filling_s * (d.air - charge)
