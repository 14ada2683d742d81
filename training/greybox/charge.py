"""The charge of the chain from recordings: its own map, or the error of the broadcast one.

If the ECU's air per stroke follows its air meter slowly, fuel over this air is not the mixture.
Manifold pressure and temperature tell the charge at once: density times a map of the efficiency
(speed-density; Heywood, Internal Combustion Engine Fundamentals, section 7.6). phi is linear in the
inverse of the efficiency.

Without them the broadcast charge is corrected. An ECU takes it from a table and lets its air meter
correct it over some seconds (Guzzella and Onder, Introduction to Modeling and Control of Internal
Combustion Engine Systems, section 4.2). So its error has two maps: one at the present operating
point, and one at those of the last seconds; phi is linear in both. They are smooth and their values
about a tenth, so that neighbours decide at operating points without samples (P-splines: Eilers and
Marx, Statistical Science 11, 1996).

So one linear regression on lagged columns of the chain, one per knot, gives a map's values.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Self

import numpy as np
from scipy.constants import zero_Celsius

from monitor.base.types import FloatArray
from training.greybox.chain import STOICHIOMETRIC, Constants, Path, base_path, charge_mg, simulate
from training.greybox.fit import ridge
from training.greybox.fit.constants import Fitted, Report, fit_constants, nobody, part
from training.greybox.fit.drive import BLOCK_S, FOLDS, ChainDrive, path_of
from training.greybox.quantity.dynamics import lag
from training.greybox.quantity.value import Quantity, bilinear, cells, clip, knots_over, maximum

INPUTS: Final = (  # of a map
    "fuel_mass_mg",
    "manifold_pressure_kpa",
    "manifold_temperature_degc",
    "engine_speed_rpm",
)
MAP_KNOTS, ERROR_KNOTS = (5, 6), (4, 4)
MAP_ROUNDS, ERROR_ROUNDS = 3, 2  # of map and constants in turn
TEMPERATURE_LEAST_K: Final = 200.0
MG_K_PER_KPA: Final = 1742.0  # of 0.5 l of air, by p V = m R T; for another the efficiency differs
PULL_SAMPLES: Final = 2.0  # samples' weight of the mean, which decides for a knot without samples
TIMES_S: Final = (1.0, 2.0, 4.0, 8.0)  # over which an air meter may correct
LEAST, MOST = 0.5, 2.0  # of the error's factor on phi
# Times the samples, on squared differences of neighbouring knots. The smallest one expects 0.1
# between neighbours, beside an error of 0.01 in phi that lasts some ten samples.
PENALTIES: Final = (3e-6, 1e-5, 1e-4, 1e-3, 1e-2)
SMALL: Final = 0.1  # weight of the squared values themselves, beside their differences


@dataclass(frozen=True, slots=True)
class _Stored:
    """Maps that stand in a card, field by field."""

    def to_card(self) -> dict[str, Any]:
        """Return the entry for a card, see ``from_card``."""
        return {f.name: np.asarray(getattr(self, f.name)).tolist() for f in fields(self)}

    @classmethod
    def from_card(cls, given: Mapping[str, Any]) -> Self:
        """Return what a card's entry holds; raises KeyError if a field is missing."""
        values = (given[f.name] for f in fields(cls))
        return cls(*(np.array(v) if isinstance(v, list) else float(v) for v in values))


@dataclass(frozen=True, slots=True)
class ChargeMap(_Stored):
    """Inverse efficiency over engine speed and manifold pressure, linear between the knots."""

    speeds_rpm: FloatArray  # (a,)
    pressures_kpa: FloatArray  # (b,)
    inverse_efficiency: FloatArray  # (a, b)

    def air_mass_mg(self, signals: Mapping[str, Quantity], period_s: float = 0.0) -> Quantity:
        """Return the charge (n,) in mg per stroke, at any sample period."""
        at = signals["engine_speed_rpm"], signals["manifold_pressure_kpa"]
        knots = self.speeds_rpm, self.pressures_kpa
        (inverse,) = bilinear(*at, knots, [self.inverse_efficiency])
        return dense_mg(signals) / inverse


@dataclass(frozen=True, slots=True)
class ChargeError(_Stored):
    """Relative error of the broadcast charge, linear between knots and constant beyond them."""

    speeds_rpm: FloatArray  # (a,)
    charges_mg: FloatArray  # (b,)
    now: FloatArray  # (a, b) at the present operating point
    before: FloatArray  # (a, b) at the operating points of the last ``time_s``
    time_s: float

    def air_mass_mg(self, signals: Mapping[str, Quantity], period_s: float) -> Quantity:
        """Return the corrected charge (n,) in mg per stroke, settled at the first sample."""
        air, knots = charge_mg(signals), (self.speeds_rpm, self.charges_mg)
        maps = self.now, self.before
        now, before = bilinear(signals["engine_speed_rpm"], air, knots, maps)
        return air / clip(1.0 + now + lag(before, self.time_s, period_s), LEAST, MOST)


def dense_mg(signals: Mapping[str, Quantity]) -> Quantity:
    """Return the mass (n,) in mg of 0.5 l of air in the manifold."""
    kelvin = maximum(signals["manifold_temperature_degc"] + zero_Celsius, TEMPERATURE_LEAST_K)
    return MG_K_PER_KPA * signals["manifold_pressure_kpa"] / kelvin


Charge = ChargeMap | ChargeError
KINDS: Final[Mapping[str, type[Charge]]] = {"charge_map": ChargeMap, "charge_error": ChargeError}


def has_own_charge(signals: Collection[str]) -> bool:
    """Return whether the chain makes its own charge: from density, without air per stroke."""
    return "air_mass_mg" not in signals and set(INPUTS) <= set(signals)


def with_charge(drive: ChainDrive, charge: Charge | None) -> ChainDrive:
    """Return the drive with this charge, as it is without one."""
    if charge is None:
        return drive
    air_mg = charge.air_mass_mg(drive.signals, drive.period_s)
    return replace(drive, signals={**drive.signals, "air_mass_mg": air_mg})


def fit_with_charge(drive: ChainDrive, report: Report = nobody) -> tuple[Fitted, Charge | None]:
    """Return the constants and the charge with which the chain reads a drive best.

    Both are fitted in turn. A chain that makes its own charge has a map for a gain of 1, then the
    gain with its standard error. A broadcast charge has an error, None if it does not reduce the
    error on held-out blocks. That of an air meter stays as it is.
    Raises RecordingError if too few samples count.
    """
    charge: Charge | None = _flat(drive) if has_own_charge(drive.signals) else None
    rounds = MAP_ROUNDS if charge else ERROR_ROUNDS if "air_mass_mg" in drive.signals else 0
    share = 1.0 / (1 + rounds)
    fitted = alone = fit_constants(with_charge(drive, charge), report=part(report, 0.0, share))
    for k in range(1, 1 + rounds):
        of = fitted.constants, drive
        charge = _refitted(charge, *of) if isinstance(charge, ChargeMap) else _error(*of)
        if charge is None:
            return alone, None
        own = part(report, k * share, (k + 1) * share)
        fitted = fit_constants(with_charge(drive, charge), [fitted.constants], own)
    return fitted, charge


def _flat(drive: ChainDrive) -> ChargeMap:
    """Return the map of one efficiency with which phi is right in the mean."""
    signals = {name: drive.signals[name][drive.scored] for name in INPUTS}
    both = signals["engine_speed_rpm"], signals["manifold_pressure_kpa"]
    speeds, pressures = map(knots_over, both, MAP_KNOTS)
    full = STOICHIOMETRIC * signals["fuel_mass_mg"] / dense_mg(signals)
    measured = drive.phi_measured[drive.scored]
    level = float(measured.mean() / full.mean()) if len(full) else 1.0
    return ChargeMap(speeds, pressures, np.full((len(speeds), len(pressures)), level))


def _carried(drive: ChainDrive, path: Path, shares: FloatArray) -> FloatArray:
    """Return the readings (m, k) of scored samples for these shares (n, k) of the factor."""
    paths = (replace(path, factor=path.factor * share) for share in shares.T)
    return np.column_stack([simulate(each, drive.period_s)[drive.scored] for each in paths])


def _gas(drive: ChainDrive, constants: Constants) -> FloatArray:
    """Return the phi of the gas (m,) that the sensor measured in scored samples."""
    return 1.0 + (drive.phi_measured[drive.scored] - 1.0) / constants.span


def _refitted(charge_map: ChargeMap, constants: Constants, drive: ChainDrive) -> ChargeMap:
    """Return the map with new values: ridge regression on one column of the chain per value."""
    known = dict(drive.signals) | {"air_mass_mg": dense_mg(drive.signals)}
    path = base_path(constants._replace(gain=1.0, span=1.0), known)
    at = known["engine_speed_rpm"], known["manifold_pressure_kpa"]
    shares = cells(*at, (charge_map.speeds_rpm, charge_map.pressures_kpa))
    columns, gas = _carried(drive, path, shares), _gas(drive, constants)
    mean = float(gas.mean() / columns.sum(axis=1).mean())
    gram = columns.T @ columns + PULL_SAMPLES * np.eye(columns.shape[1])
    change = np.linalg.solve(gram, columns.T @ (gas - mean * columns.sum(axis=1)))
    values = (mean + change).reshape(charge_map.inverse_efficiency.shape)
    return replace(charge_map, inverse_efficiency=values)


def _error(constants: Constants, drive: ChainDrive) -> ChargeError | None:
    """Return the maps with the least held-out error; None if no maps are as good."""
    scored, period_s = drive.scored, drive.period_s
    path = path_of(drive, constants._replace(span=1.0))
    speed, air = drive.signals["engine_speed_rpm"], charge_mg(drive.signals)
    knots = knots_over(speed[scored], ERROR_KNOTS[0]), knots_over(air[scored], ERROR_KNOTS[1])
    shares = cells(speed, air, knots)
    target = _gas(drive, constants) - simulate(path, period_s)[scored]
    fold = (np.flatnonzero(scored) // round(BLOCK_S / period_s)) % FOLDS
    now, smooth = _carried(drive, path, shares), _smooth()
    best, least = None, float(target @ target)
    for time_s in TIMES_S:
        late = np.column_stack([lag(own, time_s, period_s) for own in shares.T])
        columns = np.hstack([now, _carried(drive, path, late)])
        found = ridge.fit(columns @ smooth, target, fold, penalties=PENALTIES, alike=True)
        left = float(((target - found.held_out) ** 2).sum())
        if left < least:
            least = left
            maps = (smooth @ found.weights).reshape(2, *ERROR_KNOTS)
            best = ChargeError(*knots, maps[0], maps[1], time_s)
    return best


def _smooth() -> FloatArray:
    """Return the matrix (k, k) from weights of equal prior size to both maps' values."""
    by_speed, by_charge = (np.diff(np.eye(n), axis=0) for n in ERROR_KNOTS)
    speeds, charges = ERROR_KNOTS
    steps = np.vstack([np.kron(by_speed, np.eye(charges)), np.kron(np.eye(speeds), by_charge)])
    rough = steps.T @ steps + SMALL * np.eye(speeds * charges)
    return np.asarray(np.kron(np.eye(2), np.linalg.inv(np.linalg.cholesky(rough)).T))
