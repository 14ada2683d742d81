"""A mix of vehicles among recordings: gain and time to the sensor, fitted drive by drive.

What an effect or the weather does to the mixture comes and goes within a drive; another vehicle, or
another fuel, stays for all of it. Each drive's own gain and its own dead time and lag together are
one step of least squares from common constants, with standard errors from blocks; then the drives
are parted where two groups differ most. Production spread is hardly told from chance: of 17
pairs of simulated vehicles, three drives each, 7 were told; of 20 times six drives of one none was.
Source of the standard errors: Liang and Zeger, Biometrika 73 (1986).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.types import FloatArray, IntArray
from training.gap.name.verdict import Naming
from training.greybox.chain import Constants
from training.greybox.fit.case import WHITE, Case, Term, errors, predict
from training.greybox.fit.drive import ChainDrive
from training.pages.numbers import NBSP, fixed, percent

DRIVES_LEAST: Final = 3
STEPS: Final = {"gain": 1e-3, "dead_time_s": 5e-3, "sensor_s": 5e-3}  # for derivatives
SUMS: Final = {"gain": (1.0, 0.0, 0.0), "dead time and lag": (0.0, 1.0, 1.0)}
# Standard deviation between drives of one simulated vehicle, beyond their standard errors.
USUAL: Final = {"gain": 0.003, "dead time and lag": 0.008}
T_LEAST: Final = {"gain": 4.0, "dead time and lag": 6.5}
CAUSES: Final = {
    "gain": f", such as the fuel, of which E10 instead of E0 is {percent(0.035, 1)}, or the sensor",
    "dead time and lag": ", such as the sensor or its place",
}
OVER_HEALTHY: Final = 1.5  # times what healthy drives differ by


@dataclass(frozen=True, slots=True)
class Chain:
    """Constants common to all drives, and effects with theirs."""

    base: Constants
    terms: tuple[Term, ...] = ()
    parameters: tuple[FloatArray, ...] = ()


@dataclass(frozen=True, slots=True)
class Partition:
    """Two groups of drives and how far apart they are in one quantity."""

    quantity: str
    low: tuple[int, ...]  # drives with the smaller values
    difference: float
    t: float


def chain_of(naming: Naming, reference: Constants) -> Chain:
    """Return the chain with the candidate that explains most of the gap, if there is one."""
    if naming.verdict == "no_gap" or not naming.trials.ranking:
        return Chain(reference)
    most = naming.answer.effects[-1] if naming.verdict == "named" else naming.trials.ranking[0]
    return Chain(most.fit.base, most.fit.terms, most.fit.parameters)


def warn(
    drives: Sequence[ChainDrive],
    chain: Chain,
    healthy: Sequence[ChainDrive] = (),
) -> list[str]:
    """Return warnings of quantities in which drives fall into two groups.

    chain : with the missing effect, which moves drives, too
    healthy : drives of one vehicle without the effect, which show the usual difference
    """
    if len(drives) < DRIVES_LEAST:
        return []
    usual = {p.quantity: p.difference for p in partitions(healthy, Chain(chain.base))}
    found = []
    for p in partitions(drives, chain):
        most = OVER_HEALTHY * usual.get(p.quantity, 0.0)
        if p.t >= T_LEAST[p.quantity] and p.difference > most:
            found.append(_sentence(p, drives, usual.get(p.quantity)))
    return found


def partitions(drives: Sequence[ChainDrive], chain: Chain) -> list[Partition]:
    """Return for every quantity the two groups of drives that differ most, by t."""
    if len(drives) < 2:
        return []
    steps = [_step(drive, chain) for drive in drives]
    found = []
    for quantity, weights in SUMS.items():
        w = np.array(weights)
        values = np.array([w @ step for step, _ in steps])
        variances = np.array([w @ cov @ w for _, cov in steps]) + USUAL[quantity] ** 2
        found.append(_part(quantity, values, 1.0 / variances))
    return found


def _part(quantity: str, values: FloatArray, weights: FloatArray) -> Partition:
    order = np.argsort(values)
    x, w = values[order], weights[order]
    best = Partition(quantity, (), 0.0, 0.0)
    for k in range(1, len(x)):
        difference = float(np.average(x[k:], weights=w[k:]) - np.average(x[:k], weights=w[:k]))
        t = difference / float(np.sqrt(1.0 / w[:k].sum() + 1.0 / w[k:].sum()))
        if t > best.t:
            best = Partition(quantity, tuple(sorted(order[:k].tolist())), difference, t)
    return best


def _step(drive: ChainDrive, chain: Chain) -> tuple[FloatArray, FloatArray]:
    """Return a drive's constants less the chain's (3,), and their covariance."""
    case = Case((drive,), (np.zeros(len(drive)),), WHITE)

    def error(base: Constants) -> FloatArray:
        return errors(case, predict(case, base, chain.terms, chain.parameters))

    at = error(chain.base)
    columns = []
    for name, size in STEPS.items():
        moved = chain.base._replace(**{name: getattr(chain.base, name) + size})
        columns.append((error(moved) - at) / size)
    x = np.column_stack(columns)
    inverse = np.linalg.pinv(x.T @ x)
    step = -inverse @ (x.T @ at)
    slopes = _by_block(x * (at + x @ step)[:, np.newaxis], case.blocks)
    return step, inverse @ (slopes.T @ slopes) @ inverse


def _by_block(rows: FloatArray, block: IntArray) -> FloatArray:
    """Return the sums (b, k) of rows (m, k) over each block."""
    sums = np.zeros((int(block.max()) + 1, rows.shape[1]))
    np.add.at(sums, block, rows)
    return sums


def _sentence(p: Partition, drives: Sequence[ChainDrive], usual: float | None) -> str:
    few = (
        p.low
        if 2 * len(p.low) <= len(drives)
        else [i for i in range(len(drives)) if i not in p.low]
    )
    side = "below" if few is p.low else "above"
    names = ", ".join(drives[i].name for i in few)

    def differ(value: float) -> str:
        return percent(value, 1) if p.quantity == "gain" else f"{fixed(value, 3)}{NBSP}s"

    healthy = "" if usual is None else f" (healthy ones differ by {differ(usual)})"
    return (
        f"{names}: {p.quantity} {differ(p.difference)} {side} that of the other "
        f"recordings{healthy}: they are of different vehicles, or something changed between them"
        f"{CAUSES[p.quantity]}"
    )
