"""Damaged and hostile model files: refused in one line, whichever bit has changed."""

import time
from pathlib import Path

import onnx
import pytest

from benchmarks.damage.fuzz_models import card_of, hostile, outcome, with_card_text
from monitor.base.errors import ModelError
from monitor.cli import main
from monitor.model import model_file
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.logs.replays import replay_log
from training.narx.export import update_card

GOOD = shipped_model().read_bytes()
HOSTILE = dict(hostile(GOOD))


def test_every_bit_of_weights_and_limits_counts(tmp_path: Path) -> None:
    # GIVEN single bits flipped in the weights and in the card, where the file stays a model
    path = tmp_path / "m.onnx"
    tensors = {each.name: each.raw_data for each in onnx.load_from_string(GOOD).graph.initializer}
    places = (
        (GOOD.index(tensors["w0"]), "the graph was changed"),
        (GOOD.index(b'"limits"'), "the model card was changed"),
    )
    for begin, words in places:
        refused = 0
        for at in range(begin, begin + 300, 7):
            changed = bytearray(GOOD)
            changed[at] ^= 1
            path.write_bytes(changed)
            # WHEN it is loaded THEN it is refused, and nearly always for its checksum
            with pytest.raises(ModelError) as error:
                Model.load(path)
            refused += words in str(error.value)
        assert refused > 25


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_asks_for_too_much_is_refused_at_once(tmp_path: Path, name: str) -> None:
    began_s = time.process_time()
    assert outcome(HOSTILE[name], GOOD, tmp_path / "m.onnx") == "refused"
    assert time.process_time() - began_s < 4.0


def test_a_refused_model_is_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, log = tmp_path / "m.onnx", replay_log("healthy_micro_trips")
    for name in ("deep JSON", "no UTF-8", "outer", "period_ns 1000", "huge integer"):
        path.write_bytes(HOSTILE[name])
        assert main(["replay", str(log), "--model", str(path)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"o2mon: {path}: ")


def test_a_model_from_before_the_checksums_gets_them_with_its_next_card(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    text = card_of(GOOD)
    old = "\n".join(line for line in text.splitlines() if "graph_sha256" not in line)
    path.write_bytes(with_card_text(GOOD, old, signed=False))
    loaded = Model.load(path).card
    assert loaded.graph_sha256 == ""
    # but a file that has one of the two checksums has lost the other
    for text_of, signed in ((old, True), (text, False)):
        path.write_bytes(with_card_text(GOOD, text_of, signed=signed))
        with pytest.raises(ModelError, match="one is missing"):
            Model.load(path)
    path.write_bytes(with_card_text(GOOD, old, signed=False))
    update_card(path, loaded)
    assert Model.load(path).card.graph_sha256 == model_file.graph_sha256(GOOD)
    keys = {each.key for each in onnx.load(str(path)).metadata_props}
    assert keys == {model_file.CARD, model_file.CARD_SHA256}


def test_the_shipped_model_holds_its_checksums() -> None:
    card = Model.load(shipped_model()).card
    assert card.graph_sha256 == model_file.graph_sha256(GOOD)
    assert model_file.CARD_SHA256.encode() in GOOD
