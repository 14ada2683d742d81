"""Parameters of one simulated vehicle, and the conditions of one drive.

The vehicle is a car of 1,450 kg with a turbocharged 2.0 l four-cylinder engine and direct
injection. The vehicle number draws the production spread; the seed draws driver, noise and weather.
"""

from typing import NamedTuple

import numpy as np

from monitor.base.types import FloatArray

STOICHIOMETRIC_AIR_FUEL = 14.7  # by mass, of the fuel that the ECU was calibrated for
VE_SPEEDS_RPM = np.array([700.0, 1500.0, 2500.0, 3500.0, 5000.0])
VE_LOADS_KPA = np.array([20.0, 50.0, 90.0, 140.0, 200.0])


class Piece(NamedTuple):
    """Parameters that differ between two vehicles of the type, within production spread."""

    maf_gain: float
    map_offset_kpa: float
    injector_gain: float
    injector_curve_mg: float  # static flow error of a short injection
    transport_delay_s: float  # of the exhaust, without the part that depends on engine speed
    mixing_tau_s: float
    sensor_tau_s: float
    sensor_gain: float
    sensor_offset: float  # in phi
    ve_error: FloatArray  # (5, 5) relative error of the ECU's volumetric efficiency, speed × load


class Conditions(NamedTuple):
    """Weather, soak and disturbances of one drive."""

    ambient_degc: float
    ambient_kpa: float
    coolant_start_degc: float
    canister_load: float  # 0 to 1
    driver_noise: float  # relative
    line_hz: float  # frequency of the disturbance line
    line_phi: float  # amplitude of the disturbance line
    combustion_noise_phi: float  # standard deviation of the mixture noise
    overrun_cut: float = 1.0  # 0: the ECU cuts no fuel on overrun


def piece(vehicle: int) -> Piece:
    """Return the parameters of the vehicle with this number; equal numbers, equal parameters."""
    rng = np.random.default_rng([0x0_2, 1, vehicle])
    spread = rng.standard_normal
    return Piece(
        maf_gain=1.0 + 0.007 * _bounded(spread()),
        map_offset_kpa=0.25 * _bounded(spread()),
        injector_gain=1.0 + 0.008 * _bounded(spread()),
        injector_curve_mg=0.10 * _bounded(spread()),
        transport_delay_s=0.12 * (1.0 + 0.08 * _bounded(spread())),
        mixing_tau_s=0.06 * (1.0 + 0.10 * _bounded(spread())),
        sensor_tau_s=0.09 * (1.0 + 0.12 * _bounded(spread())),
        sensor_gain=1.0 + 0.010 * _bounded(spread()),
        sensor_offset=0.002 * _bounded(spread()),
        ve_error=0.006 * np.clip(rng.standard_normal((5, 5)), -2.0, 2.0),
    )


def conditions(seed: int) -> Conditions:
    """Return the conditions that a seed draws; two thirds of the drives start warm."""
    rng = np.random.default_rng([0x0_2, 2, seed])
    ambient_degc = float(np.clip(rng.normal(17.0, 9.0), -10.0, 40.0))
    warm = rng.random() < 2.0 / 3.0
    return Conditions(
        ambient_degc=ambient_degc,
        ambient_kpa=float(np.clip(rng.normal(98.5, 3.0), 80.0, 103.0)),
        coolant_start_degc=float(rng.uniform(65.0, 92.0)) if warm else ambient_degc,
        canister_load=float(rng.uniform(0.2, 1.0)),
        driver_noise=float(rng.uniform(0.5, 1.5)),
        line_hz=float(rng.uniform(2.42, 2.48)),
        line_phi=0.0025,
        combustion_noise_phi=float(rng.uniform(0.006, 0.009)),
    )


def _bounded(x: float) -> float:
    return float(np.clip(x, -2.0, 2.0))
