"""First half of the plant: driver, vehicle, engine speed, air path, temperatures, fuel cut.

This half does not depend on lambda, so it runs once before the mixture loop. The loop integrates
the state at 100 Hz, one part after the other. A part that needs a later part reads its state of
the last step. Manifold filling and throttle flow follow the mean value engine model (Hendricks and
Sorenson, SAE 900616).

All parts stand in the file of their loop, because numba's cache of the loop notices changes in
that file only. The large parts are inlined: calls with two dozen numbers would cost a tenth of the
run time.
"""

from typing import Any, NamedTuple, cast

import numba
import numpy as np

from monitor.base.types import FloatArray
from training.dyno.cycles import STEP_S, TOTAL_RATIO, WHEEL_RADIUS_M, SpeedTrace
from training.dyno.effects import Effects
from training.dyno.vehicle import VE_LOADS_KPA, VE_SPEEDS_RPM, Conditions, Piece

R_AIR = 287.0
DISPLACEMENT_M3 = 2.0e-3
MANIFOLD_M3 = 5.5e-3
TORQUE_PER_MG = 0.36  # indicated torque in Nm per mg of air and stroke
IDLE_RPM = 780.0
MASS_KG = 1450.0
THROTTLE_MAX = 5.0e-4  # effective area in m2


class SimulatedDrive(NamedTuple):
    """Air side of the plant on the 10 ms grid, in the order of ``simulate``; each is (n,)."""

    speed_m_s: FloatArray
    engine_rpm: FloatArray
    torque_nm: FloatArray
    throttle_percent: FloatArray
    manifold_kpa: FloatArray
    manifold_degc: FloatArray
    air_true_mg: FloatArray  # per stroke, enters the cylinder
    air_ecu_mg: FloatArray  # per stroke, estimate of the ECU
    maf_kg_h: FloatArray  # reading of the air meter
    exhaust_kg_h: FloatArray
    coolant_degc: FloatArray
    fuel_cut: FloatArray
    rail_mpa: FloatArray
    battery_v: FloatArray
    purge_duty: FloatArray  # 0 to 1


@numba.njit(cache=True)
def _bilinear(table: FloatArray, xs: FloatArray, ys: FloatArray, x: float, y: float) -> float:
    i = min(max(int(np.searchsorted(xs, x)) - 1, 0), len(xs) - 2)
    j = min(max(int(np.searchsorted(ys, y)) - 1, 0), len(ys) - 2)
    a = min(max((x - xs[i]) / (xs[i + 1] - xs[i]), 0.0), 1.0)
    b = min(max((y - ys[j]) / (ys[j + 1] - ys[j]), 0.0), 1.0)
    low = table[i, j] * (1 - b) + table[i, j + 1] * b
    high = table[i + 1, j] * (1 - b) + table[i + 1, j + 1] * b
    return low * (1 - a) + high * a


@numba.njit(cache=True)
def nominal_ve(rpm: float, kpa: float) -> float:
    """Return the volumetric efficiency that the ECU was calibrated with."""
    return 0.80 + 0.11 * np.exp(-(((rpm - 3200.0) / 1900.0) ** 2)) + 0.05 * (1 - 35.0 / (kpa + 15))


@numba.njit(cache=True)
def _psi(ratio: float) -> float:
    """Return the throttle flow function of the pressure ratio.

    The function is linear near equal pressures, where the exact form has an infinite slope.
    """
    if ratio > 0.95:
        return 0.3765 * max(1.0 - ratio, -0.02) / 0.05
    if ratio < 0.528:
        return 0.6847
    return np.sqrt(7.0 * (ratio**1.42857 - ratio**1.71429))


@numba.njit(cache=True)
def charge_mg(ve: float, kpa: float, degc: float) -> float:
    """Return the air per stroke in mg from volumetric efficiency, pressure and temperature."""
    return ve * DISPLACEMENT_M3 / 4.0 * kpa * 1e3 / (R_AIR * (degc + 273.15)) * 1e6


def nominal_ves(rpm: FloatArray, kpa: FloatArray) -> FloatArray:
    """Return the nominal volumetric efficiency of many operating points."""
    return np.asarray(cast(Any, nominal_ve).py_func(rpm, kpa))


def charges_mg(ve: FloatArray, kpa: FloatArray, degc: FloatArray | float) -> FloatArray:
    """Return the air per stroke in mg of many operating points."""
    return np.asarray(cast(Any, charge_mg).py_func(ve, kpa, degc))


@numba.njit(cache=True)
def _engine_target_rpm(v: float, gear: int) -> float:
    if gear == 0:
        return IDLE_RPM
    rpm = v / WHEEL_RADIUS_M * TOTAL_RATIO[gear - 1] * 30.0 / np.pi
    return max(rpm, 1150.0 if gear == 1 else IDLE_RPM)


class _Motion(NamedTuple):
    """State of driver, gearbox and vehicle."""

    speed_m_s: float
    engine_rpm: float
    torque_nm: float
    friction_nm: float
    integral: float  # the driver's integrated speed error, m
    pedal_noise: float
    gear: int
    shift_s: float  # time until the clutch closes again
    engaged: bool


class _Air(NamedTuple):
    """State of the air path from compressor to cylinder."""

    manifold_kpa: float
    boost_kpa: float
    throttle_m2: float
    runner_kpa: float
    charge_mg: float  # per stroke, enters the cylinder
    throttle_kg_s: float


class _Meters(NamedTuple):
    """State of air meter, pressure sensor and the ECU's estimate of the charge."""

    lag_kg_h: float  # flow that the slow element of the air meter shows
    maf_kg_h: float
    map_kpa: float
    charge_mg: float  # per stroke, by speed and density
    maf_slow_kg_h: float
    charge_slow_kg_h: float
    correction: float


class _Purge(NamedTuple):
    """State of the canister purge."""

    wanted: float
    timer_s: float
    duty: float


@numba.njit(cache=True)
def _road_n(v: float) -> float:
    return 130.0 + 1.2 * v + 0.42 * v * v if v > 0.05 else 0.0


@numba.njit(cache=True)
def _slope_ahead(speed_ref: FloatArray, k: int) -> float:
    """Return the mean acceleration of the next 0.3 s of the trace in m/s²."""
    ahead = min(k + 30, len(speed_ref) - 1)
    return (speed_ref[ahead] - speed_ref[k]) / ((ahead - k) * STEP_S) if ahead > k else 0.0


@numba.njit(cache=True)
def _wheel_demand_n(v: float, v_ref: float, a_ref: float, integral: float, brake: float) -> float:
    road = _road_n(v)
    return MASS_KG * (a_ref + 0.9 * (v_ref - v) + 0.12 * integral) + road + brake


@numba.njit(inline="always")
def _move(
    m: _Motion,
    v_ref: float,
    a_ref: float,
    gear: int,
    brake_n: float,
    coolant: float,
    driver_noise: float,
    noise: float,
) -> _Motion:
    """Return the state of driver, gearbox and vehicle one step later."""
    v, rpm, torque = m.speed_m_s, m.engine_rpm, m.torque_nm
    pedal_noise = m.pedal_noise + ((-m.pedal_noise * STEP_S / 0.8) + 0.16 * np.sqrt(STEP_S) * noise)
    integral = min(max(m.integral + (v_ref - v) * STEP_S, -8.0), 8.0)
    demand_n = _wheel_demand_n(v, v_ref, a_ref, integral, brake_n)
    demand_n *= 1.0 + driver_noise * pedal_noise
    shift_s = (0.35 if gear != m.gear else m.shift_s) - STEP_S
    engaged = gear > 0 and shift_s <= 0.0 and (v > 0.2 or demand_n > 0.0)
    friction = 46.0 + 0.006 * rpm + 0.3 * max(60.0 - coolant, 0.0)
    ratio = TOTAL_RATIO[gear - 1] if gear > 0 else 1.0
    wanted = demand_n * WHEEL_RADIUS_M / (ratio * 0.92) if engaged else 0.0
    idle_torque = 0.05 * (IDLE_RPM - rpm) if not engaged else 0.0
    torque_ref = min(max(wanted, -friction), 300.0) + idle_torque
    torque += (torque_ref - torque) * STEP_S / 0.12
    force = torque * ratio * 0.92 / WHEEL_RADIUS_M if engaged else 0.0
    if wanted < -friction or (not engaged and demand_n < 0.0):
        force = demand_n  # the brakes supply the difference
    v = max(v + (force - _road_n(v) - brake_n) / MASS_KG * STEP_S, 0.0)
    if v_ref < 0.05 and v < 0.6:
        v, integral = max(v - 1.5 * STEP_S, 0.0), 0.0
    rpm += (_engine_target_rpm(v, gear) - rpm) * STEP_S / (0.15 if engaged else 0.4)
    return _Motion(
        speed_m_s=v,
        engine_rpm=rpm,
        torque_nm=torque,
        friction_nm=friction,
        integral=integral,
        pedal_noise=pedal_noise,
        gear=gear,
        shift_s=shift_s,
        engaged=engaged,
    )


@numba.njit(cache=True)
def _overrun(m: _Motion, cut: float) -> bool:
    """Return whether the ECU may cut fuel; the engine speed limit has hysteresis."""
    limit_rpm = 1350.0 if cut > 0 else 1600.0
    return m.engaged and m.torque_nm < -0.55 * m.friction_nm and m.engine_rpm > limit_rpm


@numba.njit(inline="always")
def _breathe(
    a: _Air,
    charge_ref: float,
    rpm: float,
    t_man: float,
    coolant: float,
    maf_slow: float,
    ve_error: FloatArray,
    ambient_kpa: float,
    e: Effects,
) -> _Air:
    """Return the state of boost, throttle, manifold and runner one step later."""
    p_man, t_k, strokes_per_s = a.manifold_kpa, t_man + 273.15, rpm / 30.0
    ve_nominal = nominal_ve(rpm, p_man)
    p_ref = charge_ref / max(charge_mg(ve_nominal, 1.0, t_man), 1e-6)
    p_ref = min(max(p_ref, 15.0), 2.1 * ambient_kpa)
    boost_ref = min(max(1.06 * p_ref - ambient_kpa, 0.0), 0.022 * max(rpm - 900.0, 0.0))
    boost = a.boost_kpa + (boost_ref - a.boost_kpa) * STEP_S / 0.5
    p_up = 0.985 * ambient_kpa + boost
    flow_ref = charge_ref * 1e-6 * strokes_per_s
    speed_factor = 1e3 / np.sqrt(R_AIR * t_k)
    area_ref = flow_ref / (p_up * speed_factor * max(_psi(p_ref / p_up), 0.06))
    area = a.throttle_m2 + (min(area_ref, THROTTLE_MAX) - a.throttle_m2) * STEP_S / 0.07
    resonance = 1.0 + e.intake_resonance * np.exp(-(((rpm - 1850.0) / 140.0) ** 2))
    ve = ve_nominal * resonance
    ve *= 1.0 + _bilinear(ve_error, VE_SPEEDS_RPM, VE_LOADS_KPA, rpm, p_man)
    wall = e.charge_temperature * max(coolant - t_man, 0.0) / (0.4 + maf_slow / 60.0)
    runner_tau = e.manifold_filling * 1500.0 / max(rpm, 500.0)
    runner = a.runner_kpa + (p_man - a.runner_kpa) * STEP_S / (runner_tau + STEP_S)
    charge = charge_mg(ve, runner, t_man + wall)
    flow_in = area * p_up * speed_factor * _psi(p_man / p_up)
    stiff = area * speed_factor * 7.53 + charge * 1e-6 * strokes_per_s / max(p_man, 10.0)
    gain = R_AIR * t_k / MANIFOLD_M3 * 1e-3
    p_man += STEP_S * gain * (flow_in - charge * 1e-6 * strokes_per_s) / (1 + STEP_S * gain * stiff)
    return _Air(
        manifold_kpa=min(max(p_man, 12.0), 260.0),
        boost_kpa=boost,
        throttle_m2=area,
        runner_kpa=runner,
        charge_mg=charge,
        throttle_kg_s=flow_in,
    )


@numba.njit(inline="always")
def _measure(
    s: _Meters,
    a: _Air,
    rpm: float,
    t_man: float,
    p: Piece,
    c: Conditions,
    e: Effects,
    maf_noise: float,
    map_noise: float,
) -> _Meters:
    """Return the state of air meter, pressure sensor and estimated charge one step later."""
    above = max(a.manifold_kpa / c.ambient_kpa - 0.55, 0.0)
    pulse = np.exp(-(((rpm - 1300.0) / 450.0) ** 2)) * above
    gain = 1.0 + 2.0 * e.maf_pulsation * pulse
    reading = a.throttle_kg_s * 3600.0 * p.maf_gain * gain + e.maf_offset
    lag = s.lag_kg_h + (reading - s.lag_kg_h) * STEP_S / 0.03
    maf = max(lag * (1.0 + 0.004 * maf_noise), 0.0)
    map_kpa = a.manifold_kpa + p.map_offset_kpa + 0.08 * map_noise
    charge = charge_mg(nominal_ve(rpm, map_kpa), map_kpa, t_man)
    maf_slow = s.maf_slow_kg_h + (maf - s.maf_slow_kg_h) * STEP_S / 1.5
    flow = charge * (rpm / 30.0) * 3.6e-3
    charge_slow = s.charge_slow_kg_h + (flow - s.charge_slow_kg_h) * STEP_S / 1.5
    ratio = min(max(maf_slow / max(charge_slow, 3.0), 0.85), 1.15)
    correction = s.correction + (1.0 + 0.6 * (ratio - 1.0) - s.correction) * STEP_S / 2.0
    return _Meters(
        lag_kg_h=lag,
        maf_kg_h=maf,
        map_kpa=map_kpa,
        charge_mg=charge,
        maf_slow_kg_h=maf_slow,
        charge_slow_kg_h=charge_slow,
        correction=correction,
    )


@numba.njit(cache=True)
def _warm(
    coolant: float, t_man: float, flow_kg_h: float, boost_kpa: float, ambient_degc: float
) -> tuple[float, float]:
    """Return coolant and manifold temperature in °C one step later."""
    heat = 0.6 * (0.02 + flow_kg_h / 1500.0) * (1.0 if coolant < 88.0 else -0.3)
    coolant += STEP_S * (3.0 * heat - 0.0004 * (coolant - ambient_degc))
    soak = 0.18 * (coolant - ambient_degc) / (1.0 + flow_kg_h / 45.0) + 0.12 * boost_kpa
    return coolant, t_man + (ambient_degc + 4.0 + soak - t_man) * STEP_S / 25.0


@numba.njit(cache=True)
def _rail_step(rail: float, charge_ref: float, rpm: float, noise: float) -> float:
    """Return the rail pressure in MPa one step later."""
    rail_ref = 5.0 + 9.0 * min(charge_ref / 700.0, 1.0) + 5.0 * min(rpm / 4500.0, 1.0)
    return rail + ((rail_ref - rail) * STEP_S / 0.25 + 0.02 * noise * np.sqrt(STEP_S))


@numba.njit(cache=True)
def _purge_step(u: _Purge, allowed: bool, flow_kg_h: float, noise: float) -> _Purge:
    """Return the state of the purge one step later; it opens and closes every half minute."""
    wanted, timer = u.wanted, u.timer_s - STEP_S
    if timer <= 0.0:
        timer = 20.0 + 15.0 * abs(noise)
        wanted = 0.0 if wanted > 0.0 else 1.0
    duty_ref = wanted * (0.25 + 0.5 * min(flow_kg_h / 60.0, 1.0)) if allowed else 0.0
    return _Purge(wanted, timer, u.duty + (duty_ref - u.duty) * STEP_S / 1.2)


@numba.njit(cache=True)
def simulate(
    speed_ref: FloatArray,
    gears: FloatArray,
    brake_n: FloatArray,
    p: Piece,
    c: Conditions,
    e: Effects,
    noise: FloatArray,
) -> FloatArray:
    """Return the air side of the plant over the trace, the fields of ``SimulatedDrive``, (15, n).

    speed_ref : (n,) m/s; gears : (n,) 0 is neutral; brake_n : (n,) load of the dynamometer in N
    noise : (n, 5) standard normal: pedal, air meter, manifold pressure, rail, battery load
    """
    n = len(speed_ref)
    out = np.empty((15, n))
    m = _Motion(
        speed_m_s=speed_ref[0],
        engine_rpm=IDLE_RPM,
        torque_nm=0.0,
        friction_nm=0.0,
        integral=0.0,
        pedal_noise=0.0,
        gear=0,
        shift_s=0.0,
        engaged=False,
    )
    a = _Air(
        manifold_kpa=40.0,
        boost_kpa=0.0,
        throttle_m2=2e-5,
        runner_kpa=40.0,
        charge_mg=0.0,
        throttle_kg_s=0.0,
    )
    s = _Meters(
        lag_kg_h=8.0,
        maf_kg_h=0.0,
        map_kpa=0.0,
        charge_mg=0.0,
        maf_slow_kg_h=8.0,
        charge_slow_kg_h=100.0,
        correction=1.0,
    )
    u = _Purge(0.0, 30.0, 0.0)
    coolant, t_man, rail = c.coolant_start_degc, c.ambient_degc + 8.0, 6.0
    cut, overrun_s, load_v, load_timer = 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        v_ref, a_ref = speed_ref[k], _slope_ahead(speed_ref, k)
        m = _move(m, v_ref, a_ref, gears[k], brake_n[k], coolant, c.driver_noise, noise[k, 0])
        rpm = m.engine_rpm
        overrun_s = overrun_s + STEP_S if _overrun(m, cut) else 0.0
        cut = c.overrun_cut if overrun_s > 0.5 else 0.0
        charge_ref = max((m.torque_nm + m.friction_nm) / TORQUE_PER_MG, 70.0)
        a = _breathe(
            a, charge_ref, rpm, t_man, coolant, s.maf_slow_kg_h, p.ve_error, c.ambient_kpa, e
        )
        s = _measure(s, a, rpm, t_man, p, c, e, noise[k, 1], noise[k, 2])
        flow_kg_h = a.throttle_kg_s * 3600.0
        coolant, t_man = _warm(coolant, t_man, flow_kg_h, a.boost_kpa, c.ambient_degc)
        rail = _rail_step(rail, charge_ref, rpm, noise[k, 3])
        load_timer -= STEP_S
        if load_timer <= 0.0:
            load_timer = 8.0 + 12.0 * abs(noise[k, 4])
            load_v = 0.9 * min(max(noise[min(k + 1, n - 1), 4], -1.0), 1.0)
        allowed = coolant > 60.0 and cut == 0.0 and a.manifold_kpa < 0.85 * c.ambient_kpa
        u = _purge_step(u, allowed, flow_kg_h, noise[k, 4])

        out[0, k], out[1, k], out[2, k] = m.speed_m_s, rpm, m.torque_nm
        out[3, k], out[4, k], out[5, k] = 100 * (a.throttle_m2 / THROTTLE_MAX), s.map_kpa, t_man
        out[6, k], out[7, k], out[8, k] = a.charge_mg, s.charge_mg * s.correction, s.maf_kg_h
        out[9, k], out[10, k], out[11, k] = a.charge_mg * (rpm / 30.0) * 3.6e-3, coolant, cut
        out[12, k], out[13, k] = rail, 13.9 - load_v + 0.00012 * (rpm - 1500.0)
        out[14, k] = u.duty
    return out


def run(
    trace: SpeedTrace, p: Piece, c: Conditions, e: Effects, rng: np.random.Generator
) -> SimulatedDrive:
    """Return the air side of a drive; ``rng`` draws the noise of driver and sensors."""
    noise = rng.standard_normal((len(trace.speed_m_s), 5))
    out = simulate(trace.speed_m_s, trace.gear, trace.brake_force_n, p, c, e, noise)
    return SimulatedDrive(*out)
