"""Free run on synthetic systems of kinds that are usual in comparisons of system identification.

None of them is a NARX: two tanks that overflow, a hardening oscillator, a nonlinearity between two
filters, hysteresis. All data are **synthetic**. ``fit`` runs with its defaults; the ARX is the best
in free run of all orders up to 20. Fits are in percent on records that neither has used, without
the first 50 samples. The oscillator's second record exceeds the amplitude of the training.

    python -m benchmarks systems [--budget MINUTES] [--seed N] [NAME ...]
"""

import argparse
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numba import njit
from scipy import signal

from training.limits.evaluation import evaluate
from training.narx.fit import fit
from training.narx.linear.arx import choose_arx
from training.narx.network import describe
from training.recordings import metrics
from training.recordings.recording import Recording

WASHOUT = 50
Records = list[tuple[np.ndarray, np.ndarray]]  # input (n,), output (n,)


def multisine(
    n: int, rng: np.random.Generator, band: tuple[float, float], rms: float
) -> np.ndarray:
    """Return n samples of random phases within ``band``, cycles per sample."""
    frequency = np.arange(n // 2 + 1) / n
    inside = (frequency >= band[0]) & (frequency <= band[1])
    spectrum = inside * np.exp(2j * np.pi * rng.random(len(frequency)))
    wave = np.fft.irfft(spectrum, n)
    return rms * wave / wave.std()


@njit
def tank_levels(pump, level):
    height = np.zeros(len(pump))
    upper, lower, step_s = level, level, 0.1
    for t in range(len(pump)):
        height[t] = lower
        for _ in range(40):
            out = 0.06 * np.sqrt(max(upper, 0.0))
            filled = upper + step_s * (0.05 * pump[t] - out)
            over = 0.6 * max(filled - 10.0, 0.0) / step_s
            lower = min(lower + step_s * (out - 0.055 * np.sqrt(max(lower, 0.0)) + over), 10.0)
            upper = min(filled, 10.0)
    return height


def tanks(seed: int) -> tuple[Records, Records]:
    """Two tanks that overflow at 10; 1,024 samples each."""

    def one(number: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(number)
        pump = np.clip(2.9 + multisine(1024, rng, (0.0, 0.0576), 1.5), 0.0, 7.0)
        return pump, tank_levels(pump, 5.0) + 0.02 * rng.standard_normal(1024)

    return [one(seed)], [one(seed + 1)]


@njit
def oscillator_places(force):
    place = np.zeros(len(force))
    x, v, step = 0.0, 0.0, 0.7 / 8
    for t in range(len(force)):
        place[t] = x
        for _ in range(8):
            v += step * (force[t] - 0.1 * v - x - 0.1 * x * x - 0.5 * x * x * x)
            x += step * v
    return place


def oscillator(seed: int) -> tuple[Records, Records]:
    """A hardening spring; the second test record is a sweep of growing amplitude."""
    rng = np.random.default_rng(seed)
    waves = [multisine(n, rng, (0.002, 0.11), 0.13) for n in (40_000, 8_192)]
    sweep = signal.sosfilt(signal.butter(6, 0.2, output="sos"), rng.standard_normal(20_000))
    waves.append(0.13 * sweep / sweep.std() * np.linspace(0.0, 2.0, 20_000))
    records = [(w, oscillator_places(w) + 2e-4 * rng.standard_normal(len(w))) for w in waves]
    return records[:1], records[1:]


def sandwich_output(u: np.ndarray) -> np.ndarray:
    """Return a saturation between two filters of third order, driven by u (n,)."""
    x = signal.sosfilt(signal.cheby1(3, 0.5, 0.172, output="sos"), u)
    z = np.where(x > 0.0, 0.3 * np.tanh(2.67 * x) + 0.1 * x, x)
    return np.asarray(signal.sosfilt(signal.cheby2(3, 40, 0.195, output="sos"), z))


def sandwich(seed: int) -> tuple[Records, Records]:
    """A saturation between two filters of third order (Wiener-Hammerstein)."""

    def one(number: int, n: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(number)
        u = signal.sosfilt(signal.butter(4, 0.4, output="sos"), rng.standard_normal(n))
        u /= u.std()
        return u, sandwich_output(u) + 1e-4 * rng.standard_normal(n)

    return [one(seed, 100_000)], [one(seed + 1, 20_000)]


@njit
def hysteresis_places(force):
    place = np.zeros(len(force))
    x, v, z, step_s = 0.0, 0.0, 0.0, 1.0 / 15_000
    for t in range(len(force)):
        place[t] = 1e3 * x
        for _ in range(20):
            a = (force[t] - 10.0 * v - 5e4 * x - z) / 2.0
            z += step_s * (5e4 * v - 1e3 * (0.8 * abs(v) * z - 1.1 * v * abs(z)))
            v += step_s * a
            x += step_s * v
    return place


def hysteresis(seed: int) -> tuple[Records, Records]:
    """A mass on a spring with hysteresis (Bouc-Wen)."""

    def one(number: int, n: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(number)
        force = multisine(n, rng, (5 / 750, 150 / 750), 50.0)
        return force, hysteresis_places(force) + 8e-3 * rng.standard_normal(n)

    return [one(seed, 40_960)], [one(seed + 1, 8_192)]


SYSTEMS: dict[str, Callable[[int], tuple[Records, Records]]] = {
    "tanks": tanks,
    "oscillator": oscillator,
    "sandwich": sandwich,
    "hysteresis": hysteresis,
}


def recording(name: str, u: np.ndarray, y: np.ndarray) -> Recording:
    """Return a record as the recording of a table at 10 Hz."""
    values = np.column_stack([u, y])
    t_s = np.arange(len(y)) * 0.1
    quality = np.zeros(values.shape, np.uint8)
    return Recording(
        path=Path(name),
        sha256="0" * 64,
        period_ns=100_000_000,
        t_s=t_s,
        names=("u", "y"),
        values=values,
        quality=quality,
    )


def main(argv: Sequence[str]) -> int:
    """Print a table, one row per plant."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(SYSTEMS), metavar="NAME")
    parser.add_argument("--budget", type=float, default=10.0, metavar="MINUTES")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(argv)
    print("| synthetic plant | samples | NARX, fit % | ARX, fit % | seconds | shape |")
    print("|---|---|---|---|---|---|")
    for name in args.names:
        train, test = SYSTEMS[name](args.seed)
        own = [recording("train", u, y) for u, y in train]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.onnx"
            result = fit(own, ["u"], "y", path, budget_minutes=args.budget)
            others = [recording(f"test{i}", u, y) for i, (u, y) in enumerate(test)]
            narx = evaluate(path, others, WASHOUT)["recordings"]
        cut = [6 * len(y) // 7 for _, y in train]
        parts = [
            [(u[:c, None], y[:c]) for c, (u, y) in zip(cut, train, strict=True)],
            [(u[c:, None], y[c:]) for c, (u, y) in zip(cut, train, strict=True)],
        ]
        arx = choose_arx(*parts)
        linear = [
            metrics.fit_percent(y[WASHOUT:], arx.simulate(u[:, None], y[:WASHOUT])[WASHOUT:])
            for u, y in test
        ]
        fits = [
            " / ".join(f"{value:.1f}" for value in values)
            for values in ([r["fit_percent"] for r in narx], linear)
        ]
        print(
            f"| {name} | {sum(len(y) for _, y in train)} | {' | '.join(fits)} | "
            f"{result.seconds:.0f} | {describe(result.network.spec)} |",
            flush=True,
        )
    return 0
