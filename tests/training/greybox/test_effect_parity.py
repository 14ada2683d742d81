"""Proof that a file with effects computes what numpy does, or no file."""

from dataclasses import replace
from pathlib import Path

import pytest

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.step import Model
from tests.helpers.gap.gap_drives import PERIOD_S
from tests.helpers.gap.gap_graphs import FIT, driven, fitted, plain, ranges_of
from training.gap.add import greybox as add_greybox
from training.gap.add.greybox import add
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive
from training.greybox.graph import chain_graph, effect_parity
from training.greybox.graph.chain_graph import Greybox
from training.greybox.graph.effect import graph_effect
from training.greybox.graph.effect_parity import TOLERANCE, ParityError


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fitted(tmp_path_factory.mktemp("base") / "base.onnx")


@pytest.mark.parametrize("wrong", ["another size", "uneven rows"])
def test_a_graph_that_computes_something_else_is_not_left_behind(
    base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: str
) -> None:
    def save(path: Path, greybox: Greybox, card: object) -> None:
        other = ModelEffect.with_values("ethanol", [0.1001])
        effects = (graph_effect(other, PERIOD_S, ()),)
        chain_graph.save(path, replace(greybox, effects=effects), card)

    def uneven(kind: object, *arguments: object) -> FloatArray:
        phi = whole(kind, *arguments)
        return phi + 1e-9 * (len(phi) > 1)

    if wrong == "another size":
        monkeypatch.setattr(add_greybox, "save", save)
    else:
        whole = effect_parity._phi
        monkeypatch.setattr(effect_parity, "_phi", uneven)
    message = "ONNX and numpy differ by" if wrong == "another size" else "runs side by side differ"
    with pytest.raises(ModelError, match=message):
        add(
            base,
            [ModelEffect.with_values("ethanol", [0.1])],
            tmp_path / "m.onnx",
            ranges=ranges_of(),
            recordings=FIT,
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("places", "by", "passes"),
    [
        (slice(500, 501), 3e-5, True),  # roundings decided which branch an effect took
        (slice(500, 501), 3e-3, False),
        (slice(500, 550), 3e-5, False),
    ],
)
def test_single_samples_may_differ_by_a_branch_of_an_effect(
    base: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    places: slice,
    by: float,
    passes: bool,
) -> None:
    whole = effect_parity._phi

    def moved(model: Model, u: FloatArray) -> FloatArray:
        phi = whole(model, u)
        phi[:, places] += by
        return phi

    monkeypatch.setattr(effect_parity, "_phi", moved)
    effect, out = ModelEffect.with_values("ethanol", [0.1]), tmp_path / "m.onnx"
    if passes:
        checks = add(base, [effect], out, ranges=ranges_of(), recordings=FIT).checks["parity"]
        assert checks["onnx_numpy"] < TOLERANCE < checks["largest"]
    else:
        with pytest.raises(ParityError, match="ONNX and numpy differ by"):
            add(base, [effect], out, ranges=ranges_of(), recordings=FIT)
        assert not out.exists()


def test_drives_of_other_lengths_are_compared_side_by_side(
    base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a long drive and a short one
    effect, out, whole = (
        ModelEffect.with_values("ethanol", [0.1]),
        tmp_path / "m.onnx",
        effect_parity._phi,
    )
    short = replace(plain(), signals={n: x[:900] for n, x in plain().signals.items()})
    given = {"ranges": ranges_of(), "recordings": FIT}

    def samples(*drives: ChainDrive) -> int:
        checks = add(base, [effect], out, **given, drives=drives).checks["parity"]
        return int(checks["samples"])

    # THEN no sample of either is left out, and none that stands behind the short one's end is asked
    made, memory = samples(), Model.load(out).card.lags
    assert samples(driven(), short) - made == len(driven()) + 900 - 2 * memory

    def wrong(places: slice) -> None:
        def moved(model: Model, u: FloatArray) -> FloatArray:
            phi = whole(model, u)
            phi[1:2, places] += 1e-2 * (u.shape[1] == len(driven()))  # the short one's
            return phi

        monkeypatch.setattr(effect_parity, "_phi", moved)

    wrong(slice(900, None))
    samples(driven(), short)
    wrong(slice(800, 900))
    with pytest.raises(ParityError, match="ONNX and numpy differ by"):
        samples(driven(), short)
