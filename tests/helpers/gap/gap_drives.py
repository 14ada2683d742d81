"""A drive made of plain formulas for tests of the gap workflow: no simulator behind it."""

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.effects import LIBRARY
from training.greybox.fit.case import Case
from training.greybox.fit.drive import ChainDrive, make

PERIOD_S = 0.1
BASE = Constants(
    gain=1.01, dead_time_s=0.13, dead_time_revolutions=1.5, mixing_s=0.04, sensor_s=0.11, span=0.98
)


def plain_signals(n: int = 6000, seed: int = 1) -> dict[str, FloatArray]:
    """Return signals of a warm drive with load steps, mixture steps and some fuel cuts."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(n) * PERIOD_S
    rpm = 1900.0 + 800.0 * np.sin(t_s / 17.0) + 300.0 * np.sin(t_s / 5.3 + seed)
    load = np.repeat(rng.uniform(0.2, 1.0, n // 40 + 1), 40)[:n]
    air = 120.0 + 500.0 * np.convolve(np.pad(load, 4, mode="edge"), np.ones(9) / 9.0, "valid")
    phi = 1.0 + 0.03 * np.sign(np.sin(t_s * 2.1)) + 0.03 * (load - 0.6)
    cut = (np.sin(t_s / 9.0 + seed) > 0.97) & (rpm > 1500.0)
    flow = air * rpm * 3600.0 / 1e6 / 30.0
    return {
        "air_mass_mg": air,
        "fuel_mass_mg": np.where(cut, 0.0, air / 14.7 * phi),
        "maf_kg_h": flow,
        "rail_pressure_mpa": 6.0 + 8.0 * load,
        "manifold_pressure_kpa": 25.0 + 100.0 * load,
        "manifold_temperature_degc": 30.0 + 5.0 * np.sin(t_s / 60.0),
        "engine_speed_rpm": rpm,
        "coolant_temperature_degc": np.minimum(20.0 + 0.3 * t_s, 88.0),
        "ambient_pressure_kpa": np.full(n, 98.0),
        "purge_duty_percent": np.where(np.sin(t_s / 13.0) > 0.0, 50.0, 0.0),
    }


def noisy_drive(
    seed: int = 1, noise: float = 0.003, effect: str = "", value: float = 0.0
) -> ChainDrive:
    """Return such a drive of the chain with the constants BASE, an effect and white noise."""
    signals = plain_signals(seed=seed)
    path = base_path(BASE, signals)
    if effect:
        path = LIBRARY[effect].apply(path, np.array([value]), signals, PERIOD_S)
    phi = simulate(path, PERIOD_S)
    phi = phi + noise * np.random.default_rng(seed).standard_normal(len(phi))
    return make(f"drive {seed}", PERIOD_S, signals, 1.0 / np.maximum(phi, 0.07))


def case_of(*drives: ChainDrive) -> Case:
    """Return drives to be fitted, with the noise that ``noisy_drive`` has."""
    return Case(drives, tuple(np.zeros(len(d)) for d in drives), sigma=0.003)
