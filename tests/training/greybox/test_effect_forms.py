"""The equation of every effect in the library, on arrays and in a graph."""

from dataclasses import replace

import numpy as np
import pytest
from onnxruntime import InferenceSession

from monitor.base.types import FloatArray
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from tests.helpers.gap.gap_graphs import driven, plain, ranges_of
from training.greybox.chain import Constants, Path, base_path, inputs_of
from training.greybox.effects import LIBRARY, Effect
from training.greybox.effects.model_effect import FUEL, ModelEffect
from training.greybox.graph.chain_graph import Greybox, build

CONSTANTS = Constants(
    gain=1.01, dead_time_s=0.17, dead_time_revolutions=1.6, mixing_s=0.05, sensor_s=0.12, span=0.96
)
TOLERANCE = 5e-6  # phi, of float32
over_library = pytest.mark.parametrize("effect", LIBRARY.values(), ids=LIBRARY)


def values_of(effect: Effect) -> list[list[float]]:
    """Return a start, and places well inside the bounds on both sides."""
    shares = (0.03, 0.6)
    inside = [[p.low + s * (p.high - p.low) for p in effect.parameters] for s in shares]
    return [[p.start[0] for p in effect.parameters], *inside]


def chain_with(effect: ModelEffect, reads: tuple[str, ...]) -> Greybox:
    """Return a chain with the effect, over the ranges of both drives."""
    inputs = tuple(dict.fromkeys((*inputs_of(plain().signals), *reads)))
    limits, effects = ranges_of(*inputs), (replace(effect, reads=reads),)
    return Greybox(constants=CONSTANTS, limits=limits, period_s=PERIOD_S, effects=effects)


def run(greybox: Greybox, u: FloatArray) -> FloatArray:
    """Return the free runs (batch, n) of the graph in phi, from a state of zeros."""
    session = InferenceSession(build(greybox).SerializeToString())
    state = np.zeros((len(u), greybox.state_layout.size), dtype=np.float32)
    phi = np.empty(u.shape[:2])
    for k in range(u.shape[1]):
        _, state = session.run(None, {"u": u[:, k], "state": state})
        phi[:, k] = state[:, 0]
    return phi


@over_library
def test_the_arrays_and_the_graph_of_an_effect_agree(effect: Effect) -> None:
    reads = effect.signals_of(plain().signals)
    for values in values_of(effect):
        # GIVEN a chain with the effect, and two drives in pieces, of a simulated vehicle and of
        # formulas
        added = ModelEffect.with_values(effect.name, values)
        greybox = chain_with(added, reads)
        n = greybox.memory + 600
        u = np.stack(
            [
                np.column_stack([drive.signals[name][first : first + n] for name in greybox.inputs])
                for drive in (driven(), plain())
                for first in range(0, len(drive) - n + 1, 600)
            ]
        ).astype(np.float32)
        # WHEN the graph runs over all of them side by side
        by_graph = run(greybox, u)
        # THEN it reads what the arrays read from the first sample on, and not what the plain chain
        moved = 0.0
        for phi, inputs in zip(by_graph, u.astype(np.float64), strict=True):
            by_arrays, plainly = (
                c.reading(inputs) for c in (greybox, replace(greybox, effects=()))
            )
            assert np.abs(phi - by_arrays).max() < TOLERANCE
            moved = max(moved, np.abs(by_arrays - plainly).max())
        assert moved > 1e-3


@over_library
def test_an_effect_reads_the_signals_it_says(effect: Effect) -> None:
    signals = plain_signals()
    path = base_path(CONSTANTS, signals)
    start = np.array([p.start[0] for p in effect.parameters])
    few = {name: signals[name] for name in (FUEL, *effect.signals_of(signals))}
    by_all, by_few = (effect.apply(path, start, seen, PERIOD_S) for seen in (signals, few))
    for name in Path.__slots__:
        np.testing.assert_array_equal(getattr(by_all, name), getattr(by_few, name))
