"""What the gap workflow refuses or warns of before and beside the naming; its stages."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.drives.recordings import recording_of
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from training.gap.inputs import suitability
from training.greybox.chain import Constants, base_path, simulate
from training.greybox.effects.model_effect import ModelEffect, uncertain
from training.greybox.fit.drive import ChainDrive, make
from training.healthy import behaviour, coverage
from training.healthy.operating_points import Visited
from training.recordings.recording import Recording

USUAL = Constants()


def drive(seed: int, constants: Constants = USUAL, **changed: FloatArray) -> ChainDrive:
    """Return ten minutes of a chain with those constants and a little noise."""
    signals = plain_signals(6000, seed) | changed
    noise = 0.002 * np.random.default_rng([seed, 8]).standard_normal(6000)
    phi = simulate(base_path(constants, signals), PERIOD_S) + noise
    return make(f"drive_{seed}", PERIOD_S, signals, 1.0 / np.maximum(phi, 0.07))


def recording(seed: int, without: Sequence[str] = (), period_s: float = 0.1) -> Recording:
    columns = {n: x for n, x in plain_signals(900, seed).items() if n not in without}
    columns["lambda_measured"] = np.ones(900)
    return recording_of(columns, f"drive_{seed}.csv", period_s, f"{seed:064x}")


CARD = Model.load(shipped_model()).card


def test_air_per_stroke_may_come_from_air_meter_and_speed_and_speed_from_both_others() -> None:
    assert suitability.lacking([recording(1, without=["air_mass_mg"])]) == {}
    assert suitability.lacking([recording(1, without=["engine_speed_rpm"])]) == {}
    neither = recording(1, without=["engine_speed_rpm", "maf_kg_h"])
    assert suitability.lacking([neither]) == {"engine_speed_rpm": ["drive_1.csv"]}


def test_an_effect_whose_signal_healthy_recordings_lack_is_warned_of() -> None:
    def warned(*lacking: str) -> list[str]:
        return suitability.unlearned_effect_warnings([recording(1)], [recording(2, lacking)])

    (text,) = warned("rail_pressure_mpa")
    assert text.startswith("rail_exponent: healthy recordings lack rail_pressure_mpa")
    assert warned() == []
    assert warned("engine_speed_rpm") == []  # the air meter tells it


def test_a_model_that_hardly_follows_its_own_vehicle_is_warned_of() -> None:
    assert suitability.poor_model_warnings(CARD) == []
    weak = replace(CARD, fit={"test": {}, "test_enabled": {"correlation": 0.2}})
    assert "0.20" in suitability.poor_model_warnings(weak)[0]
    never_enabled = replace(
        weak, fit={"test": {"correlation": 0.2}, "test_enabled": {"samples": 0}}
    )
    assert "0.20" in suitability.poor_model_warnings(never_enabled)[0]


def test_a_constant_smaller_than_its_standard_error_is_warned_of() -> None:
    sure = ModelEffect.with_values("injector_offset", [0.2])
    name = next(iter(sure.parameters))
    doubtful = replace(sure, standard_errors={name: 0.3})
    assert uncertain([replace(sure, standard_errors={name: 0.1})]) == []
    assert f"{name} is 0.2 mg/stroke with a standard error of 0.3" in uncertain([doubtful])[0]
    unseen = replace(sure, standard_errors={name: 0.0})
    assert "do not determine" in uncertain([unseen])[0]
    # and a share of about none is known as well as any other
    leak = ModelEffect.with_values("exhaust_leak", [0.05, 30.0, 0.0], [0.002, 2.0, 0.1])
    assert uncertain([leak]) == []
    unknown = replace(leak, standard_errors=dict(leak.standard_errors) | {"place": 0.45})
    (warning,) = uncertain([unknown])
    assert "place is 0, which the recordings of the fit do not determine" in warning


def test_cells_count_as_visited_from_fifteen_seconds_on() -> None:
    n = 6000
    speed = np.where(np.arange(n) < 1000, 3000.0, 2000.0)
    speed[-100:] = 5000.0  # for ten seconds
    warm = drive(1, engine_speed_rpm=speed, air_mass_mg=np.full(n, 250.0))
    visited = Visited.of([warm])
    on = visited.on(warm)
    assert on[warm.scored & (speed == 3000.0)].mean() > 0.9
    assert not on[speed == 5000.0].any()
    cold = replace(warm, signals={**warm.signals, "coolant_temperature_degc": np.full(n, 10.0)})
    assert not visited.on(cold).any()


def test_drives_that_do_not_say_their_coolant_temperature_count_as_of_any() -> None:
    warm = drive(1, engine_speed_rpm=np.full(6000, 2000.0), air_mass_mg=np.full(6000, 250.0))
    signals = dict(warm.signals)
    assert signals.pop("coolant_temperature_degc") is not None
    silent = replace(warm, signals=signals)
    assert Visited.of([warm]).on(silent)[warm.scored].all()
    assert Visited.of([silent]).on(warm)[warm.scored].all()


def test_drives_where_no_healthy_one_has_been_are_warned_of() -> None:
    # GIVEN healthy drives with a warm engine, and new ones of which one is cold
    known = behaviour.learn([drive(seed) for seed in (1, 2, 3)], USUAL)
    cold = drive(5, coolant_temperature_degc=np.full(6000, 10.0))
    # WHEN they are to be named
    assert coverage.coverage_warnings([drive(4)], known) == []
    left_out, share = coverage.coverage_warnings([drive(4), cold], known)
    # THEN the cold one is said to be left out
    assert left_out.startswith("drive_5: left out of the naming")
    assert left_out.endswith("at coolant temperatures that no healthy recording has visited")
    assert share.startswith("5")
    assert "name nothing" in share


def test_a_recording_without_three_good_samples_in_a_row_is_refused_by_its_name() -> None:
    whole = [drive(seed) for seed in (1, 2)]
    nothing = replace(drive(3), scored=np.arange(6000) % 3 > 0)
    suitability.check_long(whole, "new")
    with pytest.raises(RecordingError, match="drive_3: less than 60 s can be scored"):
        suitability.check_long([*whole, nothing], "new")
