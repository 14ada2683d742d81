"""A second engine for the gap workflow, with other equations than the dynamometer.

Its drives are made of stop and go at random, its control is an integrator with a square modulation,
its ECU meters by manifold pressure and trims that slowly by the air meter. Three passes at 100 Hz:
the car (no mixture in it), the charge as the ECU sees it, and the mixture with its control loop.
Sizes of the hidden effects are of the order of the noise at 1.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numba import njit

from monitor.base.faults import DRIFT_S, HOLD_EVERY_S, Fault
from monitor.base.signals import OUTPUT
from monitor.base.types import FloatArray
from training.greybox.fit import drive as drives
from training.greybox.fit.drive import ChainDrive

STEP_S = 0.01
PERIOD_S = 0.1
LENGTH_S = 600.0
WARM_UP_S = 12.0  # until the sensor is ready
LEANEST = 15.9  # lambda that the ECU sends at most
QUANTISATION = {
    "air_mass_mg": 0.1,
    "fuel_mass_mg": 0.02,
    "maf_kg_h": 0.1,
    "rail_pressure_mpa": 0.01,
    "manifold_pressure_kpa": 0.1,
    "manifold_temperature_degc": 0.1,
    "lambda_controller": 0.001,
    "lambda_measured": 0.001,
    "vehicle_speed_km_h": 0.1,
    "engine_speed_rpm": 1.0,
    "lambda_target": 0.001,
    "coolant_temperature_degc": 0.1,
    "ambient_pressure_kpa": 0.1,
    "purge_duty_percent": 0.5,
}
FLAGS = ("closed_loop", "fuel_cut", "sensor_ready")
MIXED = (  # what the mixture's pass gives, in its order
    "fuel_mass_mg",
    "rail_pressure_mpa",
    "lambda_controller",
    "lambda_measured",
    "lambda_target",
    "purge_duty_percent",
    "closed_loop",
    "sensor_ready",
)


class Hidden(NamedTuple):
    """Sizes of the effects, 0 for none."""

    wall_film: float = 0.0
    delay_flow: float = 0.0
    mix_flow: float = 0.0
    sensor_asymmetry: float = 0.0
    injector_offset: float = 0.0
    rail_exponent: float = 0.0
    maf_offset: float = 0.0
    maf_pulsation: float = 0.0
    purge: float = 0.0
    exhaust_leak: float = 0.0
    back_pressure: float = 0.0
    scavenging: float = 0.0
    fuel_cut_tail: float = 0.0
    manifold_filling: float = 0.0
    ethanol: float = 0.0


class Sensor(NamedTuple):
    """A faulty sensor, from ``start_s`` on."""

    lag_s: float = 0.0
    dead_time_s: float = 0.0
    gain: float = 1.0
    offset_lambda: float = 0.0
    start_s: float = 0.0
    edge: int = 0  # of lag and dead time; 1: lean to rich alone, -1: rich to lean alone
    stuck_lambda: float = 0.0  # 0: not stuck
    ripple_lambda: float = 0.0  # noise beside the stuck reading, standard deviation at 100 Hz
    drift_lambda_s: float = 0.0  # growth of the offset per second
    hold_s: float = 0.0  # so long the reading stands in every HOLD_EVERY_S
    ready: bool = True
    sent: bool = True

    @classmethod
    def of(cls, fault: Fault, start_s: float = 0.0) -> "Sensor":
        """Return the sensor with the monitor's named fault, in this engine's equations."""
        rising, falling = fault.tau_rising_s, fault.tau_falling_s
        edge = fault.delay_direction if fault.delay_s else int(rising > 0.0) - int(falling > 0.0)
        return cls(
            max(rising, falling),
            fault.delay_s,
            fault.gain,
            fault.offset_lambda,
            start_s,
            edge,
            fault.stuck_lambda,
            fault.ripple_lambda,
            fault.drift_lambda / DRIFT_S,
            fault.hold_s,
            not fault.not_ready,
            not fault.missing,
        )


SOUND = Sensor()


class Form(NamedTuple):
    """In which way effects act; other values than these make other engines."""

    flow_power: float = 1.0  # of the flow in dead time and mixing
    film_speed: float = 0.0  # powers of engine speed in the film's time, of the charge in its share
    film_load: float = 0.0
    leak_power: float = 1.0
    rail_curve: float = 0.0  # of the injector over the rail's pressure
    injector_speed: float = 0.4
    purge_power: float = 1.0  # of the pressure that draws the vapour
    back_power: float = 1.0  # of the flow in the sensor's sensitivity
    tail_power: float = 1.0  # of the flow in the emptying after a fuel cut
    own_film: float = 0.0  # share of the fuel that always wets walls
    curve: float = 0.0  # of the sound sensor

    @classmethod
    def of(cls, vehicle: int) -> "Form":
        """Return the form of a vehicle of its own kind."""
        rng = np.random.default_rng([79, vehicle])
        low = cls(0.6, -0.5, -0.6, 0.6, -0.15, -0.3, 0.5, 0.6, 0.6, 0.0, -0.15)
        high = cls(1.3, 0.8, 0.6, 1.3, 0.15, 1.0, 1.5, 1.5, 1.3, 0.02, 0.15)
        return cls(*rng.uniform(low, high).tolist())


FORM = Form()


class Piece(NamedTuple):
    """What differs from vehicle to vehicle."""

    meter: float
    injector: float
    pipe: float
    sensor_s: float


def drive(
    vehicle: int,
    seed: int,
    hidden: Mapping[str, float] | None = None,
    sensor: Sensor = SOUND,
    length_s: float = LENGTH_S,
    form: Form = FORM,
    outside: Callable[["Car"], "Outside"] | None = None,
) -> ChainDrive:
    """Return a drive of one vehicle at 10 Hz.

    outside : what an effect that no field of ``Hidden`` has does to the mixture
    """
    sent = broadcast(vehicle, seed, hidden, sensor, length_s, form, outside)
    signals = {name: values for name, values in sent.items() if name not in (OUTPUT, *FLAGS)}
    return drives.make(f"second engine {vehicle}", PERIOD_S, signals, sent[OUTPUT])


def broadcast(
    vehicle: int,
    seed: int,
    hidden: Mapping[str, float] | None = None,
    sensor: Sensor = SOUND,
    length_s: float = LENGTH_S,
    form: Form = FORM,
    outside: Callable[["Car"], "Outside"] | None = None,
) -> dict[str, FloatArray]:
    """Return what the ECU sends in a drive at 10 Hz, name → (n,); NaN where nothing comes.

    Arguments as for ``drive``. The flags are means over the period.
    """
    own = np.random.default_rng([77, vehicle])
    piece = Piece(
        own.normal(1, 0.01), own.normal(0, 0.008), own.uniform(0.8, 1.25), own.uniform(0.06, 0.12)
    )
    rng = np.random.default_rng([78, seed])
    cold, ambient_degc = rng.random() < 0.4, rng.uniform(5.0, 28.0)
    ambient_kpa = rng.uniform(94.0, 101.5)
    speed = wished_speed(rng, round(length_s / STEP_S))
    effects = Hidden(**(hidden or {}))
    car = drive_car(speed, ambient_degc, bool(cold))
    noise = rng.standard_normal((4, len(speed)))
    charge = meter(car, piece, effects, noise[0])
    more = Outside(np.ones(len(speed)), np.zeros(len(speed))) if outside is None else outside(car)
    car = car._replace(air_mg=car.air_mg / more.factor)
    vapour = more.vapour_mg_s
    mixed = _mix(car, charge[0], piece, effects, form, sensor, ambient_kpa, noise[1:], vapour)
    fine = dict(zip(MIXED, mixed, strict=True)) | {
        "air_mass_mg": charge[0],
        "maf_kg_h": charge[1],
        "manifold_pressure_kpa": car.manifold_kpa + rng.normal(0.0, 0.15, len(speed)),
        "manifold_temperature_degc": car.intake_degc,
        "vehicle_speed_km_h": speed * 3.6,
        "engine_speed_rpm": car.rpm,
        "coolant_temperature_degc": car.coolant_degc,
        "ambient_pressure_kpa": np.full(len(speed), ambient_kpa),
        "fuel_cut": car.cut,
    }
    each = round(PERIOD_S / STEP_S)
    means = {name: values.reshape(-1, each).mean(axis=1) for name, values in fine.items()}
    flags = {name: means[name] for name in FLAGS}
    return {
        name: np.round(means[name] / step) * step for name, step in QUANTISATION.items()
    } | flags


def wished_speed(rng: np.random.Generator, n: int) -> FloatArray:
    """Return stop and go, town and road at random, (n,) in m/s."""
    v, k, x = np.zeros(n), 0, 0.0
    while k < n:
        mode = rng.choice(4, p=[0.15, 0.35, 0.3, 0.2])
        low, high = ((0.0, 0.0), (20.0, 60.0), (50.0, 95.0), (90.0, 135.0))[mode]
        top, length = rng.uniform(low, high) / 3.6, int(rng.uniform(8.0, 45.0) / STEP_S)
        rate = rng.uniform(0.6, 2.2)
        for j in range(k, min(n, k + length)):
            wave = top * (1.0 + 0.03 * np.sin(j * STEP_S / rng.uniform(2.9, 3.1)))
            up, down = (rate, 0.4) if top > x else (0.4, rate)
            x = min(x + up * STEP_S, wave) if x < wave else max(x - down * STEP_S, wave)
            v[j] = x
        k += length
    return v


class Outside(NamedTuple):
    """What an effect of no library does to the mixture."""

    factor: FloatArray  # (n,)
    vapour_mg_s: FloatArray  # (n,) of fuel, while the engine injects


class Car(NamedTuple):
    """The car without its mixture, every field (n,)."""

    rpm: FloatArray
    manifold_kpa: FloatArray
    intake_degc: FloatArray
    coolant_degc: FloatArray
    cut: FloatArray
    air_mg: FloatArray  # per stroke, in the cylinder
    throttle_kg_h: FloatArray


@njit(cache=True)
def filled_mg(rpm: float, manifold_kpa: float, charge_degc: float) -> float:
    """Return the air per stroke of a half-litre cylinder."""
    efficiency = 0.80 + 0.11 * np.sin((rpm - 900.0) / 2600.0) + 0.0006 * (manifold_kpa - 60.0)
    return efficiency * manifold_kpa * 1000.0 * 0.5e-3 / (287.0 * (charge_degc + 273.15)) * 1e6


@njit(cache=True)
def charge_degc(intake: float, coolant: float, flow: float) -> float:
    """Return the temperature of the charge, which the port heats."""
    return intake + 0.32 * (coolant - intake) * np.exp(-flow / 140.0)


@njit(cache=True)
def drive_car(v: FloatArray, ambient: float, cold: bool) -> Car:
    """Return gears, throttle, manifold and temperatures for a wished speed (n,) in m/s."""
    n = len(v)
    out = np.zeros((7, n))
    ratios = np.array([13.5, 7.9, 5.4, 4.1, 3.3, 2.7])
    shift = np.array([9.5, 17.0, 25.0, 33.0, 42.0])
    gear, p, coolant, intake, flow = 0, 40.0, ambient if cold else 86.0, ambient + 8.0, 30.0
    for k in range(n):
        a = (v[min(k + 20, n - 1)] - v[k]) / (20 * STEP_S)
        if gear < 5 and v[k] * 3.6 > shift[gear] * (1.0 + 0.3 * max(a, 0.0)):
            gear += 1
        if gear > 0 and v[k] * 3.6 < shift[gear - 1] * 0.72:
            gear -= 1
        idle = 1070.0 if coolant < 50.0 else 820.0
        rpm = max(v[k] / 0.31 * ratios[gear] * 60.0 / 6.2832, idle)
        force = 1480.0 * a + 180.0 + 0.42 * v[k] * v[k]
        torque = (force * 0.31 / ratios[gear] / 0.93 if v[k] > 0.3 else 0.0) + 14.0 + 0.004 * rpm
        cut = torque < -6.0 and rpm > 1250.0 and coolant > 40.0
        wanted = 22.0 if cut else min(max(20.0 + 1.02 * torque, 18.0), 168.0)
        before, p = p, p + STEP_S / (0.09 + 25.0 / rpm) * (wanted - p)
        warm = ambient + 10.0 + 6.0 * (1.0 - min(v[k] / 20.0, 1.0))
        intake += STEP_S / 90.0 * (warm - intake)
        air = filled_mg(rpm, p, charge_degc(intake, coolant, flow))
        through = air * rpm / 30.0 * 3600e-6 + (p - before) * 3.6
        flow += STEP_S / 0.04 * (through - flow)
        coolant += STEP_S * (0.055 + 0.0011 * flow) * (1.0 if coolant < 88.0 else -0.4)
        out[:, k] = (rpm, p, intake, coolant, 1.0 if cut else 0.0, air, flow)
    return Car(out[0], out[1], out[2], out[3], out[4], out[5], out[6])


@njit(cache=True)
def meter(car: Car, piece: Piece, e: Hidden, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the charge per stroke in mg as the ECU has it, and what its air meter reads."""
    n = len(car.rpm)
    charge, read = np.zeros(n), np.zeros(n)
    metered, model, trim = 250.0, 200.0, 1.0
    for k in range(n):
        rpm, p, through = car.rpm[k], car.manifold_kpa[k], car.throttle_kg_h[k]
        reading = through * piece.meter + e.maf_offset * 0.35
        wave = np.exp(-(((rpm - 1350.0) / 420.0) ** 2)) * max(p - 55.0, 0.0) / 40.0
        reading = max(reading * (1.0 + 0.01 * e.maf_pulsation * wave), 0.5)
        reading += noise[k] * 0.08
        per_stroke = rpm / 30.0 * 3600e-6
        metered += STEP_S / 0.05 * (reading / per_stroke - metered)
        warm = charge_degc(car.intake_degc[k], car.coolant_degc[k], through)
        by_pressure = filled_mg(rpm, p, warm) * (1.0 + piece.injector)
        trim += STEP_S / 1.5 * (min(max(metered / max(model, 5.0), 0.7), 1.4) - trim)
        model += STEP_S / 0.09 * (by_pressure - model)
        filling = through / per_stroke - car.air_mg[k]
        charge[k] = by_pressure * trim + 0.05 * e.manifold_filling * filling
        read[k] = reading
    return charge, read


@njit(cache=True)
def _mix(car, charge, piece, e, form, sensor, ambient_kpa, noise, vapour_mg_s):  # type: ignore[no-untyped-def]  # noqa: PLR0915
    n = len(charge)
    out = np.zeros((8, n))
    valve, gas_read = np.ones(1024), np.ones(1024)
    film, vapour, load, duty, rail = 0.0, 0.0, 1.0, 0.0, 6.0
    mixed, sensed, slow, lean, drift = 1.0, 1.0, 1.0, 0.0, 0.0
    trim, integral, filtered, since_cut, measured = 1.0, 0.0, 0.0, 99.0, 1.0
    for k in range(n):
        t_s, rpm, p, coolant = k * STEP_S, car.rpm[k], car.manifold_kpa[k], car.coolant_degc[k]
        cut, strokes, air = car.cut[k] > 0.0, car.rpm[k] / 30.0, car.air_mg[k]
        flow = max(air * strokes * 3600e-6, 3.0)
        # what the ECU asks for
        rich = 1.0 + 0.07 * max(50.0 - coolant, 0.0) / 60.0
        if rpm > 3000.0 and charge[k] > 560.0:
            rich *= 1.0 + 0.06 * min((charge[k] - 560.0) / 150.0, 1.0)
        swing = 0.018 * (1.0 if t_s % 1.3 < 0.65 else -1.0) * (coolant > 60.0)
        since_cut = 0.0 if cut else since_cut + STEP_S
        faulty = t_s >= sensor.start_s
        ready = t_s > WARM_UP_S and (sensor.ready or not faulty)
        heard = sensor.sent or not faulty
        closed = t_s > 25.0 and coolant > 20.0 and since_cut > 1.0 and rich == 1.0
        closed = closed and ready and heard
        fuel = 0.0 if cut else charge[k] / 14.55 * rich * (1.0 + swing) * trim
        rail += STEP_S / 0.3 * (5.0 + 12.0 * min(max((charge[k] - 120.0) / 450.0, 0.0), 1.0) - rail)
        # what enters
        injected = fuel * (1.0 + piece.injector * np.sin(charge[k] / 170.0))
        injected *= (rail / 9.0) ** (0.02 * e.rail_exponent)
        injected *= 1.0 + 0.02 * e.rail_exponent * form.rail_curve * (rail / 9.0 - 1.0) ** 2
        by_speed = 1.0 + form.injector_speed * rpm / 3000.0
        injected += 0.0 if cut else 0.12 * e.injector_offset * by_speed
        cold = max(80.0 - coolant, 0.0) / 60.0
        wet = (form.own_film + 0.045 * e.wall_film) * (
            max(charge[k], 20.0) / 250.0
        ) ** form.film_load
        share = min(wet * (1.0 + cold), 0.6)
        film_s = (0.5 + 0.6 * cold) * (2000.0 / rpm) ** form.film_speed
        film += STEP_S * (share * injected * strokes - film / film_s)
        entered = injected * (1.0 - share) + film / film_s / strokes
        open_ = coolant > 65.0 and not cut and t_s % 70.0 > 22.0 and rpm > 1000.0
        wanted = min(15.0 + 0.6 * car.throttle_kg_h[k], 75.0) if open_ else 0.0
        duty += np.sign(wanted - duty) * min(abs(wanted - duty), 40.0 * STEP_S)
        load *= np.exp(-STEP_S * duty / 100.0 / 400.0)
        draught = (max(ambient_kpa - p, 0.0) / 60.0) ** form.purge_power
        drawn = 2.25 * e.purge * load * duty / 100.0 * draught
        vapour += STEP_S / 0.5 * (drawn - vapour)
        entered = 0.0 if cut else entered + (vapour + vapour_mg_s[k]) / strokes
        through = max(p - 96.0, 0.0) / 30.0 * max(1.0 - (rpm - 800.0) / 1800.0, 0.0)
        air *= 1.0 + 0.012 * e.scavenging * through
        valve[k % 1024] = 14.55 * (1.0 - 0.004 * e.ethanol) * entered / max(air, 5.0)
        # the way to the sensor
        filling = 1.0 / flow if form.flow_power == 1.0 else 0.05 * (20.0 / flow) ** form.flow_power
        late_s = 96.0 / rpm + (2.7 * piece.pipe + 0.35 * e.delay_flow) * filling + 0.03
        steps = min(late_s / STEP_S, 1000.0)
        whole = int(steps)
        part = steps - whole
        gas = valve[(k - whole) % 1024] * (1.0 - part) + valve[(k - whole - 1) % 1024] * part
        mixed += STEP_S / (0.05 + (0.6 + 0.4 * e.mix_flow) * filling) * (gas - mixed)
        gas = mixed * (1.0 - 0.0048 * e.exhaust_leak * (18.0 / (flow + 8.0)) ** form.leak_power)
        lean = 1.0 if cut else lean * np.exp(-STEP_S * (flow / 25.0) ** form.tail_power)
        gas *= 1.0 if cut else 1.0 - 0.045 * e.fuel_cut_tail * lean
        gas = 1.0 + (gas - 1.0) * (1.0 + 0.03 * e.back_pressure * (flow / 50.0) ** form.back_power)
        rising = 1.0 + 0.35 * e.sensor_asymmetry if gas > sensed else 1.0
        sensed += STEP_S / (piece.sensor_s * rising) * (gas - sensed)
        # how it is read
        reading = sensed + form.curve * (sensed - 1.0) ** 2
        gas_read[k % 1024] = reading
        if faulty:
            back = min(sensor.dead_time_s, t_s - sensor.start_s)
            late = gas_read[(k - int(back / STEP_S)) % 1024]
            # of one edge alone: a late reading below the gas lags an edge to rich
            reading = late if sensor.edge * (reading - late) >= 0.0 else reading
            if sensor.lag_s > 0.0:
                lagging = sensor.edge * (reading - slow) >= 0.0
                slow += (min(STEP_S / sensor.lag_s, 1.0) if lagging else 1.0) * (reading - slow)
                reading = slow
            reading = 1.0 + sensor.gain * (reading - 1.0)
        else:
            slow = sensed
        drift = 0.97 * drift + 0.12 * noise[0, k]
        line = 0.0025 * np.sin(6.2832 * 2.45 * t_s) * (1.0 if flow > 8.0 else 0.3)
        reading += 0.0015 * noise[1, k] + 0.0012 * drift + line
        before, measured = measured, 1.0 / max(reading, 1.0 / LEANEST)
        if faulty:
            since_s = t_s - sensor.start_s
            measured += sensor.offset_lambda + sensor.drift_lambda_s * since_s
            if sensor.stuck_lambda > 0.0:
                measured = sensor.stuck_lambda + sensor.ripple_lambda * noise[1, k]
            if since_s % HOLD_EVERY_S < sensor.hold_s:
                measured = before
        measured = min(measured, LEANEST) if ready or sensor.ready else 1.0
        if closed:
            filtered += STEP_S / 0.1 * (1.0 / measured - 1.0 - filtered)
            integral = min(max(integral - STEP_S * 0.35 * filtered, -0.25), 0.25)
        trim = 1.0 + integral - (0.12 * filtered if closed else 0.0)
        noisy = rail + noise[2, k] * 0.02
        seen = measured if heard else np.nan
        out[:, k] = (fuel, noisy, trim, seen, 1.0 / rich, duty, 1.0 * closed, 1.0 * ready)
    return out
