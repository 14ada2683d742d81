"""Functions of all recorded signals on the mixture, for effects that no library has.

A signal may change it in proportion, bring a mass per stroke in proportion, or change it about one
of its values. Each function is what the chain's reading becomes by it, through transport, mixing
and sensor.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from monitor.base.signals import BY_NAME, OUTPUT
from monitor.base.types import FloatArray
from training.greybox.chain import Constants, simulate
from training.greybox.effects.effect import Place
from training.greybox.fit.drive import ChainDrive, path_of

# The controller's answer to the mixture and the flags explain nothing.
LEFT_OUT: Final = (OUTPUT, "lambda_controller", "lambda_target", "fuel_mass_mg")
KNOTS: Final = 9
RANGE: Final = (0.01, 0.99)  # quantiles between which the knots are spread evenly
WITHIN_LEAST: Final = 0.3  # of a signal's spread that must lie within drives, not between them
PERCENT: Final = 100.0
STEP: Final = 1e-3  # of the mixture, for derivatives


class Function(NamedTuple):
    """One function of one signal."""

    signal: str
    kind: str  # "factor", "mass" or "about"
    at: float  # the value that counts as none, or the one it is about
    width: float  # to the next value; 1 for the others

    def of(self, x: FloatArray) -> FloatArray:
        """Return its value (n,) for a signal (n,)."""
        if self.kind == "about":
            return np.asarray(np.maximum(1.0 - np.abs(x - self.at) / self.width, 0.0))
        return np.asarray(x - self.at)


def functions_of(drives: Sequence[ChainDrive]) -> tuple[Function, ...]:
    """Return the functions of every signal of all drives that changes within them."""
    found: list[Function] = []
    for name in drives[0].signals:
        known = BY_NAME.get(name)
        left_out = name in LEFT_OUT or (known is not None and known.role == "enable")
        if left_out or any(name not in drive.signals for drive in drives):
            continue
        parts = [drive.signals[name][drive.kept] for drive in drives]
        x = np.concatenate(parts)
        within = np.sqrt(np.mean(np.concatenate([(p - p.mean()) ** 2 for p in parts])))
        if within <= WITHIN_LEAST * x.std() or within <= 1e-6 * (1.0 + np.abs(x).max()):
            continue
        low, high = np.quantile(x, RANGE).tolist()
        middle, width = float(np.median(x)), (high - low) / (KNOTS - 1)
        found += [Function(name, "factor", middle, 1.0), Function(name, "mass", middle, 1.0)]
        if width > 0.0:
            knots = np.linspace(low, high, KNOTS).tolist()
            found += [Function(name, "about", at, width) for at in knots]
    return tuple(found)


def columns(drive: ChainDrive, base: Constants, functions: Sequence[Function]) -> FloatArray:
    """Return the change of the reading per unit of every coefficient, (n, k)."""
    path = path_of(drive, base)
    plain = simulate(path, drive.period_s)
    mass = float(np.median(path.fuel_mg[drive.kept]))
    result = np.empty((len(drive), len(functions)))
    for i, function in enumerate(functions):
        x = function.of(drive.signals[function.signal])
        small = STEP / max(float(np.abs(x).max()), 1e-9)
        if function.kind == "mass":
            step = small * mass
            more = step * x * Place(path, drive.signals, drive.period_s).injecting()
            changed = replace(path, fuel_mg=path.fuel_mg + more)
        else:
            step = small * PERCENT
            changed = replace(path, factor=path.factor * (1.0 + small * x))
        result[:, i] = (simulate(changed, drive.period_s) - plain) / step
    return result
