"""The error of the charge that the ECU broadcasts: over speed and charge, and over time.

An ECU takes the charge from a table and lets its air meter correct it over some seconds (Guzzella
and Onder, Introduction to Modeling and Control of Internal Combustion Engine Systems, section 4.2).
So the error has two maps: one at the present operating point, and one at those of the last seconds.
phi is linear in both maps: one linear regression on the lagged columns of the chain gives their
values. The maps are smooth and their values about a tenth, so that neighbours decide at operating
points without samples (P-splines: Eilers and Marx, Statistical Science 11, 1996).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from training.greybox.chain import Constants, base_path, charge_mg, simulate
from training.greybox.charge.map import knots_of
from training.greybox.effects import Own, along
from training.greybox.fit import ridge
from training.greybox.fit.constants import Fitted, fit_constants
from training.greybox.fit.told import Told
from training.greybox.quantity.dynamics import lag
from training.greybox.quantity.value import Quantity, bilinear, clip, hats

SPEEDS, CHARGES = 4, 4  # knots
TIMES_S = (1.0, 2.0, 4.0, 8.0)  # over which an air meter may correct
BLOCK_S, FOLDS = 30.0, 5  # of the held-out error that chooses
ROUNDS = 2  # of maps and constants in turn
LEAST, MOST = 0.5, 2.0  # of the factor on phi
# Times the samples, on squared differences of neighbouring knots. The smallest one expects 0.1
# between neighbours, beside an error of 0.01 in phi that lasts some ten samples.
PENALTIES = (3e-6, 1e-5, 1e-4, 1e-3, 1e-2)
SMALL = 0.1  # weight of the squared values themselves, beside their differences


@dataclass(frozen=True, slots=True)
class ChargeError:
    """Relative error of the broadcast charge, linear between knots and constant beyond them."""

    speeds_rpm: FloatArray  # (a,)
    charges_mg: FloatArray  # (b,)
    now: FloatArray  # (a, b) at the present operating point
    before: FloatArray  # (a, b) at the operating points of the last ``time_s``
    time_s: float

    def air_mass_mg(self, signals: Mapping[str, Quantity], period_s: float) -> Quantity:
        """Return the corrected charge (n,) in mg per stroke, settled at the first sample.

        signals : (n,) each: engine_speed_rpm, and air_mass_mg or maf_kg_h
        """
        air, knots = charge_mg(signals), (self.speeds_rpm, self.charges_mg)
        maps = self.now, self.before
        now, before = bilinear(signals["engine_speed_rpm"], air, knots, maps)
        return air / clip(1.0 + now + lag(before, self.time_s, period_s), LEAST, MOST)

    def to_card(self) -> dict[str, Any]:
        """Return the entry for a card, see ``from_card``."""
        return {name: np.asarray(getattr(self, name)).tolist() for name in self.__slots__}

    @classmethod
    def from_card(cls, given: Mapping[str, Any]) -> "ChargeError":
        """Return the error of a card's entry; raises KeyError if a field is missing."""
        speeds, charges, now, before = (
            np.array(given[name]) for name in ("speeds_rpm", "charges_mg", "now", "before")
        )
        return cls(speeds, charges, now, before, float(given["time_s"]))


def fit_with_charge_error(
    signals: Mapping[str, FloatArray],
    phi: FloatArray,
    scored: BoolArray,
    period_s: float,
    own: Own = (),
    told: Told | None = None,
) -> tuple[Fitted, ChargeError | None]:
    """Return the constants and the charge's error with which the chain reads ``phi`` best.

    signals, phi, scored, own : see ``constants.fit_constants``
    The error is None if it does not reduce the error on held-out blocks.
    Raises RecordingError if too few samples count.
    """
    fitted = alone = fit_constants(signals, phi, scored, period_s, own=own, told=told)
    error = None
    for _ in range(ROUNDS):
        error = _error(
            fitted.constants, signals, phi=phi, scored=scored, period_s=period_s, own=own
        )
        if error is None:
            return alone, None
        right = dict(signals) | {"air_mass_mg": error.air_mass_mg(signals, period_s)}
        fitted = fit_constants(
            right,
            phi,
            scored=scored,
            period_s=period_s,
            starts=[fitted.constants],
            own=own,
            told=told,
        )
    return fitted, error


def _error(
    constants: Constants,
    signals: Mapping[str, FloatArray],
    phi: FloatArray,
    scored: BoolArray,
    period_s: float,
    own: Own,
) -> ChargeError | None:
    """Return the maps with the least held-out error; None if no maps are as good."""
    path = along(base_path(constants._replace(span=1.0), signals), own, signals, period_s)
    speed, air = signals["engine_speed_rpm"], charge_mg(signals)
    speeds, charges = knots_of(speed[scored], SPEEDS), knots_of(air[scored], CHARGES)
    cells = hats(speed, speeds)[:, :, None] * hats(air, charges)[:, None, :]
    cells = cells.reshape(len(air), -1)
    gas = 1.0 + (phi[scored] - 1.0) / constants.span
    target = gas - simulate(path, period_s)[scored]
    fold = (np.flatnonzero(scored) // round(BLOCK_S / period_s)) % FOLDS

    def carried(shares: FloatArray) -> FloatArray:
        """Return the readings (m, k) for factors at the valve that are these shares."""
        factors = (path.factor * share for share in shares.T)
        return np.column_stack(
            [simulate(replace(path, factor=each), period_s)[scored] for each in factors]
        )

    now, smooth = carried(cells), _smooth()
    best, least = None, float(target @ target)
    for time_s in TIMES_S:
        before = np.column_stack([lag(own, time_s, period_s) for own in cells.T])
        columns = np.hstack([now, carried(before)])
        found = ridge.fit(columns @ smooth, target, fold, penalties=PENALTIES, alike=True)
        left = float(((target - found.held_out) ** 2).sum())
        if left < least:
            least = left
            maps = (smooth @ found.weights).reshape(2, SPEEDS, CHARGES)
            best = ChargeError(speeds, charges, maps[0], maps[1], time_s)
    return best


def _smooth() -> FloatArray:
    """Return the matrix (k, k) from weights of equal prior size to both maps' values."""
    by_speed, by_charge = (np.diff(np.eye(n), axis=0) for n in (SPEEDS, CHARGES))
    steps = np.vstack([np.kron(by_speed, np.eye(CHARGES)), np.kron(np.eye(SPEEDS), by_charge)])
    rough = steps.T @ steps + SMALL * np.eye(SPEEDS * CHARGES)
    return np.asarray(np.kron(np.eye(2), np.linalg.inv(np.linalg.cholesky(rough)).T))
