"""An effect of no library becomes a formula of one signal, which a model can hold."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from tests.training.gap.name.test_description import BASE, Change, made
from tests.training.greybox.test_effect_forms import (
    test_the_arrays_and_the_graph_of_an_effect_agree as graph_agrees,
)
from training.gap.name.base_state import base_state
from training.gap.name.formula import formula_of
from training.gap.name.scoring import Score
from training.gap.name.verdict import Candidate
from training.greybox.chain import Path
from training.greybox.effects.empirical import effect_of, formula, name_of


def found(change: Change) -> tuple[Candidate, ...]:
    return formula_of(base_state([made(change, seed) for seed in (1, 2)], None, BASE))


def warm_intake(path: Path, signals: dict[str, FloatArray]) -> Path:
    more = -0.0088 * (signals["manifold_temperature_degc"] - 30.0)
    return replace(path, factor=path.factor * (1.0 + more))


def test_a_share_per_degree_is_found_with_its_size() -> None:
    (term,) = found(warm_intake)
    assert term.kind == "empirical"
    _, signal, form, _, width = term.name.split(":")
    assert (signal, form) == ("manifold_temperature_degc", "factor")
    assert term.parameters["size"] / float(width) == pytest.approx(-0.88, rel=0.05)


def test_where_no_form_gains_on_held_out_blocks_there_is_no_formula(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # GIVEN forms that all lose on blocks that their fit did not see
    monkeypatch.setattr("training.gap.name.scoring.score", lambda *_: Score(-1.0, 0.0))
    assert found(warm_intake) == ()


@pytest.mark.parametrize("form", ["mass", "slow", "curve"])
def test_arrays_and_graph_of_a_formula_agree(form: str) -> None:
    graph_agrees(effect_of(name_of("manifold_pressure_kpa", form, 70.0, 40.0)))


def test_a_formula_reads_as_one() -> None:
    name = name_of("rail_pressure_mpa", "slow", 10.0, 4.0)
    assert formula(name, [2.0, 1.5]) == (
        "mixture × (1 + 0.5 % per unit of (rail_pressure_mpa behind a lag of 1.5 s - 10))"
    )


@pytest.mark.parametrize("name", ["empirical:x", "empirical:x:cube:1:1", "empirical:x:mass:a:1"])
def test_a_name_that_says_no_formula_is_refused(name: str) -> None:
    with pytest.raises(ModelError, match="no empirical effect"):
        effect_of(name)


def test_a_curve_is_constant_beyond_its_knots() -> None:
    path, signals = BASE_PATH
    effect = effect_of(name_of("manifold_pressure_kpa", "curve", 70.0, 10.0))
    changed = effect.apply(path, np.array([1.0, 0.0, 0.0, 0.0, 3.0]), signals, 0.1)
    ratio = changed.factor / path.factor
    np.testing.assert_allclose(ratio[signals["manifold_pressure_kpa"] > 80.0], 1.03)
    np.testing.assert_allclose(ratio[signals["manifold_pressure_kpa"] < 60.0], 1.01)


def _base_path() -> tuple[Path, dict[str, FloatArray]]:
    from tests.helpers.gap_drives import plain_signals
    from training.greybox.chain import base_path

    signals = plain_signals(n=600)
    return base_path(BASE, signals), signals


BASE_PATH = _base_path()
