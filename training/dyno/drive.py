"""First half of the plant: driver, vehicle, engine speed, air path, temperatures, fuel cut.

Nothing here depends on lambda, so it runs once before the mixture loop. The state is integrated
at 100 Hz. Manifold filling and throttle flow follow the mean value engine model (Hendricks and
Sorenson, SAE 900616).
"""

from typing import NamedTuple

import numba
import numpy as np

from monitor.types import FloatArray
from training.dyno.cycles import STEP_S, TOTAL_RATIO, WHEEL_RADIUS_M, Trace
from training.dyno.effects import Effects
from training.dyno.vehicle import VE_LOADS_KPA, VE_SPEEDS_RPM, Conditions, Piece

R_AIR = 287.0
DISPLACEMENT_M3 = 2.0e-3
MANIFOLD_M3 = 5.5e-3
TORQUE_PER_MG = 0.36  # indicated torque in Nm per mg of air and stroke
IDLE_RPM = 780.0
MASS_KG = 1450.0
THROTTLE_MAX = 5.0e-4  # effective area in m2


class Drive(NamedTuple):
    """The plant's air side on the 10 ms grid, every field (n,)."""

    speed_m_s: FloatArray
    engine_rpm: FloatArray
    torque_nm: FloatArray
    throttle_percent: FloatArray
    manifold_kpa: FloatArray
    manifold_degc: FloatArray
    air_true_mg: FloatArray  # per stroke, what enters the cylinder
    air_ecu_mg: FloatArray  # per stroke, what the ECU believes
    maf_kg_h: FloatArray  # as the air meter reads it
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
def _nominal_ve(rpm: float, kpa: float) -> float:
    """Volumetric efficiency as calibrated."""
    return 0.80 + 0.11 * np.exp(-(((rpm - 3200.0) / 1900.0) ** 2)) + 0.05 * (1 - 35.0 / (kpa + 15))


@numba.njit(cache=True)
def _psi(ratio: float) -> float:
    """Throttle flow function, linear close to equal pressures so that it stays differentiable."""
    if ratio > 0.95:
        return 0.3765 * max(1.0 - ratio, -0.02) / 0.05
    if ratio < 0.528:
        return 0.6847
    return np.sqrt(7.0 * (ratio**1.42857 - ratio**1.71429))


@numba.njit(cache=True)
def _charge_mg(ve: float, kpa: float, degc: float) -> float:
    """Air per stroke in mg from volumetric efficiency, pressure and temperature."""
    return ve * DISPLACEMENT_M3 / 4.0 * kpa * 1e3 / (R_AIR * (degc + 273.15)) * 1e6


@numba.njit(cache=True)
def _engine_target_rpm(v: float, gear: int) -> float:
    if gear == 0:
        return IDLE_RPM
    rpm = v / WHEEL_RADIUS_M * TOTAL_RATIO[gear - 1] * 30.0 / np.pi
    return max(rpm, 1150.0 if gear == 1 else IDLE_RPM)


@numba.njit(cache=True)
def _wheel_demand_n(v: float, v_ref: float, a_ref: float, integral: float, brake: float) -> float:
    road = 130.0 + 1.2 * v + 0.42 * v * v if v > 0.05 else 0.0
    return MASS_KG * (a_ref + 0.9 * (v_ref - v) + 0.12 * integral) + road + brake


@numba.njit(cache=True)
def simulate(  # noqa: PLR0915  one loop over time, split where the signals allow it
    speed_ref: FloatArray,
    gears: FloatArray,
    brake_n: FloatArray,
    p: Piece,
    c: Conditions,
    e: Effects,
    noise: FloatArray,
) -> Drive:
    """Integrate the air side over the trace.

    noise : (n, 5) standard normal: pedal, air meter, manifold pressure, rail, battery load
    """
    n = len(speed_ref)
    out = np.empty((15, n))
    v, rpm, integral, pedal_noise = speed_ref[0], IDLE_RPM, 0.0, 0.0
    p_man, p_boost, area, t_man = 40.0, 0.0, 2e-5, c.ambient_degc + 8.0
    torque, p_runner, correction, coolant = 0.0, 40.0, 1.0, c.coolant_start_degc
    maf_lag, maf_slow, charge_slow, rail = 8.0, 8.0, 100.0, 6.0
    cut, cut_timer, shift_timer, last_gear = 0.0, 0.0, 0.0, 0
    load_v, load_timer, purge, purge_timer = 0.0, 0.0, 0.0, 30.0
    speeds, loads = VE_SPEEDS_RPM, VE_LOADS_KPA
    for k in range(n):
        # driver and vehicle
        ahead = min(k + 30, n - 1)
        a_ref = (speed_ref[ahead] - speed_ref[k]) / ((ahead - k) * STEP_S) if ahead > k else 0.0
        pedal_noise += (-pedal_noise * STEP_S / 0.8) + 0.16 * np.sqrt(STEP_S) * noise[k, 0]
        integral = min(max(integral + (speed_ref[k] - v) * STEP_S, -8.0), 8.0)
        demand_n = _wheel_demand_n(v, speed_ref[k], a_ref, integral, brake_n[k])
        demand_n *= 1.0 + c.driver_noise * pedal_noise
        gear = gears[k]
        if gear != last_gear:
            shift_timer, last_gear = 0.35, gear
        shift_timer -= STEP_S
        engaged = gear > 0 and shift_timer <= 0.0 and (v > 0.2 or demand_n > 0.0)
        friction = 46.0 + 0.006 * rpm + 0.3 * max(60.0 - coolant, 0.0)
        ratio = TOTAL_RATIO[gear - 1] if gear > 0 else 1.0
        wanted = demand_n * WHEEL_RADIUS_M / (ratio * 0.92) if engaged else 0.0
        idle_torque = 0.05 * (IDLE_RPM - rpm) if not engaged else 0.0
        torque_ref = min(max(wanted, -friction), 300.0) + idle_torque
        torque += (torque_ref - torque) * STEP_S / 0.12
        force = torque * ratio * 0.92 / WHEEL_RADIUS_M if engaged else 0.0
        if wanted < -friction or (not engaged and demand_n < 0.0):
            force = demand_n  # the brakes do the rest
        road = 130.0 + 1.2 * v + 0.42 * v * v if v > 0.05 else 0.0
        v = max(v + (force - road - brake_n[k]) / MASS_KG * STEP_S, 0.0)
        if speed_ref[k] < 0.05 and v < 0.6:
            v, integral = max(v - 1.5 * STEP_S, 0.0), 0.0
        rpm += (_engine_target_rpm(v, gear) - rpm) * STEP_S / (0.15 if engaged else 0.4)

        # fuel cut on overrun
        overrun = engaged and torque < -0.55 * friction and rpm > (1350.0 if cut > 0 else 1600.0)
        cut_timer = cut_timer + STEP_S if overrun else 0.0
        cut = 1.0 if cut_timer > 0.5 else 0.0

        # air path: desired charge, boost, throttle, manifold, runner
        charge_ref = max((torque + friction) / TORQUE_PER_MG, 70.0)
        t_k = t_man + 273.15
        ve_nominal = _nominal_ve(rpm, p_man)
        p_ref = charge_ref / max(_charge_mg(ve_nominal, 1.0, t_man), 1e-6)
        p_ref = min(max(p_ref, 15.0), 2.1 * c.ambient_kpa)
        boost_ref = min(max(1.06 * p_ref - c.ambient_kpa, 0.0), 0.022 * max(rpm - 900.0, 0.0))
        p_boost += (boost_ref - p_boost) * STEP_S / 0.5
        p_up = 0.985 * c.ambient_kpa + p_boost
        strokes_per_s = rpm / 30.0
        flow_ref = charge_ref * 1e-6 * strokes_per_s
        speed_factor = 1e3 / np.sqrt(R_AIR * t_k)
        area_ref = flow_ref / (p_up * speed_factor * max(_psi(p_ref / p_up), 0.06))
        area += (min(area_ref, THROTTLE_MAX) - area) * STEP_S / 0.07
        resonance = 1.0 + e.intake_resonance * np.exp(-(((rpm - 1850.0) / 140.0) ** 2))
        ve = ve_nominal * resonance
        ve *= 1.0 + _bilinear(p.ve_error, speeds, loads, rpm, p_man)
        wall = e.charge_temperature * max(coolant - t_man, 0.0) / (0.4 + maf_slow / 60.0)
        runner_tau = e.manifold_filling * 1500.0 / max(rpm, 500.0)
        p_runner += (p_man - p_runner) * STEP_S / (runner_tau + STEP_S)
        air = _charge_mg(ve, p_runner, t_man + wall)
        flow_in = area * p_up * speed_factor * _psi(p_man / p_up)
        stiff = area * speed_factor * 7.53 + air * 1e-6 * strokes_per_s / max(p_man, 10.0)
        gain = R_AIR * t_k / MANIFOLD_M3 * 1e-3
        p_man += (
            STEP_S * gain * (flow_in - air * 1e-6 * strokes_per_s) / (1 + STEP_S * gain * stiff)
        )
        p_man = min(max(p_man, 12.0), 260.0)

        # sensors of the air path and the ECU's charge
        pulse = np.exp(-(((rpm - 1300.0) / 450.0) ** 2)) * max(p_man / c.ambient_kpa - 0.55, 0.0)
        flow_kg_h = flow_in * 3600.0
        reading = flow_kg_h * p.maf_gain * (1.0 + 2.0 * e.maf_pulsation * pulse) + e.maf_offset
        maf_lag += (reading - maf_lag) * STEP_S / 0.03
        maf = max(maf_lag * (1.0 + 0.004 * noise[k, 1]), 0.0)
        map_kpa = p_man + p.map_offset_kpa + 0.08 * noise[k, 2]
        charge_sd = _charge_mg(_nominal_ve(rpm, map_kpa), map_kpa, t_man)
        maf_slow += (maf - maf_slow) * STEP_S / 1.5
        charge_slow += (charge_sd * strokes_per_s * 3.6e-3 - charge_slow) * STEP_S / 1.5
        ratio_slow = min(max(maf_slow / max(charge_slow, 3.0), 0.85), 1.15)
        correction += (1.0 + 0.6 * (ratio_slow - 1.0) - correction) * STEP_S / 2.0

        # temperatures, rail, battery, purge
        heat = 0.6 * (0.02 + flow_kg_h / 1500.0) * (1.0 if coolant < 88.0 else -0.3)
        coolant += STEP_S * (3.0 * heat - 0.0004 * (coolant - c.ambient_degc))
        soak = 0.18 * (coolant - c.ambient_degc) / (1.0 + flow_kg_h / 45.0) + 0.12 * p_boost
        t_man += (c.ambient_degc + 4.0 + soak - t_man) * STEP_S / 25.0
        rail_ref = 5.0 + 9.0 * min(charge_ref / 700.0, 1.0) + 5.0 * min(rpm / 4500.0, 1.0)
        rail += (rail_ref - rail) * STEP_S / 0.25 + 0.02 * noise[k, 3] * np.sqrt(STEP_S)
        load_timer -= STEP_S
        if load_timer <= 0.0:
            load_timer = 8.0 + 12.0 * abs(noise[k, 4])
            load_v = 0.9 * min(max(noise[min(k + 1, n - 1), 4], -1.0), 1.0)
        battery = 13.9 - load_v + 0.00012 * (rpm - 1500.0)
        purge_timer -= STEP_S
        if purge_timer <= 0.0:
            purge_timer = 20.0 + 15.0 * abs(noise[k, 4])
            purge = 0.0 if purge > 0.0 else 1.0
        allowed = coolant > 60.0 and cut == 0.0 and p_man < 0.85 * c.ambient_kpa
        previous = out[14, k - 1] if k > 0 else 0.0
        duty_ref = purge * (0.25 + 0.5 * min(flow_kg_h / 60.0, 1.0)) if allowed else 0.0
        duty = previous + (duty_ref - previous) * STEP_S / 1.2

        out[0, k], out[1, k], out[2, k], out[3, k] = v, rpm, torque, 100 * (area / THROTTLE_MAX)
        out[4, k], out[5, k], out[6, k] = map_kpa, t_man, air
        out[7, k] = charge_sd * correction
        out[8, k], out[9, k], out[10, k], out[11, k] = (
            maf,
            air * strokes_per_s * 3.6e-3,
            coolant,
            cut,
        )
        out[12, k], out[13, k], out[14, k] = rail, battery, duty
    return Drive(
        out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7],
        out[8], out[9], out[10], out[11], out[12], out[13], out[14],
    )  # fmt: skip


def run(trace: Trace, p: Piece, c: Conditions, e: Effects, rng: np.random.Generator) -> Drive:
    """Return the air side of a drive; ``rng`` makes the driver and the sensor noise."""
    noise = rng.standard_normal((len(trace.speed_m_s), 5))
    return simulate(trace.speed_m_s, trace.gear, trace.brake_force_n, p, c, e, noise)
