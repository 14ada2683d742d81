"""The tables of a simulated engine as its equations give them, in the form of the estimates."""

import numpy as np

from monitor.base.types import FloatArray
from training.dyno import engine as plant
from training.dyno.cycles import STEP_S
from training.dyno.drive import charges_mg, nominal_ves
from training.dyno.engine import Engine
from training.recordings.ecu_table import COOLANT_BANDS, KPA, Axis, CoolantBand, EcuTable, TableAxes

EARLY_S = 1.75 * STEP_S  # half a step in each of three lags, a quarter in the pipe
PRESSURES_KPA = np.linspace(10.0, 260.0, 501)


def tables(e: Engine, axes: TableAxes, manifold_degc: float) -> list[EcuTable]:
    """Return the true tables of a recording of this engine.

    manifold_degc : mean temperature in the manifold, which sets the charge at a pressure
    """
    rpm, load = np.meshgrid(axes.speed.values, axes.load.values, indexing="ij")
    kpa, charge = _operating_points(rpm, load, axes.load.name, manifold_degc)
    flow = np.maximum(charge * rpm / 30.0 * 3.6e-3, 3.0)
    litres_per_s = flow / 3.6 / plant.exhaust_kg_m3(flow)
    near = plant.STROKE_S / rpm + e.delay_s - EARLY_S
    delay = near + e.pipe_litres / litres_per_s
    lag = plant.PORT_MIXING_S + e.mixed_litres / litres_per_s + plant.sensor_tau_s(e, flow)
    over = (axes.speed, axes.load)
    made = [_table("lambda_delay", "s", over, delay), _table("lambda_lag", "s", over, lag)]
    for band in COOLANT_BANDS:
        share = plant.film_share(e, rpm, kpa, band.at_degc)
        tau = plant.film_tau_s(e, rpm, kpa, band.at_degc)
        made.append(_table("wall_film_fraction", "-", over, share, band))
        made.append(_table("wall_film_time", "s", over, tau, band))
    volts = np.asarray(axes.volts.values)
    made.append(_table("injector_dead_time", "ms", (axes.volts,), plant.dead_time_ms(e, volts)))
    flow_mg_ms = np.array([e.flow_mg_ms * e.flow_gain])
    pressure = axes.pressure(direct=e.layout.injection == "direct")
    made.append(_table("injector_flow_scale", "mg/ms", (pressure,), flow_mg_ms))
    own = plant.sensor_tau_s(e, np.asarray(axes.exhaust_flow.values))
    made.append(_table("sensor_lag", "s", (axes.exhaust_flow,), own))
    return made


def _operating_points(
    rpm: FloatArray, load: FloatArray, name: str, manifold_degc: float
) -> tuple[FloatArray, FloatArray]:
    """Return manifold pressure in kPa and charge in mg per stroke at every cell."""
    if name == KPA:
        return load, np.asarray(charges_mg(nominal_ves(rpm, load), load, manifold_degc))
    kpa = np.empty_like(load)
    for at in np.ndindex(load.shape):
        efficiency = nominal_ves(rpm[at], PRESSURES_KPA)
        kpa[at] = np.interp(
            load[at], charges_mg(efficiency, PRESSURES_KPA, manifold_degc), PRESSURES_KPA
        )
    return kpa, load


def _table(
    name: str,
    unit: str,
    axes: tuple[Axis, ...],
    values: FloatArray,
    coolant: CoolantBand | None = None,
) -> EcuTable:
    samples = np.zeros(values.shape, dtype=np.int64)
    return EcuTable(
        name=name,
        unit=unit,
        axes=axes,
        estimate=values,
        low=values,
        high=values,
        samples=samples,
        coolant=coolant,
    )
