"""The reading that the parameters predict on a drive, with its derivatives."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from monitor.base.types import FloatArray
from training.ecu_tables import kernels
from training.ecu_tables import parameters as laws
from training.ecu_tables.fields import Weights
from training.ecu_tables.kernels import Columns, Valve, Way
from training.ecu_tables.parameters import Parameters, Point
from training.ecu_tables.signals import Air, TableDrive

STEP: Final = 1e-5  # of a law's difference quotient


@dataclass(frozen=True, slots=True)
class PredictionCase:
    """A drive with the quantities that a fit does not change."""

    drive: TableDrive
    point: Point
    weights: Weights

    @staticmethod
    def of(drive: TableDrive, p: Parameters) -> "PredictionCase":
        """Return the case of a drive."""
        point = laws.point_of(drive, air_mg(p, p.mean(), drive))
        return PredictionCase(drive, point, p.grid.weights(drive.rpm, drive.load))


def reading(p: Parameters, x: FloatArray, case: PredictionCase) -> FloatArray:
    """Return the predicted phi of the sensor (n,)."""
    return _run(p, x, case, derivatives=False)[0]


def sensitivities(
    p: Parameters, x: FloatArray, case: PredictionCase
) -> tuple[FloatArray, FloatArray]:
    """Return the predicted phi (n,) and its derivatives over the parameters (n, size)."""
    return _run(p, x, case, derivatives=True)


def _run(
    p: Parameters, x: FloatArray, case: PredictionCase, *, derivatives: bool
) -> tuple[FloatArray, FloatArray]:
    columns = _columns(p, derivatives=derivatives)
    knots, shares = case.weights.at, case.weights.share
    fields = {name: case.weights.apply(x[p.at[name]]) for name in laws.FIELDS}
    slopes = _Slopes(p, x, derivatives)
    valve, way = _valve(p, x, case, fields, slopes), _way(p, x, case, fields, slopes)
    phi, phi_slopes = kernels.valve(valve, columns, knots, shares)
    return kernels.sensor(phi, phi_slopes, way, columns, knots, shares)


def _columns(p: Parameters, *, derivatives: bool) -> Columns:
    first = [p.at[name].start for name in laws.FIRST]
    fields = [p.at[name].start for name in ("gain", "share", "tau", "delay", "lag")]
    size = p.size if derivatives else 0
    return Columns._make([*first, *fields, size])


@dataclass(frozen=True, slots=True)
class _Slopes:
    """Difference quotients of a law over its constants, none if nobody wants derivatives."""

    p: Parameters
    x: FloatArray
    wanted: bool

    def of(self, law: Callable[[FloatArray], FloatArray], names: Sequence[str]) -> FloatArray:
        """Return (n, n_names); (n, 0) if no derivatives are wanted."""
        base = law(self.x)
        made = np.empty((len(base), len(names) if self.wanted else 0))
        for j in range(made.shape[1]):
            moved = self.x.copy()
            moved[self.p.at[names[j]]] += STEP
            made[:, j] = (law(moved) - base) / STEP
        return made


def _valve(
    p: Parameters,
    x: FloatArray,
    case: PredictionCase,
    fields: Mapping[str, FloatArray],
    slopes: _Slopes,
) -> Valve:
    d, at = case.drive, case.point

    def share(y: FloatArray) -> FloatArray:
        return laws.share_of(laws.film_odds(p, y, at, fields["share"]))

    def log_time(y: FloatArray) -> FloatArray:
        return np.asarray(np.log(laws.time_of(laws.film_level(p, y, at, fields["tau"]))))

    return Valve(
        fuel=injected_mg(p, x, d),
        fuel_slopes=slopes.of(lambda y: injected_mg(p, y, d), laws.FUEL),
        air=air_mg(p, x, d),
        air_slopes=slopes.of(lambda y: air_mg(p, y, d), laws.AIR),
        share=share(x),
        share_slopes=slopes.of(share, laws.FILM),
        time=np.exp(log_time(x)) / d.period_s,
        time_slopes=slopes.of(log_time, laws.FILM_TIME),
        gain=np.exp(fields["gain"]),
        strokes=d.rpm / 30.0 * d.period_s,
    )


def _way(
    p: Parameters,
    x: FloatArray,
    case: PredictionCase,
    fields: Mapping[str, FloatArray],
    slopes: _Slopes,
) -> Way:
    at, period_s = case.point, case.drive.period_s

    def delay(y: FloatArray) -> FloatArray:
        volume = laws.pipe_kg_h_s(p, y, fields["delay"])
        pipe_s = _pipe_s(laws.gas_flow(p, y, at), volume, period_s)
        return (laws.near_delay_s(p, y, at) + pipe_s) / period_s

    def log_mixing(y: FloatArray) -> FloatArray:
        return np.asarray(np.log(laws.mixing_s(p, y, at, fields["lag"])))

    def log_lag(y: FloatArray) -> FloatArray:
        return np.asarray(np.log(laws.sensor_s(p, y, at.flow_kg_h)) + fields["lag"])

    return Way(
        delay=delay(x),
        delay_slopes=slopes.of(delay, laws.DELAY),
        mixing=np.exp(log_mixing(x)) / period_s,
        mixing_slopes=slopes.of(log_mixing, laws.MIXING),
        mixing_by_heat=slopes.of(log_mixing, laws.HEAT),
        lag=np.exp(log_lag(x)) / period_s,
        lag_slopes=slopes.of(log_lag, laws.SENSOR),
        span=p.value(x, "span"),
    )


def _pipe_s(flow: FloatArray, volume: FloatArray, period_s: float) -> FloatArray:
    """Return the time in the pipe (n,) in s.

    flow : (n,) volume flow; volume : (n,) of the pipe, in flow times s
    The gas at the sensor entered the pipe when the pipe's volume less had passed the valves.
    """
    passed = np.cumsum(flow) * period_s
    t_s = np.arange(len(flow)) * period_s
    entered = passed - volume
    before = np.maximum(passed[0] - entered, 0.0) / flow[0]
    return np.asarray(t_s - np.interp(entered, passed, t_s) + before)


def injected_mg(p: Parameters, x: FloatArray, d: TableDrive) -> FloatArray:
    """Return the injected fuel per stroke (n,) in mg."""
    flow = np.exp(p.value(x, "flow"))
    if not p.subject.has_pulse:
        return np.asarray(flow * d.command * d.commanded)
    opened = np.maximum(d.commanded - laws.dead_ms(p, x, d.volts), 0.0)
    return np.asarray(flow * d.command * d.pressure * np.where(d.commanded > 0.0, opened, 0.0))


def air_mg(p: Parameters, x: FloatArray, d: TableDrive) -> FloatArray:
    """Return the air per stroke in the cylinder (n,) in mg.

    Behind the air meter stands the filling of the manifold; the meter's own lag is taken back.
    The filled mass follows the flow by (flow - charge) / time, so its lead needs no derivative.
    A charge from the manifold's pressure is that of a moment ago: valves close after the ECU has
    read the pressure, and a logger reads pressure and pulse one after the other.
    """
    if p.subject.air is not Air.METER:
        rate = np.gradient(np.log(np.maximum(d.air, 1.0)), d.period_s)
        return np.asarray(d.air * np.exp(-p.value(x, "charge_s") * rate))
    filling_s = np.exp(p.value(x, "filling")) / d.rpm
    charge = _behind(d.air, filling_s / d.period_s)
    return np.asarray(charge + np.exp(p.value(x, "meter")) / filling_s * (d.air - charge))


@njit(cache=True)
def _behind(flow: FloatArray, time: FloatArray) -> FloatArray:  # pragma: no cover
    """Return the flow behind a lag of ``time`` samples."""
    out = np.empty(len(flow))
    state = flow[0]
    for k in range(len(flow)):
        keep = np.exp(-1.0 / time[k])
        newest = 1.0 - time[k] * (1.0 - keep)
        last = flow[k - 1] if k > 0 else flow[k]
        state = keep * state + newest * flow[k] + (1.0 - keep - newest) * last
        out[k] = state
    return out
