"""The chain's own charge: density in the manifold times a map of the efficiency, from recordings.

If the ECU's air per stroke follows its air meter slowly, fuel over this air is not the mixture.
Manifold pressure and temperature tell the charge at once (speed-density; Heywood, Internal
Combustion Engine Fundamentals, section 7.6). phi is linear in the inverse of the efficiency, so
the map's values come from one linear regression on the lagged columns of the chain.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from monitor.base.types import BoolArray, FloatArray
from training.greybox.chain import STOICHIOMETRIC, Constants, base_path, simulate
from training.greybox.fit.constants import Fitted, fit_constants
from training.greybox.fit.told import Told
from training.greybox.quantity.value import Quantity, bilinear, hats, maximum

INPUTS = ("fuel_mass_mg", "manifold_pressure_kpa", "manifold_temperature_degc", "engine_speed_rpm")
SPEEDS, PRESSURES = 5, 6  # knots
RANGE = (0.005, 0.995)  # quantiles between which the knots are spread evenly
ROUNDS = 3  # of map and constants in turn
KELVIN = 273.15
TEMPERATURE_LEAST_K = 200.0
MG_K_PER_KPA = 1742.0  # of 0.5 l of air, by p V = m R T; for another volume the efficiency differs
PULL_SAMPLES = 2.0  # samples' weight of the mean, which decides for a knot without samples


@dataclass(frozen=True, slots=True)
class ChargeMap:
    """Inverse efficiency over engine speed and manifold pressure, linear between the knots."""

    speeds_rpm: FloatArray  # (a,)
    pressures_kpa: FloatArray  # (b,)
    inverse_efficiency: FloatArray  # (a, b)

    def air_mass_mg(self, signals: Mapping[str, Quantity]) -> Quantity:
        """Return the charge (n,) in mg per stroke."""
        at = signals["engine_speed_rpm"], signals["manifold_pressure_kpa"]
        knots = self.speeds_rpm, self.pressures_kpa
        (inverse,) = bilinear(*at, knots, [self.inverse_efficiency])
        return dense_mg(signals) / inverse

    def to_card(self) -> dict[str, Any]:
        """Return the entry for a card, see ``from_card``."""
        return {name: np.asarray(getattr(self, name)).tolist() for name in self.__slots__}

    @classmethod
    def from_card(cls, given: Mapping[str, Any]) -> "ChargeMap":
        """Return the map of a card's entry; raises KeyError if a field is missing."""
        return cls(*(np.array(given[name]) for name in cls.__slots__))


def dense_mg(signals: Mapping[str, Quantity]) -> Quantity:
    """Return the mass (n,) in mg of 0.5 l of air in the manifold."""
    kelvin = maximum(signals["manifold_temperature_degc"] + KELVIN, TEMPERATURE_LEAST_K)
    return MG_K_PER_KPA * signals["manifold_pressure_kpa"] / kelvin


def fit_with_charge(
    signals: Mapping[str, FloatArray],
    phi: FloatArray,
    scored: BoolArray,
    period_s: float,
    told: Told | None = None,
) -> tuple[Fitted, ChargeMap]:
    """Return the constants and the charge map with which the chain reads ``phi`` best.

    signals : (n,) each of INPUTS; phi : (n,) measured; scored : (n,) bool, samples that count
    Both are fitted in turn: the map for a gain of 1, then the gain with its standard error.
    Raises RecordingError if too few samples count.
    """
    charge_map = _flat(signals, phi, scored)
    known = dict(signals) | {"air_mass_mg": charge_map.air_mass_mg(signals)}
    fitted = fit_constants(known, phi, scored, period_s, told=told)
    for _ in range(ROUNDS):
        charge_map = _refitted(
            charge_map, fitted.constants, signals=signals, phi=phi, scored=scored, period_s=period_s
        )
        known = dict(signals) | {"air_mass_mg": charge_map.air_mass_mg(signals)}
        fitted = fit_constants(known, phi, scored, period_s, [fitted.constants], told=told)
    return fitted, charge_map


def _flat(signals: Mapping[str, FloatArray], phi: FloatArray, scored: BoolArray) -> ChargeMap:
    speeds, pressures = (
        knots_of(signals[name][scored], n)
        for name, n in (("engine_speed_rpm", SPEEDS), ("manifold_pressure_kpa", PRESSURES))
    )
    full = STOICHIOMETRIC * signals["fuel_mass_mg"][scored] / dense_mg(signals)[scored]
    level = float(phi[scored].mean() / full.mean()) if scored.any() else 1.0
    return ChargeMap(speeds, pressures, np.full((len(speeds), len(pressures)), level))


def knots_of(values: FloatArray, n: int) -> FloatArray:
    """Return ``n`` knots, evenly spaced over nearly all values."""
    if not len(values):
        return np.arange(2.0)
    low, high = np.quantile(values, RANGE)
    return np.linspace(low, max(high, low + 1.0), n)


def _refitted(
    charge_map: ChargeMap,
    constants: Constants,
    signals: Mapping[str, FloatArray],
    phi: FloatArray,
    scored: BoolArray,
    period_s: float,
) -> ChargeMap:
    """Return the map with new values: ridge regression on one column of the chain per value."""
    path = base_path(
        constants._replace(gain=1.0, span=1.0), dict(signals) | {"air_mass_mg": dense_mg(signals)}
    )
    by_speed = hats(signals["engine_speed_rpm"], charge_map.speeds_rpm)
    by_pressure = hats(signals["manifold_pressure_kpa"], charge_map.pressures_kpa)
    columns = np.column_stack(
        [
            simulate(replace(path, factor=a * b), period_s)[scored]
            for a in by_speed.T
            for b in by_pressure.T
        ]
    )
    gas = 1.0 + (phi[scored] - 1.0) / constants.span
    mean = float(gas.mean() / columns.sum(axis=1).mean())
    gram = columns.T @ columns + PULL_SAMPLES * np.eye(columns.shape[1])
    change = np.linalg.solve(gram, columns.T @ (gas - mean * columns.sum(axis=1)))
    values = (mean + change).reshape(charge_map.inverse_efficiency.shape)
    return replace(charge_map, inverse_efficiency=values)
