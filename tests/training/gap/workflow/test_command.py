"""``o2train gap`` from files to a new model, on simulated drives with the plant's own effects."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import pytest

from monitor.base.command_line.command import INTERRUPTED
from monitor.base.errors import ModelError, UsageError
from monitor.model.step import Model
from tests.helpers.gap.gap_simulated import drives, run
from tests.helpers.logs.replays import replays
from training import cli
from training.gap import workflow
from training.gap.add import greybox
from training.gap.add.addition import withheld_effects
from training.gap.inputs.roles import GapOptions, Material
from training.gap.workflow import investigate
from training.greybox.chain import Constants
from training.greybox.fit.drive import ChainDrive
from training.healthy import yardstick
from training.healthy.behaviour import Healthy
from training.healthy.card import KEY, from_card
from training.recordings.recording import load


@pytest.fixture(scope="module", autouse=True)
def _learned_once() -> Iterator[None]:
    """Learn the same healthy drives once, whoever asks: it takes longer than all the rest."""
    learn, found = yardstick.learn, dict[Any, Healthy]()

    def once(driven: Sequence[ChainDrive], start: Constants, *told: Any) -> Healthy:
        key = (start, *(drive.phi_measured.tobytes() for drive in driven))
        if key not in found:
            found[key] = learn(driven, start, *told)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(yardstick, "learn", once)
        yield


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Drives of the vehicle on which the model is accepted."""
    suffixes = ("parquet", "parquet", "parquet", "parquet")
    return drives(tmp_path_factory.mktemp("healthy"), 2_800_011, suffixes=suffixes)


@pytest.fixture(scope="module")
def chain(healthy: list[Path]) -> Path:
    """The grey-box chain fitted to them, with limits for the monitor."""
    path, names = healthy[0].parent / "chain.onnx", list(map(str, healthy))
    assert cli.main(["fit", *names, "--kind", "greybox", "--out", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Drives with a wall film, one of them as a CAN log."""
    folder = tmp_path_factory.mktemp("film")
    return drives(folder, 2_800_041, ("wall_film", 4.0), suffixes=("parquet", "log", "csv.gz"))


def test_fit_leaves_the_vehicle_s_reference_in_the_card(chain: Path, healthy: list[Path]) -> None:
    card = Model.load(chain).card
    assert card.reference[KEY]["recordings"] == [path.name for path in healthy]
    assert {"derived", KEY} <= set(card.reference)
    read, _ = from_card(card)
    assert read is not None
    assert set(read.surplus) >= {"wall_film", "biased"}


class Stopped:
    """What a run did that was stopped, and one after it."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.codes: list[int] = []

    @property
    def result(self) -> dict[str, Any]:
        """``gap.json``."""
        found: dict[str, Any] = json.loads((self.out / "gap.json").read_text())
        return found


@pytest.fixture(scope="module")
def named(chain: Path, healthy: list[Path], film: list[Path]) -> Stopped:
    """A run that was stopped while naming, then the same again."""
    stopped = Stopped(chain.parent / "gap")
    arguments = ["--model", chain, *film, "--healthy", *healthy, "--out", stopped.out]

    def stop(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(workflow, "name", stop)
        stopped.codes.append(run(*arguments))
    stopped.codes.append(run(*arguments))
    return stopped


def test_a_run_that_was_stopped_can_be_begun_again(named: Stopped) -> None:
    assert named.codes == [INTERRUPTED, 0]


def test_a_hidden_effect_is_named_added_and_written_by_the_contract(named: Stopped) -> None:
    found = named.result
    assert found["schema"] == "o2train.gap/1"
    assert found["verdict"] == "named"
    assert [each["name"] for each in found["effects"]] == ["wall_film"]
    effect = found["effects"][0]
    assert effect.keys() >= {"name", "parameters", "score", "runner_up", "separated", "class"}
    assert effect["separated"]
    assert effect["runner_up"] != "wall_film"
    assert found["where"]
    assert all(0.0 < w["share_of_excess"] <= 1.0 and w["regime"] for w in found["where"])
    assert found["rmse_after"] < 0.85 * found["rmse_before"]
    assert found["noise_floor"] < found["rmse_after"]
    assert found["detection_after"] >= found["detection_before"]
    assert found["simulated"]
    assert found["model"] == str(named.out / "model.onnx")


def test_the_constants_come_from_all_recordings_and_each_is_judged_by_the_others(
    named: Stopped, film: list[Path]
) -> None:
    (added,) = Model.load(named.out / "model.onnx").card.effects
    assert {each["sha256"] for each in added["recordings"]} == {load(p).sha256 for p in film}
    assert named.result["measured_on"] == "recordings that the constants have not seen"
    assert {f["before"]["drives"] for f in named.result["verified"]["detection"]} == {1}
    assert named.result["verified"]["false_alarms"]["after"]["drives"] == 3
    assert {path.name for path in named.out.iterdir()} == {"gap.json", "model.onnx", "report.html"}


def test_the_monitor_replays_with_the_new_model(
    named: Stopped, film: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    code, (judged,) = replays(film[1], "--model", named.out / "model.onnx")
    assert code in (0, 3), capsys.readouterr()
    assert judged["dtcs"] == []
    assert len(judged["windows"]) > 20
    assert sum(w["verdict"] == "failed" for w in judged["windows"]) == 0


def test_the_model_that_is_looked_at_is_not_written_over(
    named: Stopped, healthy: list[Path], film: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    before = (named.out / "model.onnx").read_bytes()
    (named.out / "offer.onnx").write_bytes(before)  # of an earlier run
    for path in (named.out / "model.onnx", named.out / "offer.onnx"):
        assert run("--model", path, *film, "--healthy", *healthy, "--out", named.out) == 2
        assert f"{path}: is read, too" in capsys.readouterr().err
        with pytest.raises(UsageError, match="is read, too"):
            investigate(Material(path, list(map(load, film))), named.out, GapOptions())
        assert path.read_bytes() == before


def test_a_leak_is_named_and_added_only_if_it_is_known_to_be_no_fault(
    chain: Path, healthy: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leaking = drives(tmp_path, 2_800_031, ("exhaust_leak", 4.0))
    material = Material(chain, [load(p) for p in leaking], [load(p) for p in healthy])
    naming, kept = workflow.name, list[Any]()  # named once, decided on three times

    def once(*given: Any, **how: Any) -> Any:
        kept.extend([] if kept else [naming(*given, **how)])
        return kept[0]

    monkeypatch.setattr(workflow, "name", once)

    def found(**options: Any) -> Any:
        chosen = GapOptions(faults=(), **options)
        return investigate(material, tmp_path / "out", chosen)

    withheld = found()
    assert withheld.verdict == "named"
    assert [each.name for each in withheld.effects] == ["exhaust_leak"]
    assert withheld.addition.path is None
    assert withheld.addition.offer and withheld.addition.offer.exists()
    assert "--add exhaust_leak" in (withheld.addition.withdrawn or "")
    told = found(add=("exhaust_leak",))
    assert [each.name for each in told.addition.effects] == ["exhaust_leak"]
    assert told.rmse[1] and told.rmse[1] < 0.8 * told.rmse[0]
    assert withheld_effects(told.naming, GapOptions(sensor_known_good=True)) is None
    # and a model that takes no effect leaves a result too
    monkeypatch.setattr(greybox, "add", _takes_none)
    without = found(add=("exhaust_leak",))
    assert (without.verdict, without.addition.path) == ("named", None)
    assert "what was found is not added: has effects in an older form" in without.all_warnings


def _takes_none(*_: Any, **__: Any) -> NoReturn:
    raise ModelError("has effects in an older form")


def test_a_slow_sensor_is_suspected_and_no_model_is_written(
    chain: Path, healthy: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = drives(tmp_path, 2_800_021, fault=("slow_symmetric", 0.3))
    out = tmp_path / "gap"
    out.mkdir()
    (out / "model.onnx").write_text("of a run before, on other recordings")
    assert run("--model", chain, *slow, "--healthy", *healthy, "--out", out, "--force") == 0
    found = json.loads((out / "gap.json").read_text())
    assert found["verdict"] == "sensor_fault_suspected"
    assert (found["effects"], found["model"], found["rmse_after"]) == ([], None, None)
    assert not (out / "model.onnx").exists()
    assert "Nothing was added" in (out / "report.html").read_text()
    assert "Sensor fault suspected" in capsys.readouterr().out
