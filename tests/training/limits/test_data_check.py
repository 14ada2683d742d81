"""``o2train check``: is the data enough, said before any training."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from monitor.base.types import FloatArray, Quality
from tests.helpers.drives.recordings import recording_of
from tests.helpers.models.plants import coloured
from training.cli import main
from training.limits.data_check.check import check
from training.limits.data_check.findings import as_page, as_text
from training.limits.data_check.inputs import coverage
from training.recordings.recording import Recording, write_table

INPUTS = ("speed", "load", "ignition")
Findings = dict[str, list[tuple[str, str]]]


def engine(seed: int = 1, n: int = 6000) -> dict[str, FloatArray]:
    rng = np.random.default_rng(seed)
    speed, load, ignition = coloured(n, rng, 0.98), coloured(n, rng, 0.9), coloured(n, rng, 0.8)
    lean = np.tanh(np.roll(load, 3) - 0.5 * np.roll(speed, 2) * np.roll(ignition, 1))
    return {
        "speed": speed,
        "load": load,
        "ignition": ignition,
        "lean": lean + 0.05 * rng.standard_normal(n),
    }


def levels(result: dict[str, object]) -> Findings:
    """Return topic → (level, text) of every finding."""
    found: Findings = {}
    for f in result["findings"]:  # type: ignore[attr-defined]
        found.setdefault(f["topic"], []).append((f["level"], f["text"]))
    return found


@pytest.fixture(scope="module")
def good() -> Recording:
    return recording_of(engine())


def only(result: dict[str, object], topic: str, level: str) -> str:
    """Return the text of the one finding of ``topic``, which has ``level``."""
    (found,) = levels(result)[topic]
    assert found[0] == level
    return found[1]


def test_data_that_is_enough_has_no_warning(good: Recording) -> None:
    result = check([good], INPUTS, "lean")
    assert result["usable"]
    assert {f["level"] for f in result["findings"]} == {"ok"}
    assert json.loads(json.dumps(result, allow_nan=False)) == result


def test_readings_at_the_end_of_the_range_are_not_usable(good: Recording) -> None:
    quality = good.quality.copy()
    quality[2000:4000, good.names.index("lean")] = Quality.PINNED
    result = check([replace(good, quality=quality)], INPUTS, "lean")
    assert "lean is not valid in 33.3 % of the samples" in only(result, "gaps", "warning")


def test_a_missing_signal_is_an_error_that_names_file_and_signal(good: Recording) -> None:
    result = check([good], ("speed", "torque"), "lean")
    text = only(result, "missing channels", "error")
    assert "drive.csv" in text and "torque" in text and "ignition" in text
    assert not result["usable"]


def test_different_periods_are_an_error_that_names_both(good: Recording) -> None:
    result = check([good, recording_of(engine(2), "other.csv", 0.05)], INPUTS, "lean")
    text = only(result, "sample period", "error")
    assert "0.05" in text and "0.1" in text and "other.csv" in text


ALL = slice(None)
STEPS = np.repeat([1.0, 2.0, 1.5], 2000)
SHORT = "no stretch of 40 samples with all inputs valid"


@pytest.mark.parametrize(
    ("name", "rows", "value", "topic", "level", "words", "n"),
    [
        ("load", ALL, np.nan, "missing channels", "error", ["load is never valid"], 2),
        ("ignition", ALL, 12.0, "constant", "error", ["ignition is constant (12)"], 1),
        ("load", slice(1000, 1900), np.nan, "gaps", "warning", ["load", "15.0 %", "900 sampl"], 1),
        ("speed", slice(None, None, 30), np.nan, "gaps", "error", [SHORT], 1),
        ("ignition", ALL, STEPS, "excitation", "warning", ["ignition changes 2 times"], 1),
    ],
)
def test_a_signal_that_cannot_be_learned_from_is_told(
    name: str, rows: slice, value: FloatArray, topic: str, level: str, words: list[str], n: int
) -> None:
    columns = engine()
    columns[name][rows] = value
    result = check([recording_of(columns)], INPUTS, "lean")
    found = levels(result)[topic]
    assert len(found) == n
    assert any(own == level and all(word in text for word in words) for own, text in found)
    assert result["usable"] == (level == "warning")


def test_a_recording_too_short_to_be_used_is_named(good: Recording) -> None:
    result = check([good, recording_of(engine(2, 30), "short.csv")], INPUTS, "lean")
    assert "short.csv: not used" in only(result, "gaps", "warning")
    assert result["usable"]


def test_fewer_samples_than_the_smallest_network_has_weights_are_an_error() -> None:
    text = only(check([recording_of(engine(n=41))], INPUTS, "lean"), "duration", "error")
    assert "41 samples" in text and "weights" in text
    assert check([recording_of(engine(n=700))], INPUTS, "lean")["usable"]


@pytest.mark.parametrize("shift", [-7, 0, 7])
def test_a_scaled_and_shifted_copy_of_the_output_is_a_leak(shift: int) -> None:
    columns = engine()
    columns["ignition"] = 3.0 - 2.0 * np.roll(columns["lean"], shift)
    result = check([recording_of(columns)], INPUTS, "lean")
    text = only(result, "leak", "error")
    assert "ignition" in text and ("shifted" in text) == (shift != 0)


def test_the_reciprocal_of_the_measured_lambda_is_a_leak() -> None:
    rng = np.random.default_rng(4)
    lambda_measured = 1.0 / (1.0 + 0.3 * np.tanh(coloured(4000, rng, 0.9)))
    columns = {
        "speed": coloured(4000, rng, 0.9),
        "phi": 1.0 / lambda_measured,
        "lambda_measured": lambda_measured,
    }
    result = check([recording_of(columns)], ("speed", "phi"), "lambda_measured")
    assert "phi follows lambda_measured" in only(result, "leak", "error")


def test_a_neighbouring_slow_sensor_is_a_warning_not_a_leak() -> None:
    # GIVEN two temperatures that drift together, each with its own noise
    rng = np.random.default_rng(5)
    drift = 50.0 * coloured(6000, rng, 0.999)
    columns = engine() | {
        "one": drift + rng.standard_normal(6000),
        "two": drift + rng.standard_normal(6000),
    }
    result = check([recording_of(columns)], ("speed", "one"), "two")
    # THEN their levels correlate almost fully, their changes do not
    assert "make sure" in only(result, "leak", "warning")
    assert result["usable"]


def test_an_input_that_is_constant_where_the_others_are_valid_is_an_error() -> None:
    columns = engine()
    columns["ignition"][:4000] = 3.0
    columns["load"][4000:] = np.nan
    blank = recording_of(engine(2) | {"ignition": np.full(6000, np.nan)}, "blank.csv")
    result = check([recording_of(columns), blank], INPUTS, "lean")
    assert "ignition is constant where all inputs" in only(result, "constant", "error")


def test_time_outside_closed_loop_is_a_warning(good: Recording) -> None:
    closed = np.zeros(6000)
    closed[:2000] = 1.0
    result = check([recording_of(engine() | {"closed_loop": closed})], INPUTS, "lean")
    assert "3.33\xa0min, 33 %" in only(result, "closed loop", "warning")
    assert "do not say" in only(check([good], INPUTS, "lean"), "closed loop", "ok")


def test_time_in_closed_loop_that_no_training_uses_does_not_count() -> None:
    # GIVEN a loop that is open in the one long stretch and closed between gaps of a signal
    columns = engine() | {"closed_loop": np.repeat([0.0, 1.0], 3000)}
    columns["load"] = np.where(
        (np.arange(6000) >= 3000) & (np.arange(6000) % 20 == 0), np.nan, columns["load"]
    )
    # THEN none of the usable time was in closed loop
    assert "0 % of the usable" in only(
        check([recording_of(columns)], INPUTS, "lean"), "closed loop", "warning"
    )


def test_one_operating_point_is_poor_coverage() -> None:
    columns = engine()
    steady = np.arange(6000) < 5700
    for name in ("speed", "load"):
        columns[name] = np.where(steady, 0.3, columns[name])
    result = check([recording_of(columns)], INPUTS, "lean")
    only(result, "coverage", "warning")
    assert result["coverage"]["fullest"] > 0.5


def test_coverage_counts_visited_cells() -> None:
    along = np.repeat(np.linspace(0.0, 1.0, 1000), 10)
    found = coverage(along, along, 0.1)  # along the diagonal of 8 × 8 cells
    assert found["share"] == pytest.approx(8 / 64)
    assert np.sum(found["seconds"]) == pytest.approx(990.0, abs=2.0)


def test_without_a_recording_there_is_no_usable_data() -> None:
    assert not check([], INPUTS, "lean")["usable"]


def test_the_same_file_twice_is_an_error_as_for_a_fit(good: Recording) -> None:
    result = check([good, replace(good, path=Path("copy.csv"))], INPUTS, "lean")
    assert "copy.csv" in only(result, "repeated file", "error")


def write_csv(path: Path, columns: dict[str, FloatArray]) -> Path:
    t_s = 0.1 * np.arange(len(columns["lean"]))
    write_table(path, t_s, list(columns), np.column_stack(list(columns.values())))
    return path


def test_the_command_ends_with_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_csv(tmp_path / "a.csv", engine(n=2000))
    page, out = tmp_path / "check.html", tmp_path / "check.json"
    chosen = ["--inputs", *INPUTS, "--output", "lean"]
    code = main(["check", str(path), *chosen, "--json", str(out), "--html", str(page)])
    text = capsys.readouterr().out
    assert code == 0
    assert text.splitlines()[-1].startswith("usable")
    result = json.loads(out.read_text())
    assert result["schema"] == "o2train.check/2" and as_text(result) in text
    assert page.read_text() == as_page(result)


def test_an_unusable_file_ends_with_2_and_the_error_stands_last(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_csv(tmp_path / "a.csv", engine(n=2000))
    broken = tmp_path / "broken.csv"
    broken.write_text("not a table\n")
    code = main(["check", str(path), str(broken), "--inputs", *INPUTS, "--output", "lean"])
    shown = capsys.readouterr()
    assert code == 2
    assert "broken.csv" in shown.out
    assert shown.err.splitlines()[-1].startswith("o2train: not usable: 1 error")
