"""The tables of a simulated engine as its equations give them."""

import numpy as np

from monitor.base.types import FloatArray
from training.dyno import engine as plant
from training.dyno.cycles import STEP_S
from training.dyno.drive import charges_mg, nominal_ves
from training.dyno.engine import Engine
from training.recordings.ecu_table import COOLANT_BANDS, KPA, TableAxes

EARLY_S = 1.75 * STEP_S  # half a step in each of three lags, a quarter in the pipe
PRESSURES_KPA = np.linspace(10.0, 260.0, 501)


def true_tables(e: Engine, axes: TableAxes, manifold_degc: float) -> dict[str, FloatArray]:
    """Return each table of a recording of this engine: its key and the value of every cell.

    manifold_degc : mean temperature in the manifold, which sets the charge at a pressure
    """
    rpm, load = np.meshgrid(axes.speed.values, axes.load.values, indexing="ij")
    kpa, charge = _operating_points(rpm, load, axes.load.name, manifold_degc)
    flow = np.maximum(charge * rpm / 30.0 * 3.6e-3, 3.0)
    litres_per_s = flow / 3.6 / plant.exhaust_kg_m3(flow)
    near = plant.STROKE_S / rpm + e.delay_s - EARLY_S
    mixing_s = plant.PORT_MIXING_S + e.mixed_litres / litres_per_s
    made = {
        "lambda_delay": near + e.pipe_litres / litres_per_s,
        "lambda_lag": mixing_s + plant.sensor_tau_s(e, flow),
        "injector_dead_time": plant.dead_time_ms(e, np.asarray(axes.volts.values)),
        "injector_flow_scale": np.array([e.flow_mg_ms * e.flow_gain]),
        "sensor_lag": plant.sensor_tau_s(e, np.asarray(axes.exhaust_flow.values)),
    }
    for degc in (band.at_degc for band in COOLANT_BANDS):
        made[f"wall_film_fraction_{degc:.0f}degc"] = plant.film_share(e, rpm, kpa, degc)
        made[f"wall_film_time_{degc:.0f}degc"] = plant.film_tau_s(e, rpm, kpa, degc)
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
        charges = charges_mg(efficiency, PRESSURES_KPA, manifold_degc)
        kpa[at] = np.interp(load[at], charges, PRESSURES_KPA)
    return kpa, load
