"""An engine as tuners log it: port or direct injection, speed density or an air meter.

The type of the other drives has ideal injectors and a dry wall. With a layout the same vehicle
gets injectors with a dead time, a wall film, a longer exhaust, and an ECU whose tables of
volumetric efficiency and dead time are a few percent wrong. All properties are maps over the
operating point with a spread of their own in each vehicle.
"""

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numba
import numpy as np
from scipy.ndimage import map_coordinates

from monitor.base.types import FloatArray
from training.dyno.cycles import STEP_S
from training.dyno.drive import SimulatedDrive, charges_mg, nominal_ves
from training.dyno.effects import Effects
from training.dyno.mixture import MixtureCourse
from training.dyno.vehicle import VE_LOADS_KPA, VE_SPEEDS_RPM, Piece
from training.recordings.ecu_table import RAIL_REFERENCE_MPA

Injection = Literal["port", "direct"]
Metering = Literal["maf", "speed_density"]
PORT_MIXING_S: Final = 0.01
MANIFOLD_CHARGES: Final = 12.9  # mass in the manifold over the charge of one cylinder
METER_LAG_S: Final = 0.03
FILM_LIMIT: Final = 0.7
STROKE_S: Final = 90.0  # over engine speed: from intake to exhaust valve


@dataclass(frozen=True, slots=True)
class EngineLayout:
    """How the engine meters air and fuel."""

    injection: Injection
    metering: Metering

    @property
    def name(self) -> str:
        """Return the name of the layout in file names.

        >>> EngineLayout("port", "speed_density").name
        'port_speed_density'
        """
        return f"{self.injection}_{self.metering}"


class Engine(NamedTuple):
    """Parameters of one engine."""

    layout: EngineLayout
    film_share: float  # at 2,000 rpm, 50 kPa, warm
    film_share_map: FloatArray  # (5, 5) relative, speed × load
    film_tau_s: float
    film_tau_map: FloatArray
    flow_mg_ms: float  # of an injector by the ECU's calibration
    flow_gain: float  # true over calibrated flow
    dead_time_ms: float  # true, at 14 V
    dead_time_exponent: float
    ecu_dead_time_ms: float  # by the ECU's calibration
    ecu_dead_time_slope: float  # ms/V
    ve_error_map: FloatArray  # (5, 5) relative error of the ECU's volumetric efficiency
    delay_s: float  # of the exhaust, without the parts over speed and flow
    pipe_litres: float  # plug flow between valve and sensor
    mixed_litres: float
    sensor_tau_s: float  # at an exhaust flow of 40 kg/h


def engine(vehicle: int, layout: EngineLayout) -> Engine:
    """Return the engine of the vehicle with this number; equal numbers, equal engines."""
    rng = np.random.default_rng([0x0_2, 11, vehicle])
    port = layout.injection == "port"
    flow, dead = (rng.uniform(3.2, 5.0), rng.uniform(0.75, 1.25))
    wet, far = rng.uniform(0.12, 0.32), rng.uniform(0.3, 2.4)
    return Engine(
        layout=layout,
        film_share=wet if port else 0.08 * wet,
        film_share_map=_spread(rng, 0.08),
        film_tau_s=rng.uniform(0.3, 0.8),
        film_tau_map=_spread(rng, 0.08),
        flow_mg_ms=flow if port else 3.5 * flow,
        flow_gain=1.0 + 0.03 * float(np.clip(rng.standard_normal(), -2.0, 2.0)),
        dead_time_ms=dead if port else 0.35 * dead,
        dead_time_exponent=rng.uniform(1.3, 2.0),
        ecu_dead_time_ms=(dead if port else 0.35 * dead) + (rng.uniform(-0.2, 0.2) if port else 0),
        ecu_dead_time_slope=rng.uniform(-0.16, -0.08) * (1.0 if port else 0.35),
        ve_error_map=_spread(rng, 0.02),
        delay_s=rng.uniform(0.01, 0.05),
        pipe_litres=far,
        mixed_litres=0.25 * far * rng.uniform(0.7, 1.3),
        sensor_tau_s=rng.uniform(0.05, 0.14),
    )


def _spread(rng: np.random.Generator, size: float) -> FloatArray:
    return np.asarray(np.exp(size * np.clip(rng.standard_normal((5, 5)), -2.0, 2.0)))


def _over(table: FloatArray, rpm: FloatArray, kpa: FloatArray) -> FloatArray:
    """Return a map's values, held constant beyond its edges."""
    at = [
        np.interp(rpm, VE_SPEEDS_RPM, np.arange(5.0)),
        np.interp(kpa, VE_LOADS_KPA, np.arange(5.0)),
    ]
    return np.asarray(map_coordinates(table, np.broadcast_arrays(*at), order=1, mode="nearest"))


def film_share(e: Engine, rpm: FloatArray, kpa: FloatArray, degc: FloatArray | float) -> FloatArray:
    """Return the fraction of the injected fuel that wets the wall."""
    cold = np.maximum(88.0 - np.asarray(degc), 0.0) / 60.0
    share = e.film_share * _over(e.film_share_map, rpm, kpa) * (1.0 + 0.9 * cold)
    share *= (0.75 + 0.5 * kpa / (kpa + 50.0)) * (1.15 - 0.15 * np.sqrt(rpm / 2000.0))
    return np.asarray(np.minimum(share, FILM_LIMIT))


def film_tau_s(e: Engine, rpm: FloatArray, kpa: FloatArray, degc: FloatArray | float) -> FloatArray:
    """Return the time constant of the film's evaporation in s."""
    cold = np.maximum(88.0 - np.asarray(degc), 0.0) / 60.0
    tau = e.film_tau_s * _over(e.film_tau_map, rpm, kpa) * (1.0 + 1.1 * cold)
    return np.asarray(tau * (0.7 + 21.0 / (kpa + 20.0)) * (0.6 + 0.4 * 2000.0 / (rpm + 200.0)))


def dead_time_ms(e: Engine, volts: FloatArray) -> FloatArray:
    """Return the true dead time of the injectors in ms."""
    return np.asarray(e.dead_time_ms * (14.0 / volts) ** e.dead_time_exponent)


def ecu_dead_time_ms(e: Engine, volts: FloatArray) -> FloatArray:
    """Return the dead time that the ECU adds, in ms."""
    return np.asarray(e.ecu_dead_time_ms + e.ecu_dead_time_slope * (volts - 14.0))


def ecu_flow_mg_ms(e: Engine, rail_mpa: FloatArray) -> FloatArray:
    """Return the flow of an injector by the ECU's calibration in mg/ms."""
    pressure = np.sqrt(rail_mpa / RAIL_REFERENCE_MPA) if e.layout.injection == "direct" else 1.0
    return np.asarray(e.flow_mg_ms * pressure * np.ones_like(rail_mpa))


def exhaust_kg_m3(flow_kg_h: FloatArray) -> FloatArray:
    """Return the density of the exhaust: gas of 450 °C at idle, 800 °C at high flow."""
    degc = 450.0 + 350.0 * flow_kg_h / (flow_kg_h + 60.0)
    return np.asarray(0.38 * 900.0 / (degc + 273.15))


def sensor_tau_s(e: Engine, flow_kg_h: FloatArray) -> FloatArray:
    """Return the lag of the sensor in s: diffusion, and a part that the flow shortens."""
    return np.asarray(e.sensor_tau_s * (0.75 + 0.25 * np.sqrt(40.0 / np.maximum(flow_kg_h, 3.0))))


def ecu_ve(e: Engine, rpm: FloatArray, kpa: FloatArray) -> FloatArray:
    """Return the volumetric efficiency of the ECU's table."""
    return np.asarray(nominal_ves(rpm, kpa) * _over(e.ve_error_map, rpm, kpa))


def installed(e: Engine, piece: Piece, effects: Effects) -> tuple[Piece, Effects]:
    """Return the vehicle with this engine's injectors and exhaust."""
    own = piece._replace(
        injector_gain=e.flow_gain,
        transport_delay_s=e.delay_s,
        mixing_tau_s=PORT_MIXING_S,
        sensor_tau_s=e.sensor_tau_s,
    )
    longer = effects._replace(
        delay_flow=effects.delay_flow + e.pipe_litres, mix_flow=effects.mix_flow + e.mixed_litres
    )
    return own, longer


def metered(
    e: Engine, d: SimulatedDrive, maf_gain: float, rng: np.random.Generator
) -> SimulatedDrive:
    """Return the drive with this engine's electrical load and its ECU's estimate of the air.

    The air meter of this engine reads the flow into the manifold: the cylinders' flow and the
    change of the mass in the manifold, behind a lag of 30 ms and with noise of 0.4 %.
    """
    sag = 1.2 / (1.0 + np.exp(np.clip((d.engine_rpm - 950.0) / 60.0, -30.0, 30.0)))
    volts = np.clip(13.9 + 1.6 * (d.battery_v - 13.9) - sag, 9.0, 15.5)
    if e.layout.metering == "speed_density":
        air = charges_mg(ecu_ve(e, d.engine_rpm, d.manifold_kpa), d.manifold_kpa, d.manifold_degc)
        return d._replace(air_ecu_mg=np.maximum(np.asarray(air), 20.0), battery_v=volts)
    stored = MANIFOLD_CHARGES * np.gradient(d.air_true_mg, STEP_S) * 3.6e-3
    maf = _lagged(d.exhaust_kg_h + stored, np.full(len(volts), METER_LAG_S))
    maf = np.maximum(maf * maf_gain * (1.0 + 0.004 * rng.standard_normal(len(maf))), 0.0)
    charge = maf / 3.6e-3 * 30.0 / np.maximum(d.engine_rpm, 300.0)
    air = _lagged(charge, MANIFOLD_CHARGES * 30.0 / d.engine_rpm)
    return d._replace(air_ecu_mg=np.maximum(air, 20.0), battery_v=volts, maf_kg_h=maf)


@numba.njit(cache=True)
def _lagged(values: FloatArray, tau_s: FloatArray) -> FloatArray:
    """Return the values behind a first-order lag."""
    out, state = np.empty(len(values)), float(values[0])
    for k in range(len(values)):
        state += (values[k] - state) * (1.0 - np.exp(-STEP_S / tau_s[k]))
        out[k] = state
    return out


def course(e: Engine, d: SimulatedDrive) -> MixtureCourse:
    """Return the properties of this engine along a drive."""
    error_ms = ecu_dead_time_ms(e, d.battery_v) - dead_time_ms(e, d.battery_v)
    flow = np.maximum(d.exhaust_kg_h, 3.0)
    return MixtureCourse(
        film_share=film_share(e, d.engine_rpm, d.manifold_kpa, d.coolant_degc),
        film_tau_s=film_tau_s(e, d.engine_rpm, d.manifold_kpa, d.coolant_degc),
        fuel_error_mg=error_ms * ecu_flow_mg_ms(e, d.rail_mpa),
        exhaust_kg_m3=exhaust_kg_m3(flow),
        sensor_tau_s=sensor_tau_s(e, flow),
    )


def pulse_width_ms(e: Engine, d: SimulatedDrive, fuel_mg: FloatArray) -> FloatArray:
    """Return the pulse width that the ECU commands in ms, 0 in fuel cut."""
    opened = fuel_mg / ecu_flow_mg_ms(e, d.rail_mpa) + ecu_dead_time_ms(e, d.battery_v)
    return np.where(fuel_mg > 0.0, opened, 0.0)
