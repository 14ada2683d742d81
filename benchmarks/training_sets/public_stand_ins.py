"""Synthetic files in the formats of the public benchmarks, of plants that resemble them.

Names, variables, shapes, rates and lengths are those of the public files, so the scoreboard can run
without them. Tanks, oscillator and filters are those of systems.py; the drives are a belt between
two motors, the pilot plant a conical tank with a slow pump. Errors on these files say nothing about
the real plants.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import signal
from scipy.io import savemat

from benchmarks.training_sets.public_data import PLANTS
from benchmarks.training_sets.systems import (
    multisine,
    oscillator_places,
    sandwich_output,
    tank_levels,
)

Content = dict[str, np.ndarray | float]
VOLT_PER_PLACE = 0.2  # of the oscillator: about 0.05 V rms in the multisine


def tanks(rng: np.random.Generator) -> Content:
    """Two tanks that overflow, a record of 1,024 samples every 4 s for training and for test."""
    content: Content = {"Ts": 4.0}
    for part in ("Est", "Val"):
        pump = np.clip(2.9 + multisine(1024, rng, (0.0, 0.0576), 1.5), 0.0, 7.0)
        content[f"u{part}"] = pump
        content[f"y{part}"] = tank_levels(pump, 5.0) + 0.02 * rng.standard_normal(1024)
    return content


def silverbox(rng: np.random.Generator) -> Content:
    """An arrow of growing noise, then ten multisines of one amplitude."""
    sweep = signal.sosfilt(signal.butter(6, 0.2, output="sos"), rng.standard_normal(40_475))
    arrow = 0.13 * sweep / sweep.std() * np.linspace(0.0, 2.0, 40_475)
    sines = [multisine(8_675, rng, (0.002, 0.11), 0.13) for _ in range(10)]
    force = np.concatenate([np.zeros(100), arrow, np.zeros(75), *sines, np.zeros(3_672)])
    volt = VOLT_PER_PLACE * oscillator_places(force) + 5e-5 * rng.standard_normal(len(force))
    return {"V1": force[None], "V2": volt[None]}


def wiener_hammerstein(rng: np.random.Generator) -> Content:
    """A saturation between two filters, 188,000 samples at 51.2 kHz."""
    u = signal.sosfilt(signal.butter(4, 0.4, output="sos"), rng.standard_normal(188_000))
    u /= u.std()
    y = sandwich_output(u) + 1e-4 * rng.standard_normal(len(u))
    return {"uBenchMark": u, "yBenchMark": y, "fs": 51_200.0}


def ced(rng: np.random.Generator) -> Content:
    """Belt drives: a lag and a weakly damped resonance; the pulse counter loses the sign."""
    content: Content = {}
    lag = signal.cont2discrete(([1.0], [0.4, 1.0]), 0.02)
    belt = signal.cont2discrete(([300.0], [1.0, 4.0, 300.0]), 0.02)
    for number, amplitude in ((1, 0.5), (2, 1.5)):
        level = rng.uniform(-1.0, 1.0, 50) if number == 2 else rng.choice([-1.0, 1.0], 50)
        u = amplitude * np.repeat(level, 10)
        speed = u
        for b, a, _ in (lag, belt):
            speed = signal.lfilter(b.ravel(), a, speed)
        counted = np.abs(speed) + 0.01 * rng.standard_normal(500)
        content |= {f"u1{number}": u, f"z1{number}": counted}
    return content


def pilot_plant(rng: np.random.Generator) -> Content:
    """A conical tank in mm behind a pump that lags and a valve, 3,000 and 1,500 samples."""
    content: Content = {"Ts": 5.0}
    for part, n in (("Est", 3_000), ("Val", 1_500)):
        pump = np.repeat(rng.uniform(0.25, 0.75, n // 50), 50)
        valve = np.clip(0.5 + multisine(n, rng, (0.0, 0.01), 0.12), 0.1, 0.9)
        level_mm, flow, levels = 400.0, 0.5, np.empty(n)
        for t in range(n):
            levels[t] = level_mm
            flow += 0.2 * (pump[t] - flow)
            out = 0.9 * valve[t] * np.sqrt(level_mm / 400.0)
            area = (0.3 + level_mm / 1000.0) ** 2
            level_mm = min(max(level_mm + 6.0 * (flow - out) / area, 20.0), 900.0)
        content[f"u{part}"] = np.column_stack([pump, valve])
        content[f"y{part}"] = levels + 2.0 * rng.standard_normal(n)
    return content


STAND_INS: dict[str, Callable[[np.random.Generator], Content]] = {
    "tanks": tanks,
    "silverbox": silverbox,
    "wiener_hammerstein": wiener_hammerstein,
    "ced": ced,
    "pilot_plant": pilot_plant,
}


def write(folder: Path) -> None:
    """Write a file of every plant into ``folder``; an existing file is never replaced."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, (name, make) in enumerate(STAND_INS.items()):
        path = folder / PLANTS[name][0]
        if not path.exists():
            content = make(np.random.default_rng(number)) | {"synthetic": 1.0}
            savemat(path, content, oned_as="column")
