"""Drives of the gap workflow: what is scored, what is held, what is refused."""

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from tests.helpers.drives.recordings import recording_of
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from training.greybox.fit import drive as drives


def _make(signals: dict[str, FloatArray], lambda_measured: FloatArray) -> drives.ChainDrive:
    return drives.make("d", PERIOD_S, signals, lambda_measured)


def test_fuel_cut_and_the_recovery_from_it_are_not_scored() -> None:
    signals = plain_signals()
    drive = _make(signals, np.ones(6000))
    cut = signals["fuel_mass_mg"] == 0.0
    assert not drive.scored[cut].any()
    first_after = int(np.flatnonzero(np.diff(cut.astype(int)) == -1)[0]) + 1
    recovery = round(drives.RECOVERY_S / PERIOD_S)
    assert not drive.scored[first_after : first_after + recovery].any()
    assert drive.scored[first_after + recovery]


def test_a_cut_that_is_read_late_is_not_scored_either() -> None:
    # GIVEN a vehicle whose exhaust takes three seconds to the sensor
    signals = plain_signals()
    cut = signals["fuel_mass_mg"] == 0.0
    read = np.concatenate([np.zeros(30, dtype=bool), cut[:-30]])
    drive = _make(signals, np.where(read, 15.0, 1.0))
    # THEN nothing counts until a second after the sensor has read the cut's end
    assert not drive.scored[read].any()
    last = int(np.flatnonzero(np.diff(read.astype(int)) == -1)[0])
    assert not drive.scored[last : last + 11].any()
    assert drive.scored[last + 11]


@pytest.mark.parametrize("name", ["air_mass_mg", "fuel_mass_mg", "engine_speed_rpm"])
def test_a_gap_in_an_input_is_held_and_not_scored(name: str) -> None:
    signals = plain_signals()
    values = signals[name].copy()
    values[3000:3010] = np.nan
    drive = _make(signals | {name: values}, np.ones(6000))
    np.testing.assert_array_equal(drive.signals[name][3000:3010], np.full(10, values[2999]))
    assert not drive.scored[3000 : 3010 + 49].any()


def test_missing_lambda_is_not_scored_and_phi_stays_finite() -> None:
    measured = np.full(6000, 1.25)
    measured[:200] = np.nan
    measured[4000:4100] = np.nan
    drive = _make(plain_signals(), measured)
    assert not drive.scored[:200].any()
    assert not drive.scored[4000:4100].any()
    np.testing.assert_array_equal(drive.phi_measured, np.full(6000, 0.8))


def test_a_sensor_that_is_not_ready_is_not_scored() -> None:
    ready = (np.arange(6000) > 1000).astype(float)
    drive = _make(plain_signals() | {"sensor_ready": ready}, np.ones(6000))
    assert not drive.scored[:1001].any()
    assert drive.scored[1001:].any()


def test_engine_speed_follows_from_air_meter_and_charge() -> None:
    signals = plain_signals()
    rpm = signals.pop("engine_speed_rpm")
    drive = _make(signals, np.ones(6000))
    np.testing.assert_allclose(drive.signals["engine_speed_rpm"], rpm, rtol=1e-9)


def test_a_drive_that_is_too_short_is_refused_with_what_was_wanted() -> None:
    with pytest.raises(RecordingError, match="s can be scored, 60 wanted"):
        _make(plain_signals(400), np.ones(400))


def test_a_recording_becomes_a_drive_of_its_name_and_one_without_fuel_is_refused() -> None:
    columns = plain_signals() | {"lambda_measured": np.ones(6000)}
    drive = drives.from_recording(recording_of(columns))
    assert (drive.name, drive.period_s) == ("drive.csv", PERIOD_S)
    np.testing.assert_array_equal(drive.signals["air_mass_mg"], columns["air_mass_mg"])
    del columns["fuel_mass_mg"]
    with pytest.raises(RecordingError, match=r"drive\.csv: has no good value of fuel_mass_mg"):
        drives.from_recording(recording_of(columns))


def test_a_network_of_air_and_fuel_is_looked_at_without_engine_speed() -> None:
    signals = {k: x for k, x in plain_signals().items() if k in ("air_mass_mg", "fuel_mass_mg")}
    reading = np.ones(len(signals["fuel_mass_mg"]))
    with pytest.raises(RecordingError, match="neither engine_speed_rpm nor maf_kg_h"):
        drives.make("d", PERIOD_S, signals, reading)
    assert drives.make("d", PERIOD_S, signals, reading, needed=tuple(signals)).scored.any()
