"""Why healthy recordings give no windows: fit and calibrate name the column at fault."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from monitor.base import config
from monitor.base.errors import RecordingError
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.drive_tables import Columns, table
from training.limits.decision_limits import limits_of
from training.limits.judging import why_not
from training.recordings.recording import Recording, load

CONFIG = config.load()
CARD = Model.load(shipped_model()).card


def recording(path: Path, **changes: float) -> Recording:
    def change(data: Columns) -> None:
        for name, value in changes.items():
            data[name][:] = value

    return load(table(path, change))


def test_a_column_of_zeros_is_named_instead_of_more_recordings(tmp_path: Path) -> None:
    zeros = recording(tmp_path / "zeros.csv", vehicle_speed_km_h=0.0)
    with pytest.raises(RecordingError, match="0 healthy windows") as raised:
        limits_of([[]], CARD, CONFIG, "test", [zeros])
    assert "vehicle_speed_km_h is 0 km/h throughout" in str(raised.value)
    assert "more or longer" not in str(raised.value)


def test_nothing_is_wrong_with_an_ordinary_drive(tmp_path: Path) -> None:
    assert why_not(recording(tmp_path / "drive.csv"), CARD, CONFIG) == []


def test_a_short_drive_is_to_last_as_long_as_its_model_remembers(tmp_path: Path) -> None:
    slow = replace(CARD, checks={"contraction": {"samples": 400}})
    short = recording(tmp_path / "drive.csv").part(0, 30)
    assert why_not(short, slow, CONFIG)[0].advice.endswith("at least 45 s are wanted")


def test_a_reading_that_never_came_has_no_value_in_all_samples(tmp_path: Path) -> None:
    blank = recording(tmp_path / "blank.csv", lambda_measured=math.nan)
    assert "no value in 100 % of the samples" in why_not(blank, CARD, CONFIG)[0].advice
