"""A catalyst and a rear sensor behind the second engine, with other equations than dynamometer and
monitor.

Ceria has a surface that gas reaches at once and a bulk that exchanges with the surface slowly. Gas
flows as a plug through three slices; in each it reacts with a rate, so that what passes depends on
how long it stays: x_out = x_in · exp(-k · free / flow). The rear sensor is a Nernst cell with two
electrodes' lags and a hysteresis. The ECU refills the catalyst after a fuel cut by a fixed amount
of fuel, and its outer loop steps the mixture up or down by the rear sensor's side.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from benchmarks.studies.second import engine as second_engine
from monitor.base.types import FloatArray

PERIOD_S = second_engine.PERIOD_S
SUBSTEPS = 20  # of a sample
NAMES = (
    "downstream_voltage_v",
    "lambda_measured",
    "maf_kg_h",
    "catalyst_temperature_degc",
    "fuel_cut",
    "engine_speed_rpm",
)


class Brick(NamedTuple):
    """What differs from vehicle to vehicle."""

    capacity_g: float
    surface: float  # part of it that gas reaches at once
    exchange_s: float
    reach: float  # rate of reaction, g/s of flow at which 63 % react in one slice
    release: float  # rate of release over that of filling
    sensor_s: float
    leak: float = 0.0  # air drawn in before the rear sensor, at no flow, as a part of the exhaust


def brick(vehicle: int, capacity_g: float) -> Brick:
    """Return the catalyst of a vehicle, with this capacity."""
    rng = np.random.default_rng([79, vehicle])
    return Brick(
        capacity_g,
        rng.uniform(0.55, 0.8),
        rng.uniform(1.0, 3.0),
        rng.uniform(60.0, 110.0),
        rng.uniform(0.5, 0.8),
        rng.uniform(0.06, 0.15),
    )


def drive(
    vehicle: int, seed: int, own: Brick, sensor_lag_s: float = 0.0, offset_lambda: float = 0.0
) -> FloatArray:
    """Return ten minutes at 10 Hz of a warm brick, (n, NAMES).

    sensor_lag_s : added to the rear sensor; offset_lambda : of the front sensor
    """
    upstream = second_engine.drive(vehicle, seed)
    # the loop holds the reading, so an offset of the front sensor moves the gas
    phi = 1.0 / np.maximum(1.0 / upstream.phi_measured - offset_lambda, 1.0 / 15.9)
    air_g_s = np.maximum(upstream.signals["maf_kg_h"] / 3.6, 0.8)
    cut = (upstream.signals["fuel_mass_mg"] <= 0.0).astype(np.float64)
    rng = np.random.default_rng([80, vehicle, seed])
    noise = rng.standard_normal(len(phi))
    volts, made = _behind(phi, air_g_s, cut, own, sensor_lag_s, noise)
    reading = 1.0 / np.maximum(made, 1.0 / 15.9)
    reading = np.where(cut > 0.0, reading, reading + offset_lambda)
    warm = np.minimum(300.0 + 3.0 * np.arange(len(phi)) * PERIOD_S, 640.0)
    return np.column_stack(
        [volts, reading, 3.6 * air_g_s, warm, cut, upstream.signals["engine_speed_rpm"]]
    )


@njit(cache=True)
def _behind(phi, air_g_s, cut, own, lag_s, noise):  # type: ignore[no-untyped-def]
    n, step = len(phi), PERIOD_S / SUBSTEPS
    volts, made = np.zeros(n), np.zeros(n)
    surface, bulk = np.full(3, 0.5), np.full(3, 0.5)
    fast, slow, aged, owed, trim, side = 0.5, 0.5, 0.5, 0.0, 0.0, 0.0
    room = own.capacity_g / 3.0
    for k in range(n):
        flow = air_g_s[k]
        enriched = phi[k]
        if cut[k] > 0.0:
            owed = min(owed + 0.23 * flow * PERIOD_S, 0.6 * own.capacity_g)
        else:
            enriched += trim
            if owed > 0.0:
                enriched += 0.04
                owed -= 0.23 * flow * 0.04 * PERIOD_S
        made[k] = enriched
        for _ in range(SUBSTEPS):
            x = 1.0 - enriched
            for j in range(3):
                free = 1.0 - surface[j] if x > 0.0 else surface[j]
                rate = own.reach * (1.0 if x > 0.0 else own.release)
                passes = np.exp(-rate * max(free, 0.0) / flow)
                taken = 0.23 * flow * x * (1.0 - passes) * step
                most = max(free, 0.0) * own.surface * room
                taken = max(min(taken, most), -most)
                surface[j] += taken / (own.surface * room)
                x -= taken / (0.23 * flow * step)
                moved = (surface[j] - bulk[j]) * step / own.exchange_s * (1.0 - own.surface)
                surface[j] -= moved / own.surface
                bulk[j] += moved / (1.0 - own.surface)
            gas = x + own.leak * 6.0 / (flow + 6.0) + 0.0012 * (surface[2] - 0.5)
            # hydrogen makes the sensor read rich; a switching cell has a hysteresis
            seen = gas - 0.0008 - 0.0004 * side
            steady = 0.5 - np.arctan(seen / 0.0007) / np.pi
            fast += (steady - fast) * step / own.sensor_s
            slow += (steady - slow) * step / (5.0 * own.sensor_s)
            both = 0.75 * fast + 0.25 * slow
            aged += (both - aged) * (1.0 if lag_s <= 0.0 else min(step / lag_s, 1.0))
            side = 1.0 if aged > 0.6 else (-1.0 if aged < 0.4 else side)
        volts[k] = 0.06 + 0.78 * aged + 0.006 * noise[k]
        if cut[k] <= 0.0:
            wanted = 0.004 if aged < 0.62 else -0.004
            trim += (wanted - trim) * PERIOD_S / 2.0
    return volts, made
