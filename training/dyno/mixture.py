"""Second half of the plant: fuel, mixture, exhaust, wideband sensor and lambda control.

The sensor, healthy or faulty, sits inside the control loop, as in a car. All parts stand in the
file of their loop, for the reason that ``drive`` gives.
"""

from typing import NamedTuple

import numba
import numpy as np

from monitor.base import faults
from monitor.base.faults import Fault
from monitor.base.types import FloatArray
from training.dyno import catalyst, downstream
from training.dyno.cycles import STEP_S
from training.dyno.drive import SimulatedDrive
from training.dyno.effects import Effects
from training.dyno.vehicle import STOICHIOMETRIC_AIR_FUEL, Conditions, Piece
from training.recordings.sensor_fault import SensorParameters

LAMBDA_MAX = 15.9  # highest lambda that the ECU sends, in fuel cut
HISTORY = catalyst.RING
TRIM_LIMIT = 0.30
SENSOR_WARM_UP_S = 15.0
EXHAUST_KG_M3 = 0.45

_lag_step = numba.njit(cache=True)(faults.lag_step)
_aged = numba.njit(cache=True)(faults.aged)
_one_sided = numba.njit(cache=True)(faults.one_sided)
_begin_brick = numba.njit(cache=True)(downstream.begin)
_behind = catalyst.step


class Mixture(NamedTuple):
    """Fuel and lambda on the 10 ms grid, in the order of ``simulate``; every field is (n,)."""

    fuel_ecu_mg: FloatArray  # per stroke, commanded by the ECU
    lambda_measured: FloatArray
    lambda_target: FloatArray
    lambda_controller: FloatArray
    closed_loop: FloatArray
    sensor_ready: FloatArray
    phi_sensor: FloatArray  # reading of a healthy sensor in this vehicle
    downstream_v: FloatArray  # of the switching sensor; (0,) without one, as those below
    downstream_heater: FloatArray  # duty, 0 to 1
    brick_degc: FloatArray
    downstream_reading: FloatArray  # of a wide-range sensor, as -x
    tailpipe_x: FloatArray  # of the gas behind the catalyst; above 0 it is lean


@numba.njit(cache=True)
def _target_phi(
    t_s: float, coolant: float, rpm: float, air_mg: float, since_cut_s: float, modulation: float
) -> float:
    """Return the commanded phi: modulated, and rich when cold, at high load and after overrun."""
    phi = 1.0 + modulation
    phi += 0.06 * min(max((45.0 - coolant) / 60.0, 0.0), 1.0)
    phi += 0.05 * min(max((12.0 - t_s) / 12.0, 0.0), 1.0)
    if rpm > 2600.0:
        phi += 0.07 * min(max((air_mg - 620.0) / 200.0, 0.0), 1.0)
    if since_cut_s < 1.2:
        phi += 0.04
    return phi


@numba.njit(cache=True)
def _triangle(phase: float) -> float:
    """Return the forced modulation, -1 to 1: a trapezoid with short ramps, of period 1."""
    x = np.sin(2.0 * np.pi * phase) * 2.5
    return min(max(x, -1.0), 1.0)


@numba.njit(cache=True)
def _look_back(history: FloatArray, k: int, delay_s: float) -> float:
    """Return the value ``delay_s`` before step ``k`` from a ring, interpolated linearly."""
    steps = min(max(delay_s / STEP_S, 0.0), HISTORY - 2.0)
    whole = int(steps)
    part = steps - whole
    return history[(k - whole) % HISTORY] * (1 - part) + history[(k - whole - 1) % HISTORY] * part


@numba.njit(cache=True)
def _injected_mg(
    commanded: float, rail_mpa: float, battery_v: float, p: Piece, e: Effects
) -> float:
    """Return the fuel per stroke in mg that the injectors deliver for a command in mg."""
    short = np.exp(-commanded / 9.0)
    injected = commanded * p.injector_gain * (rail_mpa / 10.0) ** e.rail_exponent
    injected += p.injector_curve_mg * short - 0.12 * e.battery_voltage * (battery_v - 13.9) * 8.0
    injected += e.injector_offset * (0.6 + 0.9 * np.exp(-commanded / 15.0))
    return max(injected, 0.0)


class MixtureCourse(NamedTuple):
    """Properties of the vehicle that follow its operating point; every field has shape (n,)."""

    film_share: FloatArray  # fraction of the injected fuel that wets the wall
    film_tau_s: FloatArray  # time constant of its evaporation
    fuel_error_mg: FloatArray  # per stroke, that the injectors add to the command
    exhaust_kg_m3: FloatArray  # density of the exhaust between valve and sensor
    sensor_tau_s: FloatArray


class _Fuel(NamedTuple):
    """State of wall film, canister vapour and fuel in the oil, and the fuel in the cylinder."""

    film_mg: float
    vapour_mg_s: float
    oil: float  # remaining fraction of the fuel in the oil
    cylinder_mg: float  # per stroke


@numba.njit(cache=True)
def _fuel_step(
    f: _Fuel,
    t_s: float,
    injected: float,
    cut: bool,
    strokes_per_s: float,
    coolant: float,
    manifold_kpa: float,
    purge_duty: float,
    share: float,
    film_tau: float,
    c: Conditions,
    e: Effects,
) -> _Fuel:
    """Return the state of wall film, canister vapour and oil one step later."""
    evaporated = f.film_mg / film_tau  # mg/s
    film_mg = f.film_mg + STEP_S * (share * injected * strokes_per_s - evaporated)
    purged = e.purge * c.canister_load * np.exp(-t_s / 2500.0) * purge_duty
    purged = purged * max(c.ambient_kpa - manifold_kpa, 0.0) * 0.9
    vapour = f.vapour_mg_s + STEP_S / 0.7 * (purged - f.vapour_mg_s)
    oil_mg_s = e.oil_dilution * f.oil * np.exp((min(coolant, 90.0) - 90.0) / 25.0)
    oil = f.oil - STEP_S * f.oil * oil_mg_s * 2e-4
    extra = (evaporated + vapour + oil_mg_s) / strokes_per_s
    cylinder_mg = (1.0 - share) * injected + (extra if not cut else 0.3 * extra)
    return _Fuel(film_mg, vapour, oil, cylinder_mg)


@numba.njit(cache=True)
def _scavenged(manifold_kpa: float, ambient_kpa: float, rpm: float, scavenging: float) -> float:
    """Return the fraction of air that blows through while both valves are open."""
    blown = scavenging * max(manifold_kpa / ambient_kpa - 0.9, 0.0) * 2.5
    blown *= 1.0 / (1.0 + np.exp((rpm - 2200.0) / 200.0))
    return min(blown, 0.3)


class _Disturbance(NamedTuple):
    """State of the combustion noise and of the disturbance line."""

    noise: float
    line_phase: float  # periods


@numba.njit(cache=True)
def _disturb(s: _Disturbance, line_hz: float, noise: float, drift: float) -> _Disturbance:
    return _Disturbance(
        s.noise + (-s.noise * STEP_S / 0.06 + noise * np.sqrt(2 * STEP_S / 0.06)),
        s.line_phase + STEP_S * (line_hz + 0.03 * drift),
    )


class _Exhaust(NamedTuple):
    """State of the exhaust between the valves and the sensor; in phi except ``behind``."""

    behind: int  # step at which the gas now leaving the pipe entered it
    mixed: float  # after the first mixed volume
    pipe: float  # after the second mixed volume
    tail: float  # of the fuel cut
    gas: float  # at the sensor


@numba.njit(cache=True)
def _transport(
    x: _Exhaust,
    k: int,
    delayed: float,
    flow: float,
    density_kg_m3: float,
    cut: bool,
    entered: FloatArray,
    advected: FloatArray,
    mixing_tau_s: float,
    e: Effects,
) -> _Exhaust:
    """Return the state of the exhaust one step later: a pipe with plug flow, two mixed volumes."""
    litres_per_s = flow / 3600.0 / density_kg_m3 * 1e3
    entered[k] = delayed
    advected[k + 1] = advected[k] + litres_per_s * STEP_S
    behind = x.behind
    while behind < k and advected[behind + 1] < advected[k + 1] - e.delay_flow:
        behind += 1
    mixed = x.mixed + (entered[behind] - x.mixed) * (1.0 - np.exp(-STEP_S / mixing_tau_s))
    pipe_tau = e.mix_flow / litres_per_s
    pipe = x.pipe + (mixed - x.pipe) * (1.0 - np.exp(-STEP_S / (pipe_tau + 1e-6)))
    tail = x.tail + STEP_S * ((1.0 - x.tail) / 1.2 if cut else -x.tail / (0.5 + 12.0 / flow))
    return _Exhaust(behind, mixed, pipe, tail, pipe - (0.0 if cut else e.fuel_cut_tail * tail))


@numba.njit(cache=True)
def _pumping(
    uego: float, gas: float, flow: float, sensor_tau_s: float, ambient_kpa: float, e: Effects
) -> float:
    """Return the phi that the cell of the sensor shows one step later.

    The cell depends on exhaust pressure and lags by diffusion, faster in one direction.
    """
    pressure_bar = (flow / 220.0) ** 2 + (ambient_kpa - 98.5) / 100.0
    gas = 1.0 + (gas - 1.0) * (1.0 + e.back_pressure * pressure_bar * (1.2 if gas < 1 else 0.8))
    skew = e.sensor_asymmetry * np.tanh((gas - uego) / 0.01)
    return uego + (gas - uego) * (1.0 - np.exp(-STEP_S / (sensor_tau_s * (1.0 + skew))))


@numba.njit(cache=True)
def _read(
    slow: float, k: int, sensed: FloatArray, faulty: bool, f: SensorParameters
) -> tuple[float, float]:
    """Return the lagged phi and the lambda that the ECU reads; ``faulty`` applies the fault."""
    phi = sensed[k % HISTORY]
    if faulty:
        phi = _one_sided(phi, _look_back(sensed, k, f.delay_s), f.delay_direction)
    slow = _lag_step(
        slow, phi, f.tau_rising_s if faulty else 0.0, f.tau_falling_s if faulty else 0.0, STEP_S
    )
    phi = 1.0 + (f.gain if faulty else 1.0) * (slow - 1.0)
    reading = min(1.0 / max(phi, 1.0 / LAMBDA_MAX), LAMBDA_MAX)
    if faulty:
        biased = min(reading + f.offset_lambda, LAMBDA_MAX)
        reading = f.stuck_lambda if f.stuck_lambda > 0.0 else biased
    return slow, reading


class _Control(NamedTuple):
    """State of the lambda controller: expected phi, integral and proportional part."""

    model: float
    integral: float
    proportional: float


@numba.njit(cache=True)
def _control(s: _Control, expected: float, reading: float, active: bool) -> _Control:
    """Return the state of the controller one step later.

    The error compares the command, seen through the nominal plant, with the reading.
    """
    model = s.model + (expected - s.model) * STEP_S / 0.10
    error = model - min(max(1.0 / max(reading, 0.05), 0.0), 1.6)
    if not active:
        return _Control(model, s.integral, s.proportional * (1.0 - STEP_S / 0.3))
    error = min(max(error, -0.15), 0.15)
    return _Control(
        model,
        min(max(s.integral + 0.45 * error * STEP_S, -TRIM_LIMIT), TRIM_LIMIT),
        s.proportional + (0.12 * error - s.proportional) * STEP_S / 0.05,
    )


@numba.njit(cache=True)
def simulate(  # noqa: PLR0915  # the loop couples all parts in every step
    d: SimulatedDrive,
    p: Piece,
    c: Conditions,
    e: Effects,
    f: SensorParameters,
    course: MixtureCourse,
    noise: FloatArray,
    phi_step: FloatArray,
    forced_trim: FloatArray,
    rear: downstream.Downstream,
    rear_noise: FloatArray,
    rear_warm: float,
) -> tuple[FloatArray, FloatArray]:
    """Return fuel and lambda over the drive, (7, n), and what is behind the catalyst, (5, n).

    noise : (n, 3) standard normal: mixture, sensor electronics, drift of the disturbance line
    phi_step : (n,) added to the commanded phi in closed loop
    forced_trim : (n,) replaces the output of the lambda controller; length 0 replaces nothing
    rear_noise : (n,) standard normal of the downstream sensor; length 0 without one
    rear_warm : part of the working temperature that the brick has at the start
    """
    n = len(d.engine_rpm)
    out = np.empty((7, n))
    cylinder, sensed, expected = np.ones(HISTORY), np.ones(HISTORY), np.ones(HISTORY)
    advected = np.zeros(n + 1)  # exhaust volume that has passed the valves, in litres
    entered = np.ones(n)  # phi when it entered the pipe
    fuel, disturbance = _Fuel(0.0, 0.0, 1.0, 0.0), _Disturbance(0.0, 0.0)
    exhaust, control = _Exhaust(0, 1.0, 1.0, 0.0, 1.0), _Control(1.0, 0.0, 0.0)
    uego, slow, phase, since_cut, lambda_read = 1.0, 1.0, 0.0, 10.0, np.nan
    stoichiometric = STOICHIOMETRIC_AIR_FUEL - 5.7 * e.ethanol
    behind = np.empty((5, len(rear_noise)))
    cells_g, ring = np.zeros(catalyst.CELLS), np.full(catalyst.RING, 0.5)
    brick = _begin_brick(rear, rear_warm)
    for k in range(n):
        t_s = k * STEP_S
        rpm, air_ecu, coolant = d.engine_rpm[k], d.air_ecu_mg[k], d.coolant_degc[k]
        flow = max(d.exhaust_kg_h[k], 3.0)
        cut = d.fuel_cut[k] > 0.5
        since_cut = 0.0 if cut else since_cut + STEP_S
        faulty = t_s >= f.start_s
        ready = t_s > SENSOR_WARM_UP_S and not (faulty and f.not_ready > 0.0)
        closed = ready and coolant > 30.0 and since_cut > 0.8 and t_s > 20.0

        # command
        phase += STEP_S / (1.1 + 2.2 / (1.0 + flow / 25.0))
        modulation = 0.028 * _triangle(phase) + phi_step[k] if closed else 0.0
        if rear.active > 0.0:
            if closed and brick.step != 0.0:
                modulation = brick.step * rear.steps
            modulation += brick.trim if closed else 0.0
            modulation += catalyst.REFILL_PHI * brick.refill
        target = _target_phi(t_s, coolant, rpm, air_ecu, since_cut, modulation)
        trim = 1.0 + control.integral + control.proportional
        if len(forced_trim) > 0:
            trim = forced_trim[k]
        fuel_ecu = 0.0 if cut else air_ecu / STOICHIOMETRIC_AIR_FUEL * target * trim

        # mixture at the exhaust valve
        opened = max(fuel_ecu + course.fuel_error_mg[k], 0.0)
        injected = 0.0 if cut else _injected_mg(opened, d.rail_mpa[k], d.battery_v[k], p, e)
        kpa, purge = d.manifold_kpa[k], d.purge_duty[k]
        share, tau_s = course.film_share[k], course.film_tau_s[k]
        fuel = _fuel_step(
            fuel, t_s, injected, cut, rpm / 30.0, coolant, kpa, purge, share, tau_s, c, e
        )
        scavenged = _scavenged(kpa, c.ambient_kpa, rpm, e.scavenging)
        phi = fuel.cylinder_mg * stoichiometric / (d.air_true_mg[k] * (1.0 + scavenged))
        disturbance = _disturb(disturbance, c.line_hz, noise[k, 0], noise[k, 2])
        if not cut:
            phi += c.combustion_noise_phi * disturbance.noise
            phi += c.line_phi * np.sin(2 * np.pi * disturbance.line_phase)
        phi *= 1.0 - min(e.exhaust_leak * np.exp(-(flow - 10.0) / 30.0) * 1.4, 0.5)
        cylinder[k % HISTORY] = max(phi, 0.0)

        # transport, sensor and reading; the delay begins with 90 / rpm s in the cylinder
        delayed = _look_back(cylinder, k, 90.0 / rpm + p.transport_delay_s)
        density = course.exhaust_kg_m3[k]
        exhaust = _transport(
            exhaust, k, delayed, flow, density, cut, entered, advected, p.mixing_tau_s, e
        )
        uego = _pumping(uego, exhaust.gas, flow, course.sensor_tau_s[k], c.ambient_kpa, e)
        healthy = 1.0 + p.sensor_gain * (uego - 1.0) + p.sensor_offset + 0.0008 * noise[k, 1]
        sensed[k % HISTORY] = healthy
        slow, reading = _read(slow, k, sensed, faulty, f)
        if faulty and f.ripple_lambda + f.hold_s + abs(f.drift_lambda) > 0.0:
            since_s, drift = t_s - f.start_s, f.drift_lambda
            reading = _aged(reading, lambda_read, since_s, f.ripple_lambda, drift, f.hold_s)
        lambda_read = min(reading, LAMBDA_MAX)

        expected[k % HISTORY] = target if not cut else 0.0
        command = _look_back(expected, k, 90.0 / rpm + 0.12 + 0.06)
        control = _control(control, command, lambda_read, closed and since_cut > 1.6)

        out[0, k], out[1, k], out[2, k] = fuel_ecu, lambda_read, 1.0 / target
        out[3, k], out[4, k] = trim, 1.0 if closed else 0.0
        out[5, k], out[6, k] = 1.0 if ready else 0.0, healthy

        if rear.active > 0.0:
            gas, air_g_s = exhaust.gas, flow / 3.6
            brick = _behind(
                brick, cells_g, ring, k, gas, air_g_s, since_cut, closed, rear_noise[k], rear
            )
            behind[0, k], behind[1, k], behind[2, k] = brick.volts, brick.heater, brick.degc
            behind[3, k] = brick.reading + catalyst.WIDE_NOISE * rear_noise[k]
            behind[4, k] = brick.x_out
    return out, behind


def run(
    drive: SimulatedDrive,
    p: Piece,
    c: Conditions,
    e: Effects,
    fault: Fault | None,
    start_s: float,
    rng: np.random.Generator,
    phi_step: FloatArray,
    forced_trim: FloatArray | None = None,
    course: MixtureCourse | None = None,
    rear: downstream.Downstream = downstream.NONE,
    rear_rng: np.random.Generator | None = None,
) -> Mixture:
    """Return the mixture side of a drive.

    fault : sensor fault from ``start_s`` until the end of the drive, None is a healthy sensor
    rng : draws the noise of mixture and sensor
    phi_step : (n,) added to the commanded phi in closed loop
    forced_trim : (n,) replaces the output of the lambda controller, None replaces nothing
    course : properties that follow the operating point, None is those of the type
    rear : catalyst and downstream sensor, by default none
    rear_rng : draws the noise of the downstream sensor, None without one
    """
    noise = rng.standard_normal((len(drive.engine_rpm), 3))
    f = fault or Fault("healthy", 0.0)
    sensor = SensorParameters.of(f, start_s if fault else np.inf)
    trim = np.empty(0) if forced_trim is None else forced_trim
    course = course or usual_course(drive, p, e)
    rear_noise = np.empty(0) if rear_rng is None else rear_rng.standard_normal(len(noise))
    warm = 1.0 if c.coolant_start_degc > 60.0 else 0.0
    own, behind = simulate(
        drive, p, c, e, sensor, course, noise, phi_step, trim, rear, rear_noise, warm
    )
    return Mixture(*own, *behind)


def usual_course(d: SimulatedDrive, p: Piece, e: Effects) -> MixtureCourse:
    """Return the properties of the type's direct injection along a drive."""
    cold = np.maximum(88.0 - d.coolant_degc, 0.0) / 60.0
    none = np.zeros(len(d.engine_rpm))
    return MixtureCourse(
        film_share=np.minimum((e.wall_film + 0.02 * e.ethanol) * (1.0 + 1.5 * cold), 0.6),
        film_tau_s=(0.35 + 0.5 * cold) * (1.0 + 0.4 * 40.0 / (d.manifold_kpa + 20.0)),
        fuel_error_mg=none,
        exhaust_kg_m3=none + EXHAUST_KG_M3,
        sensor_tau_s=none + p.sensor_tau_s,
    )
