"""Parity of a grey-box file with effects: ONNX equals numpy, alone and in a batch."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.step import Inputs, Model
from training.greybox.chain import STOICHIOMETRIC, charge_mg, simulate
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive
from training.greybox.graph.chain_graph import Greybox
from training.greybox.graph.checks import TOLERANCE
from training.greybox.graph.effect import FUEL
from training.recordings.prediction import stacked

__all__ = ["TOLERANCE", "EffectParity", "Entry", "ParityError", "made_inputs", "parity", "reading"]

SELDOM, TOLERANCE_SELDOM = 1e-3, 1e-3  # share of samples, and by how much they may differ
MADE = 3  # drives
MADE_SAMPLES = 900  # of each, beside the memory
CUT_EVERY, CUT_SAMPLES = 150, 20
KNOT_SAMPLES = 10  # inputs run straight between places that far apart, or jump there


class ParityError(ModelError):
    """ONNX and numpy compute different values for a model with effects."""


@dataclass(frozen=True, slots=True)
class Entry:
    """An effect of a card and the signals that it reads."""

    added: ModelEffect
    reads: tuple[str, ...]

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> "Entry":
        """Return the entry of a card."""
        return cls(ModelEffect.from_card(given), tuple(given["reads"]))


@dataclass(frozen=True, slots=True)
class EffectParity:
    """Number of compared samples and differences in phi."""

    samples: int
    onnx_numpy: float  # largest, leaving out one in a thousand samples of a run
    largest: float


def reading(greybox: Greybox, entries: Sequence[Entry], u: FloatArray) -> FloatArray:
    """Return the phi (n,) of the arrays for inputs ``u`` (n, n_inputs)."""
    signals = greybox.signals(u)
    path = greybox.path(signals)
    for entry in entries:
        seen = {name: signals[name] for name in (FUEL, *entry.reads)}
        path = entry.added.effect.apply(path, entry.added.values, seen, greybox.period_s)
    return simulate(path, greybox.period_s)


def parity(
    file: Path | str, greybox: Greybox, entries: Sequence[Entry], drives: Sequence[ChainDrive] = ()
) -> EffectParity:
    """Compare free runs of a file and of its numpy form over made inputs and ``drives``.

    For an effect with two branches (a sensor slower on one edge), roundings decide the branch where
    both are nearly equal; so one in a thousand samples may differ by up to 1e-3.
    Raises ParityError if the other samples differ by more than 1e-5 in phi, or if a run in a batch
    differs from the same run alone in a single bit.
    """
    made = made_inputs(greybox, greybox.memory + MADE_SAMPLES)
    runs = [np.column_stack([drive.signals[name] for name in greybox.inputs]) for drive in drives]
    seen = [u.astype(np.float32) for u in (*made, *runs)]
    model = Model.load(file)
    alone = [_phi(model, u[None])[0] for u in seen[:MADE]]
    together = _phi(model.with_batch(len(runs)), stacked(seen[MADE:])) if runs else ()
    after = slice(greybox.memory, None)
    off = largest = 0.0
    for phi, u in zip((*alone, *together), seen, strict=True):
        own = reading(greybox, entries, u.astype(np.float64))
        away = np.sort(np.abs(phi[: len(u)] - own)[after])
        most = away[: len(away) - math.ceil(SELDOM * len(away))]
        off = max(off, float(most.max(initial=0.0)))
        largest = max(largest, float(away.max(initial=0.0)))
    if not (off <= TOLERANCE and largest <= TOLERANCE_SELDOM):
        raise ParityError(
            f"{file}: free runs of ONNX and numpy differ by {off:.2g} in phi, "
            f"tolerance {TOLERANCE:.2g}, single samples by {largest:.2g}, {TOLERANCE_SELDOM:.2g}"
        )
    if not np.array_equal(_phi(model.with_batch(MADE), np.stack(seen[:MADE])), alone):
        raise ParityError(f"{file}: runs side by side differ from the same runs alone")
    return EffectParity(sum(len(u[after]) for u in seen), off, largest)


def made_inputs(greybox: Greybox, n: int, seed: int = 8) -> FloatArray:
    """Return inputs (3, n, n_inputs) over their whole ranges, with fuel near the charge or cut."""
    rng = np.random.default_rng(seed)
    knots = np.arange(0, n + KNOT_SAMPLES, KNOT_SAMPLES)
    u = np.empty((MADE, n, len(greybox.inputs)))
    for run in range(MADE):
        for i, limits in enumerate(zip(greybox.u_low, greybox.u_high, strict=True)):
            values = rng.uniform(*limits, len(knots))
            jumps = np.repeat(values, KNOT_SAMPLES)[:n]
            u[run, :, i] = jumps if run == 0 else np.interp(np.arange(n), knots, values)
        fuel = greybox.inputs.index("fuel_mass_mg")
        mixture = rng.uniform(0.9, 1.1, len(knots)).repeat(KNOT_SAMPLES)[:n]
        charge = charge_mg(greybox.signals(u[run]))
        u[run, :, fuel] = charge / STOICHIOMETRIC / greybox.constants.gain * mixture
        u[run, np.arange(n) % CUT_EVERY >= CUT_EVERY - CUT_SAMPLES, fuel] = 0.0
    return u


def _phi(model: Model, u: Inputs) -> FloatArray:
    """Return the free runs (batch, n) in phi for inputs (batch, n, n_inputs)."""
    model.reset(u[:, 0])
    phi = np.empty(u.shape[:2])
    for k in range(u.shape[1]):
        model.step_batch(u[:, k])
        phi[:, k] = model.state[:, 0]
    return phi
