"""One simulated drive: the canonical signals of the ECU on a 10 ms grid."""

from dataclasses import dataclass, field

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.faults import Fault
from monitor.base.signals import OWN
from monitor.base.types import FloatArray
from training.dyno import cycles, downstream, drive, engine, mixture, vehicle
from training.dyno.downstream import DownstreamFault
from training.dyno.drive import SimulatedDrive
from training.dyno.effects import Effects
from training.dyno.engine import Engine, EngineLayout
from training.dyno.mixture import SENSOR_WARM_UP_S, Mixture
from training.dyno.vehicle import Conditions, Piece

# duty of the upstream sensor's heater once it is warm, in percent: at no flow, less per kg/h, least
HEATER_IDLE_PERCENT, HEATER_FLOW, HEATER_LEAST = 60.0, 0.25, 20.0
DEAD_TIMES = ("delay_s", "delay_to_rich_s", "delay_to_lean_s")
LATEST_S = (mixture.HISTORY - 2) * cycles.STEP_S


@dataclass(frozen=True, slots=True)
class Experiment:
    """Plan of one simulated drive; equal experiments give equal bytes."""

    cycle: str = "wltc_3b"
    vehicle: int = 1
    seed: int = 1
    fault: Fault | None = None
    fault_start_s: float = 0.0
    effects: Effects = field(default_factory=Effects)
    duration_s: float | None = None  # None is the whole cycle
    conditions: Conditions | None = None  # None: the seed draws them
    forced_trim: FloatArray | None = None  # (n,) replaces the output of the lambda controller
    layout: EngineLayout | None = None  # of injection and metering; None is the type's ideal one
    downstream: bool = False  # catalyst and downstream sensor are there
    downstream_fault: DownstreamFault | None = None  # needs ``downstream``
    wide_downstream: bool = False  # the downstream sensor is one of wide range
    active_steps_phi: float = 0.0  # of the ECU's own test of the catalyst, one side; 0: it has none
    piece: Piece | None = None  # engine and sensor; None is the vehicle's own

    @property
    def name(self) -> str:
        """Return the stem of the file name: cycle, vehicle, seed, then fault and effects.

        >>> Experiment(cycle="udds", seed=7).name
        'udds_v1_s7_healthy'
        """
        effects = [name for name, scale in self.effects._asdict().items() if scale]
        layout = [] if self.layout is None else [self.layout.name]
        faults = [each.name for each in (self.fault, self.downstream_fault) if each]
        content = [*faults, *effects] or ["healthy"]
        if self.downstream and self.downstream_fault is None:
            content.append("downstream")
        return "_".join([self.cycle, f"v{self.vehicle}", f"s{self.seed}", *layout, *content])

    @property
    def engine(self) -> Engine | None:
        """Return the engine of the vehicle, None without a layout."""
        return None if self.layout is None else engine.engine(self.vehicle, self.layout)


def simulate(experiment: Experiment) -> dict[str, FloatArray]:
    """Return the canonical signals of the drive, name → (n,) at 100 Hz, NaN where not available.

    Raises UsageError for an unknown cycle, a duration below 10 ms, or a fault that begins later.
    """
    air, fuel, conditions = driven(experiment)
    duty_percent = _heater_percent(experiment, air)
    rng = np.random.default_rng([*_key(experiment), 4])
    signals = _canonical(air, fuel, duty_percent, conditions, rng)
    if experiment.downstream:
        signals |= _behind(fuel, wide=experiment.wide_downstream)
    own = experiment.engine
    return signals if own is None else signals | _logged(own, air, fuel)


def driven(experiment: Experiment) -> tuple[SimulatedDrive, Mixture, Conditions]:
    """Return air side, mixture and conditions of the drive; raises as ``simulate``."""
    key = _key(experiment)
    trace = cycles.load(experiment.cycle, np.random.default_rng(key), experiment.duration_s)
    length_s, start_s = len(trace.speed_m_s) * cycles.STEP_S, experiment.fault_start_s
    if not 0.0 <= start_s < length_s:
        raise UsageError(f"fault start {start_s:g} s: not within the drive of {length_s:g} s")
    faults = (experiment.fault, experiment.downstream_fault)
    late_s = max(getattr(each, name, 0.0) for each in faults for name in DEAD_TIMES)
    if late_s > LATEST_S:
        raise UsageError(f"dead time {late_s:g} s: at most {LATEST_S:g} s are wanted")
    piece = experiment.piece or vehicle.piece(experiment.vehicle)
    conditions = experiment.conditions or vehicle.conditions(experiment.seed)
    effects = experiment.effects
    air = drive.run(trace, piece, conditions, effects, np.random.default_rng([*key, 1]))
    own, course = experiment.engine, None
    if own is not None:
        air = engine.metered(own, air, piece.maf_gain, np.random.default_rng([*key, 5]))
        piece, effects = engine.installed(own, piece, effects)
        course = engine.course(own, air)
    rear = downstream.NONE
    if experiment.downstream:
        rear = downstream.installed(
            experiment.vehicle,
            experiment.downstream_fault,
            start_s,
            conditions.ambient_degc,
            experiment.active_steps_phi,
            wide=experiment.wide_downstream,
        )
    fuel = mixture.run(
        air,
        piece,
        conditions,
        effects,
        fault=experiment.fault,
        start_s=start_s,
        rng=np.random.default_rng([*key, 2]),
        phi_step=trace.phi_step,
        forced_trim=experiment.forced_trim,
        course=course,
        rear=rear,
        rear_rng=np.random.default_rng([*key, 6]) if experiment.downstream else None,
    )
    return air, fuel, conditions


def _key(experiment: Experiment) -> list[int]:
    return [0x0_2, 3, experiment.seed, experiment.vehicle]


def _behind(fuel: Mixture, *, wide: bool) -> dict[str, FloatArray]:
    """Return the signals from behind the catalyst."""
    reading = fuel.downstream_reading
    sensor = {"downstream_voltage_v": fuel.downstream_v}
    if wide:
        sensor = {"downstream_lambda": 1.0 / np.clip(1.0 + reading, 1.0 / 16.0, 2.0)}
    return sensor | {
        "downstream_heater_percent": 100.0 * fuel.downstream_heater,
        "catalyst_temperature_degc": fuel.brick_degc,
    }


def _heater_percent(experiment: Experiment, air: SimulatedDrive) -> FloatArray:
    """Return the duty of the upstream sensor's heater: full while it is cold, less in hot exhaust.

    A heater that has failed never reaches its aim, so the ECU gives it all it can.
    """
    t_s = np.arange(len(air.exhaust_kg_h)) * cycles.STEP_S
    regulated = np.clip(HEATER_IDLE_PERCENT - HEATER_FLOW * air.exhaust_kg_h, HEATER_LEAST, 100.0)
    fault = experiment.fault
    dead = (t_s >= experiment.fault_start_s) & bool(fault and fault.heater_dead)
    return np.where((t_s <= SENSOR_WARM_UP_S) | dead, 100.0, regulated)


def _logged(own: Engine, air: SimulatedDrive, fuel: Mixture) -> dict[str, FloatArray]:
    """Return the signals that only an ECU with a layout logs."""
    ve = engine.ecu_ve(own, air.engine_rpm, air.manifold_kpa)
    return {
        "injector_pulse_width_ms": engine.pulse_width_ms(own, air, fuel.fuel_ecu_mg),
        "volumetric_efficiency_percent": 100.0 * ve,
        "lambda_correction_percent": 100.0 * (fuel.lambda_controller - 1.0),
    }


def _canonical(
    air: SimulatedDrive,
    fuel: Mixture,
    heater_percent: FloatArray,
    c: Conditions,
    rng: np.random.Generator,
) -> dict[str, FloatArray]:
    n = len(air.engine_rpm)
    noise = rng.standard_normal((3, n))
    signals = {
        "air_mass_mg": air.air_ecu_mg,
        "fuel_mass_mg": fuel.fuel_ecu_mg,
        "maf_kg_h": air.maf_kg_h,
        "rail_pressure_mpa": air.rail_mpa + 0.01 * noise[0],
        "manifold_pressure_kpa": air.manifold_kpa,
        "manifold_temperature_degc": air.manifold_degc + 0.02 * noise[1],
        "lambda_controller": fuel.lambda_controller,
        "lambda_measured": np.where(fuel.sensor_ready > 0.5, fuel.lambda_measured, np.nan),
        "vehicle_speed_km_h": air.speed_m_s * 3.6,
        "engine_speed_rpm": air.engine_rpm,
        "engine_torque_nm": air.torque_nm,
        "throttle_percent": air.throttle_percent,
        "lambda_target": fuel.lambda_target,
        "coolant_temperature_degc": air.coolant_degc,
        "ambient_temperature_degc": np.full(n, c.ambient_degc),
        "ambient_pressure_kpa": np.full(n, c.ambient_kpa),
        "battery_voltage_v": air.battery_v + 0.02 * noise[2],
        "purge_duty_percent": 100.0 * air.purge_duty,
        "sensor_heater_percent": heater_percent,
        "closed_loop": fuel.closed_loop,
        "fuel_cut": air.fuel_cut,
        "sensor_ready": fuel.sensor_ready,
    }
    limits = {s.name: (s.minimum, s.maximum) for s in OWN if s.name != "lambda_measured"}
    for name, (low, high) in limits.items():
        signals[name] = np.clip(signals[name], low, high)
    return signals
