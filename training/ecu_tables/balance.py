"""The steady balance of the pulse widths: flow and dead time of the injectors without dynamics.

Over seconds of steady air the measured fuel is the injected fuel, whatever wall, pipe and sensor
do, so the level of the mixture tells flow and dead time. The fit of the moves takes them from here:
an air estimate that errs in time weakens every move, and moves alone then tell a smaller injector.
"""

from typing import Final

import numpy as np
from scipy.linalg import block_diag
from scipy.ndimage import uniform_filter1d

from monitor.base.counts import plain
from monitor.base.types import FloatArray, IntArray
from training.ecu_tables.config import defaults
from training.ecu_tables.parameters import FUEL, Balance, Parameters, Vector
from training.ecu_tables.prediction import air_mg, injected_mg
from training.ecu_tables.signals import PULSE, TableDrive
from training.greybox.chain import STOICHIOMETRIC
from training.greybox.fit.drive import block_numbers

STEADY_S: Final = 2.0  # over which mixture and command are averaged
AIR_MOVE: Final = 0.1  # logarithm of the air within a second
BLOCK_S: Final = 5.0  # after which the error of a steady mixture is another one
OUTLIER: Final = 3.0  # sigma
SIGMA_LEAST: Final = 0.005
STEPS: Final = 12
MOST: Final = 0.3  # of one step
STEP: Final = 1e-5
WIDENING: Final = 1.8  # of the deviations: with it, 90 % of 20 simulated cars are within bounds


def _steady(drive: TableDrive, window: int) -> IntArray:
    """Return the steady samples of a drive, as averaged over a window of samples."""
    known = np.convolve(drive.usable, np.ones(drive.every))[: len(drive)] > 0.0  # until updated
    steady = known & (drive.air_move < AIR_MOVE) & (drive.commanded > 0.0)
    return np.flatnonzero(uniform_filter1d(steady.astype(float), window) > 1.0 - 1e-9)


def _excess(v: Vector, drive: TableDrive, window: int) -> FloatArray:
    """Return the logarithm of the measured over the injected fuel (n,)."""
    fuel = (drive.phi * air_mg(v, drive) / STOICHIOMETRIC, injected_mg(v, drive))
    measured, injected = (np.maximum(uniform_filter1d(f, window), 1e-3) for f in fuel)
    return np.asarray(np.log(measured / injected))


def balance(p: Parameters) -> Balance:
    """Return flow and dead time by robust least squares, with the covariance of whole blocks.

    The error of the air over speed and load is estimated with them, so it is in the covariance.
    """
    drives = p.subject.drives
    period_s = drives[0].period_s
    window = max(round(STEADY_S / period_s), 1)
    steady = [_steady(d, window) for d in drives]
    fuel = slice(len(FUEL))
    which = [fuel, p.at["gain"]]
    mean = np.concatenate([p.mean()[w] for w in which])
    prior = np.asarray(block_diag(*(p.precision()[w, w] for w in which)))

    def excess(x: FloatArray) -> FloatArray:
        full = p.mean()
        full[fuel] = x[fuel]
        of = [_excess(Vector(p, full), d, window)[at] for d, at in zip(drives, steady, strict=True)]
        return np.concatenate(of) - gain @ x[len(FUEL) :]

    pairs = zip(drives, steady, strict=True)
    gain = np.concatenate([p.grid.shares(d.rpm[at], d.load[at]) for d, at in pairs])
    block = block_numbers(steady, round(BLOCK_S / period_s))
    n_blocks = int(block.max(initial=-1)) + 1
    if n_blocks <= len(FUEL):
        return Balance(mean[fuel], np.asarray(np.linalg.inv(prior[fuel, fuel]), float), 0.0)
    x = mean.copy()
    x[0] += np.median(excess(mean))
    for _ in range(STEPS):
        e = excess(x)
        sigma = 1.4826 * float(np.median(np.abs(e))) + SIGMA_LEAST
        moved = [excess(x + STEP * unit) for unit in np.eye(len(mean))[: len(FUEL)]]
        slopes = np.concatenate([(e - np.stack(moved)) / STEP, gain.T])
        weighted = slopes / (1.0 + (e / (OUTLIER * sigma)) ** 2) / sigma**2 / window
        normal = weighted @ slopes.T + prior
        step = np.linalg.solve(normal, weighted @ e - prior @ (x - mean))
        x = x + np.clip(step, -MOST, MOST)
    sums = np.stack([np.bincount(block, own) for own in weighted * e])
    few = n_blocks / (n_blocks - len(FUEL))
    inverse = np.linalg.inv(normal)
    covariance = WIDENING**2 * inverse @ (few * sums @ sums.T + prior) @ inverse
    return Balance(x[fuel], np.asarray(covariance[fuel, fuel], float), len(block) * period_s)


def balance_text(p: Parameters) -> str:
    """Return dead time, and flow of absolute air, with 90 % intervals; "" if none is known."""
    fitted = p.fuel
    if fitted is None or not fitted.seconds or PULSE not in p.subject.known:
        return ""
    half = defaults().z90 * np.sqrt(np.diag(fitted.covariance))
    both = [np.exp(fitted.mean + sign * half) for sign in (0.0, -1.0, 1.0)]
    flow, dead = ([plain(v[k], 3) for v in both] for k in (0, 1))
    told = f"flow {flow[0]} mg/ms ({flow[1]} to {flow[2]}), " if p.subject.absolute_air else ""
    told += f"dead time {dead[0]} ms ({dead[1]} to {dead[2]}) at 14 V"
    return f"{told}, from {fitted.seconds:.0f} steady seconds"
