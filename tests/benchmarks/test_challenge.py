"""A challenge for others: recordings, a sealed truth, and marks for their answers."""

import json
from pathlib import Path

import pytest

from benchmarks.studies.workflow.challenge import main
from training.recordings.recording import load


@pytest.fixture(scope="module")
def challenge(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three cases of one vehicle, two drives of two minutes each."""
    folder = tmp_path_factory.mktemp("challenge") / "set"
    words = "--cases effect=1 null=1 fault=1 --vehicles 1 --drives 2 --minutes 2"
    assert main(["--out", str(folder), *words.split()]) == 0
    return folder


def score(challenge: Path, answers: Path) -> int:
    return main(["--out", str(challenge), "--score", str(answers)])


def test_a_challenge_holds_recordings_and_tells_neither_truth_nor_seed(challenge: Path) -> None:
    index = json.loads((challenge / "challenge.json").read_text())
    assert sorted(index["cases"]) == ["case_0001", "case_0002", "case_0003"]
    assert set(index["cases"].values()) == {"vehicle_01"}
    drive = load(challenge / "case_0002" / "drive_02.csv.gz")
    assert drive.t_s[-1] == pytest.approx(120.0, abs=1.0)
    assert "lambda_measured" in drive.names
    told = (challenge / "challenge.json").read_text()
    study = json.loads((challenge.parent / "set-truth.json").read_text())["study"]
    assert str(study["seed"]) not in told
    assert str(study["first_vehicle"]) not in told


@pytest.mark.parametrize(("right", "marks"), [(True, 1), (False, 0)])
def test_answers_get_marks_by_kind(
    challenge: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], right: bool, marks: int
) -> None:
    truth = json.loads((challenge.parent / "set-truth.json").read_text())["cases"]
    verdicts = {"effect": "named", "null": "no_gap", "fault": "sensor_fault_suspected"}
    answers = {
        name: {"verdict": verdicts[case["kind"]], "names": case["hidden"]}
        if right
        else {"verdict": "no_gap"}
        for name, case in truth.items()
    }
    path = tmp_path / "answers.json"
    path.write_text(json.dumps(answers))
    assert score(challenge, path) == 0
    lines = dict(line.split(", ", 1) for line in capsys.readouterr().out.splitlines())
    share = {1: "right 100.0", 0: "right 0.0"}
    assert lines["kind null"].startswith(share[1])
    assert lines["kind effect"].startswith(share[marks])
    assert lines["kind fault"].startswith(share[marks])


def test_a_truth_that_was_changed_afterwards_is_refused(
    challenge: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = challenge.parent / "set-truth.json"
    sealed = place.read_text()
    place.write_text(sealed.replace('"severities"', '"sizes"'))
    assert score(challenge, challenge / "answers.json") == 2
    assert "not the truth that was sealed" in capsys.readouterr().err
    place.write_text(sealed)
