"""A logger that pauses says nothing of the sensor."""

from pathlib import Path

import numpy as np
import pytest

from monitor import cli
from tests.helpers.logs.replays import replays
from training.recordings.recording import load

ROOT = Path(__file__).resolve().parents[3]
DRIVE = ROOT / "replay_logs" / "healthy_micro_trips_v102_s102.blf"


def written(path: Path, every: int = 1, pause_s: float = 0.0) -> Path:
    """Write every so many-th sample of the drive as a table, with a pause within it."""
    recording = load(DRIVE)
    t_s = np.arange(len(recording.values)) * recording.period_ns / 1e9
    t_s[2000:] += pause_s
    header = ",".join(("time_s", *recording.names))
    cells = np.column_stack([t_s, recording.values])[::every]
    np.savetxt(path, cells, "%.9g", ",", header=header, comments="")
    return path


@pytest.mark.parametrize("pause_s", [0.9, 12.0])
def test_a_table_of_a_healthy_drive_with_a_pause_gets_no_code(
    pause_s: float, tmp_path: Path
) -> None:
    code, (judged,) = replays(written(tmp_path / "paused.csv", pause_s=pause_s))
    assert (code, judged["dtcs"]) == (0, [])
    assert judged["windows_interrupted"] >= 1


@pytest.mark.parametrize("every", [2, 10])
def test_a_table_with_rows_further_apart_than_the_model_s_samples_is_not_judged_by_it(
    every: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["replay", str(written(tmp_path / "coarse.csv", every))]) == 3
    told = capsys.readouterr().out
    assert f"samples every {every / 10:g} s, the model needs them every 0.1 s" in told
