"""Changes of training samples: fuel turned up and down, noise on the lambda controller."""

import numpy as np

from monitor.base.runs import runs
from monitor.base.types import BoolArray, FloatArray

# The controller is driven by the measured lambda. A network that sees its exact output inverts it
# and predicts the reading of a faulty sensor. So training adds noise to it, several times as large
# as the controller's movement in normal operation.
CONTROLLER = "lambda_controller"
CONTROLLER_NOISE = 0.03

# In closed loop lambda stays near 1 whatever the fuel, so recordings hardly show the effect of a
# lasting change of fuel. The balance of fuel and air shows it: at the same air, phi is proportional
# to the fuel. Training turns both up and down together, so slowly that dead time and lag hardly
# count.
FUEL = "fuel_mass_mg"
FUEL_TURN, FUEL_TURN_S = 0.10, 30.0  # most of a turn, and time from one turn to the next


def controller_noise(rows: BoolArray, seed: int) -> FloatArray:
    """Return the controller's noise (n,), 0 outside ``rows``."""
    noise = np.random.default_rng([seed, 1]).standard_normal(len(rows))
    return np.asarray(CONTROLLER_NOISE * (noise * rows))


def fuel_turns(rows: BoolArray, period_ns: int, seed: int) -> FloatArray:
    """Return (n,) factors of the fuel: 1 outside ``rows``, else within 1 +- ``FUEL_TURN``.

    They change slowly, and are 1 at the ends of every run of rows.
    """
    n, step = len(rows), max(round(FUEL_TURN_S * 1e9 / period_ns), 1)
    knots = np.random.default_rng([seed, 2]).uniform(-FUEL_TURN, FUEL_TURN, n // step + 2)
    turn = np.interp(np.arange(n) / step, np.arange(len(knots)), knots)
    for first, stop in runs(rows):
        inside = np.arange(1, stop - first + 1)
        turn[first:stop] *= np.minimum(1.0, 6.0 / step * np.minimum(inside, inside[::-1]))
    return np.asarray(np.where(rows, 1.0 + turn, 1.0))
