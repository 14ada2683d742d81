"""Healthy behaviour: the base's error on healthy drives, which corrects it on new drives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from monitor.base.types import BoolArray, FloatArray, IntArray
from training.greybox.chain import Constants, simulate
from training.greybox.charge import ChargeError, fit_with_charge, with_charge
from training.greybox.effects import LIBRARY, Effect
from training.greybox.effects.model_effect import Effects
from training.greybox.fit import ridge
from training.greybox.fit.case import WHITE, Case, Term, reading
from training.greybox.fit.drive import BLOCK_S, FOLDS, ChainDrive, joined, path_of, phi_of
from training.greybox.fit.joint import JointFit, fit
from training.greybox.fit.ridge import Ridge
from training.greybox.fit.sensor_faults import FAULTS
from training.greybox.fit.vehicle_effects import own_of, with_more
from training.greybox.quantity.dynamics import ramp_lag
from training.healthy.config import CONFIG as LIMITS
from training.healthy.features import features
from training.healthy.operating_points import Visited

SKEW_S = 0.01
OWN = ("delay_flow", "mix_flow")  # that every exhaust has
SKEW = "skew"  # what a charge that is late changes, per second
COOLANT = "coolant "  # functions of ``features`` in the order of temperature
CONSTANT = "constant"  # among the functions of ``features``
COLUMN_SPREAD = {
    CONSTANT: LIMITS.gain_spread_phi,
    "above": LIMITS.span_spread,
    "rate": LIMITS.sensor_phase_spread_s,
    SKEW: LIMITS.charge_phase_spread_s,
}


@dataclass(frozen=True, slots=True)
class Healthy:
    """Base constants of healthy drives, the error beside them, and the spread between drives.

    A chain whose dead time and mixing do not follow the exhaust's flow is too sharp at low flow,
    and every fault or effect of the response fits it badly. So the healthy vehicle's volumes are
    part of its base, and what is named is a change of them.
    """

    base: Constants  # beside ``own``
    plain: Constants  # of the chain alone, which a grey-box model can hold
    own: Effects  # effects that the vehicle has when healthy
    names: tuple[str, ...]  # of the columns
    ridge: Ridge
    spread: FloatArray  # (k,) of the columns' coefficients over drives
    visited: Visited
    doubt: FloatArray  # (k, q) root of the weights' covariance; (k, 0) where ``surplus`` says it
    surplus: Mapping[str, float] = field(default_factory=dict)  # see ``yardstick``
    charge: ChargeError | None = None  # of drives with the air per stroke as broadcast
    rmse_usual: float | None = None  # phi, of healthy drives judged by others

    def columns(self, drive: ChainDrive) -> dict[str, FloatArray]:
        """Return all columns of ``drive``, name → (n,)."""
        return columns(self.with_own(drive), self.base)

    def table(self, made: Mapping[str, FloatArray]) -> FloatArray:
        """Return the columns of a drive in the order of the names, (n, k); 0 for a missing one."""
        nothing = np.zeros(len(made[CONSTANT]))
        return np.column_stack([made.get(name, nothing) for name in self.names])

    def with_own(self, drive: ChainDrive) -> ChainDrive:
        """Return the drive with the healthy vehicle's effects as part of the base."""
        return replace(charged(drive, self.charge), own=self.own)

    def known_of(self, drive: ChainDrive) -> ChainDrive:
        """Return the drive with those samples scored where healthy drives have been."""
        own = self.with_own(drive)
        return replace(own, scored=own.scored & self.visited.on(own))

    def learned(self, made: Mapping[str, FloatArray]) -> FloatArray:
        """Return the chain's expected error, (n,) in phi, from a drive's columns."""
        return self.ridge.predict(self.table(made))

    def correction(self, drive: ChainDrive) -> FloatArray:
        """Return what a healthy vehicle and the model's effects add to the chain, (n,) in phi."""
        return np.asarray(self.learned(self.columns(drive)) + drive.moved_phi)


def learn(drives: Sequence[ChainDrive], start: Constants, like: Healthy | None = None) -> Healthy:
    """Return the healthy behaviour in ``drives``.

    like : of the same vehicle, whose own effects and error of the charge are taken over
    """
    charge = like.charge if like else _charge_error(drives)
    drives = [charged(replace(drive, own=()), charge) for drive in drives]
    plain, base, own = _chain(drives, start, like)
    drives = [replace(drive, own=own) for drive in drives]
    tables = [columns(drive, base) for drive in drives]
    names, raw = common(tables)
    target = [np.asarray(d.phi_measured - phi_of(d, base) - d.moved_phi) for d in drives]
    kept = [d.kept for d in drives]
    stacked = np.concatenate([x[k] for x, k in zip(raw, kept, strict=True)])
    fold = np.concatenate([_fold(d, i) for i, d in enumerate(drives)])
    y = np.concatenate([e[k] for e, k in zip(target, kept, strict=True)])
    ar, sigma = noise(kept, y - ridge.fit(stacked, y, fold).held_out)
    coolant = [name.startswith(COOLANT) for name in names]
    limits = (stacked.min(axis=0), np.where(coolant, 1.0, stacked.max(axis=0)))
    x = [white(r, ar)[k] / sigma for r, k in zip(raw, kept, strict=True)]
    e = [white(t, ar)[k] / sigma for t, k in zip(target, kept, strict=True)]
    x_all, e_all = np.concatenate(x), np.concatenate(e)
    prior = _smooth(names)
    found = ridge.fit(x_all, e_all, fold, limits, prior=prior)
    whole = _no_worse(stacked, y, found, (x_all, e_all, fold), prior)
    scale = np.maximum(np.sqrt((stacked**2).mean(axis=0)), LIMITS.column_size_min)
    group = np.array([int(name.endswith(")")) for name in names])  # signatures apart
    usual = np.array([LIMITS.function_spread_phi, LIMITS.signature_spread_phi])
    spread = usual[group] / scale
    for column, value in COLUMN_SPREAD.items():
        if column in names:
            spread[names.index(column)] = value
    return Healthy(
        base=base,
        plain=plain,
        own=own,
        names=names,
        ridge=whole,
        spread=spread,
        visited=Visited.of(drives),
        doubt=whole.doubt,
        charge=charge,
    )


def _smooth(names: Sequence[str]) -> FloatArray:
    """Return the precision of the columns' weights (k, k): coolant's neighbours are much alike.

    Of a temperature that no drive came near, warm engines' small changes say no more than a slope.
    Carried on it was wrong by 0.04 in phi.
    Source: Eilers and Marx, Flexible smoothing with B-splines and penalties, 1996.
    """
    coolants = np.array([name.startswith(COOLANT) for name in names], dtype=bool)
    steps = np.diff(np.eye(len(names))[coolants], axis=0)
    return np.asarray(steps.T @ steps / LIMITS.coolant_step_phi**2)


def _no_worse(
    plain: FloatArray,
    y: FloatArray,
    found: Ridge,
    white: tuple[FloatArray, FloatArray, IntArray],
    prior: FloatArray,
) -> Ridge:
    """Return the ridge with a penalty large enough that plain errors do not grow by it.

    plain, y : columns (m, k) and errors (m,) as they are; white : both whitened, and the folds
    Smooth functions, as the time after a fuel cut, hardly show in whitened errors.
    """
    for penalty in LIMITS.correction_penalties:
        if ((y - plain @ found.weights) ** 2).sum() <= (y**2).sum():
            break
        if penalty > found.penalty:
            limits = (found.low, found.high)
            found = ridge.fit(*white, limits, penalties=[penalty], prior=prior)
    return found


def as_shown(drives: Sequence[ChainDrive], start: Constants) -> Sequence[ChainDrive]:
    """Return healthy drives, without the effects in the model those that do not show them.

    Whoever extends a model and looks at it again may give the healthy drives from before the effect
    was there, or new ones, or both.
    """
    if not any(np.any(drive.moved_phi) for drive in drives):
        return drives
    without = [replace(drive, moved_phi=0.0) for drive in drives]
    fits = [_fit(each, [start, Constants()]) for each in (drives, without)]
    base = min(fits, key=lambda each: each.cost).base

    def cost(drive: ChainDrive) -> float:
        return fit(replace(_case([drive]), fixed=base), (), [base]).cost

    return [min(pair, key=cost) for pair in zip(drives, without, strict=True)]


def charged(drive: ChainDrive, error: ChargeError | None) -> ChainDrive:
    """Return the drive with the right air per stroke, if it is still as broadcast."""
    if error is None or drive.charged:
        return drive
    return replace(with_charge(drive, error), charged=True, meter_s=error.time_s)


def _charge_error(drives: Sequence[ChainDrive]) -> ChargeError | None:
    """Return by how much the broadcast charge is wrong, None where it is not, or right already."""
    if any(drive.charged for drive in drives):
        return None
    whole = joined([replace(d, phi_measured=d.phi_measured - d.moved_phi) for d in drives])
    _, error = fit_with_charge(replace(whole, own=own_of(whole)))
    return error if isinstance(error, ChargeError) else None


def _chain(
    drives: Sequence[ChainDrive], start: Constants, like: Healthy | None
) -> tuple[Constants, Constants, Effects]:
    """Return constants of the chain alone, constants beside the vehicle's effects, the effects."""
    if like is not None:
        found = _fit([like.with_own(drive) for drive in drives], [like.base])
        return like.plain, found.base, like.own
    case = _case(drives)
    plain = fit(case, (), [start, Constants()])
    # Beside volumes that imitate them already walls would not be found.
    effects, found = with_more(case, plain)
    for effect in (LIBRARY[name] for name in OWN):
        if all(set(effect.needs) <= set(drive.signals) for drive in drives):
            effects = [*effects, effect]
            found = fit(case, effects, [found])
    return plain.base, found.base, found.effects


def _fit(drives: Sequence[ChainDrive], starts: Sequence[Constants]) -> JointFit:
    return fit(_case(drives), (), starts)


def _case(drives: Sequence[ChainDrive]) -> Case:
    moved = tuple(np.zeros(len(drive)) + drive.moved_phi for drive in drives)
    return Case(tuple(drives), moved, WHITE)


def white(series: FloatArray, ar: tuple[float, float]) -> FloatArray:
    """Return series (n,) or (n, k) through the noise's inverse."""
    left = series.copy()
    left[1:] -= ar[0] * series[:-1]
    left[2:] -= ar[1] * series[:-2]
    return left


def noise(kept: Sequence[BoolArray], rest: FloatArray) -> tuple[tuple[float, float], float]:
    """Return AR(2) and the whitened spread of ``rest`` (m,), kept samples of all drives."""
    rows, at = [], 0
    for k in kept:
        series = np.full(len(k), np.nan)
        series[k] = rest[at : at + int(k.sum())]
        at += int(k.sum())
        rows.append(np.column_stack([series[2:], series[1:-1], series[:-2]]))
    table = np.concatenate(rows)
    table = table[np.isfinite(table).all(axis=1)]
    a, b = np.linalg.lstsq(table[:, 1:], table[:, 0], rcond=None)[0]
    left = table[:, 0] - table[:, 1] * a - table[:, 2] * b
    return (float(a), float(b)), float(np.quantile(np.abs(left), 0.683))


def common(made: Sequence[Mapping[str, FloatArray]]) -> tuple[tuple[str, ...], list[FloatArray]]:
    """Return the columns that all drives have: their names, and (n, k) per drive."""
    names = tuple(name for name in made[0] if all(name in each for each in made))
    return names, [np.column_stack([each[name] for name in names]) for each in made]


def columns(drive: ChainDrive, base: Constants) -> dict[str, FloatArray]:
    """Return the columns of a drive: plain functions and every effect's signature."""
    path, phi = path_of(drive, base), phi_of(drive, base)
    made = features(drive, path, phi)
    late = replace(path, air_mg=ramp_lag(path.air_mg, SKEW_S, drive.period_s))  # than the fuel
    made[SKEW] = (simulate(late, drive.period_s) - phi) / SKEW_S
    terms: tuple[Term, ...] = (*drive.effects, *FAULTS)
    for term in terms:
        if isinstance(term, Effect) and not set(term.needs) <= set(drive.signals):
            continue
        for start in product(*(p.start for p in term.parameters)):
            changed = reading(drive, base, (term,), (np.array(start),))
            made[f"{term.name} {start}"] = (changed - phi) / abs(start[0])
    return made


def _fold(drive: ChainDrive, number: int) -> IntArray:
    block = np.arange(len(drive)) // round(BLOCK_S / drive.period_s) + number
    return np.asarray(block % FOLDS, dtype=np.int64)[drive.kept]
