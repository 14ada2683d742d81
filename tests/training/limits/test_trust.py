"""What healthy drives say of a model: how long its reading stands still, what it mistakes."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.errors import ModelError
from monitor.base.faults import resolve
from monitor.cli import main
from monitor.judge.limits import Limits
from monitor.judge.trust import Trust, in_words
from monitor.memory.codes import TESTS
from monitor.model.card import Limit
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from training.limits.judging import judge_recordings
from training.limits.trust import LIMIT_FAULTS, MOST_DRIVES, trust_of
from training.narx.export import update_card
from training.recordings.recording import Recording, load
from training.recordings.sensor_fault import put_on

LOG = Path("replay_logs/healthy_micro_trips_v102_s102.blf")
SETTINGS = config.load()
MODEL = Model.load(shipped_model())


@cache
def healthy() -> Recording:
    return load(LOG, period_s=0.1)


@pytest.mark.parametrize(
    ("name", "untold"), [("still_s", set(TESTS["activity"])), ("still_end_s", set())]
)
def test_a_card_of_an_earlier_version_whose_reading_stands_still_sets_no_code_of_it(
    name: str, untold: set[str]
) -> None:
    limits = CARD.limits | {name: Limit(300.0, "s", "")}
    old = Limits.from_card(replace(CARD, limits=limits), SETTINGS, "old")
    assert old.trust.untold == untold
    assert replace(old, trust=LIMITS.trust) == LIMITS


CARD = replace(MODEL.card, trust={})
LIMITS = Limits.from_card(CARD, SETTINGS, "shipped")
NAMES = [name for name, _ in LIMIT_FAULTS]


def codes(limits: Limits, fault: str) -> list[str]:
    return codes_of(put_on(healthy(), resolve(fault, dict(LIMIT_FAULTS)[fault])), limits)


def codes_of(drive: Recording, limits: Limits) -> list[str]:
    return [dtc.fault for dtc in judge_recordings([drive], MODEL, limits, SETTINGS)[0].dtcs]


@pytest.mark.parametrize("fault", ["gain_low", "biased_rich", "delay_rich_to_lean"])
def test_a_fault_that_the_model_has_mistaken_sets_no_code(fault: str) -> None:
    assert codes(LIMITS, fault) == [fault]
    mistaken = replace(LIMITS, trust=Trust(10, dict.fromkeys(NAMES, 10), {fault: 1}))
    assert fault not in codes(mistaken, fault)
    # AND other faults are found as before
    assert codes(mistaken, "slow_symmetric") == codes(LIMITS, "slow_symmetric")


def test_a_heater_that_failed_is_named_in_training_as_in_a_replay() -> None:
    drive = load(LOG.with_name("heater_micro_trips_v123_s140.blf"))
    assert codes_of(drive, LIMITS) == ["heater"]


def test_a_good_model_finds_the_faults_and_mistakes_none() -> None:
    found = trust_of([(MODEL, [healthy()])], CARD, SETTINGS, "shipped")
    trust = Trust.from_card(found, "shipped")
    assert trust.drives == 1
    assert not trust.untold
    assert in_words(trust.entry()).startswith("tried on 1 drive, this model finds")
    assert len(trust.untested) <= 1  # a drive of seven minutes


def test_short_drives_take_no_place_of_a_drive_that_counts() -> None:
    # GIVEN as many drives of some seconds as may count, before a drive of minutes
    whole = healthy()
    short = [replace(whole.part(0, 100), sha256=str(k)) for k in range(MOST_DRIVES)]
    found = trust_of([(MODEL, [*short, whole])], CARD, SETTINGS, "shipped")
    # THEN the model is tried on that one
    assert found["drives"] == 1


def test_what_twins_saw_in_parts_of_one_drive_is_told_of_one_drive() -> None:
    half = len(healthy().values) // 2
    parts = healthy().part(0, half), healthy().part(half, 2 * half)
    found = trust_of([(MODEL, [part]) for part in parts], CARD, SETTINGS, "shipped")
    alone = [trust_of([(MODEL, [part])], CARD, SETTINGS, "shipped")["found"] for part in parts]
    assert found["drives"] == 1
    assert found["found"] == {name: max(each[name] for each in alone) for name in NAMES}


def test_a_drive_that_the_model_does_not_describe_gets_no_code_and_no_pass() -> None:
    # GIVEN a model that explained most of a reading, and a drive with another drive's reading
    trust = Trust.from_card(trust_of([(MODEL, [healthy()])], CARD, SETTINGS, "m"), "m")
    assert trust.explained > 0.5
    own, values = healthy(), healthy().values.copy()
    values[:, own.names.index(MODEL.card.output.name)] = own.column(MODEL.card.output.name)[::-1]
    other = replace(own, values=values)
    # WHEN both are judged THEN only of the other one is asked whose it is, and nothing is found
    limits = replace(LIMITS, trust=trust)
    for drive, is_other in ((own, False), (other, True)):
        (judged,) = judge_recordings([drive], MODEL, limits, SETTINGS)
        assert ("is it another vehicle's?" in in_words(trust.entry(judged.explained))) is is_other
        assert judged.dtcs == []
        assert ("passed" in {w.outcome for w in judged.windows[-10:]}) is not is_other
    assert codes_of(other, LIMITS) != []


def test_a_model_that_trusts_itself_too_much_learns_which_faults_it_mistakes() -> None:
    # GIVEN a model that takes its errors for faults, and a drive that it predicts badly
    names, drive = healthy().names, healthy()
    values = drive.values.copy()
    fuel = values[:, names.index("fuel_mass_mg")]
    fuel *= 1.0 + 0.1 * np.sin(np.arange(len(fuel)) / 200.0)  # as an injector that nobody knows
    reading = values[:, names.index("lambda_measured")]
    reading += 0.1 - 0.5 * (reading - 1.0)
    other = replace(drive, values=values)
    sure = {"noise": 0.001, "offset_std": 0.001, "evidence": 1.0}
    own = {name: replace(CARD.limits[name], value=value) for name, value in sure.items()}
    card = replace(CARD, limits={**CARD.limits, **own})
    false = {*codes_of(other, Limits.from_card(card, SETTINGS, "m"))}
    assert len(false) > 1
    # WHEN its trust is counted on that drive
    trust = trust_of([(MODEL, [other])], card, SETTINGS, "m")
    # THEN they stand in one order, whatever the run, and the drive has none of these codes any more
    assert list(trust["false"]) == sorted(false)
    sure = Limits.from_card(replace(card, trust=trust), SETTINGS, "m")
    assert sure.trust.untold == false
    assert not false & {*codes_of(other, sure)}


@pytest.mark.parametrize(
    ("seconds", "why"),
    [
        (None, "tried on 6 drives, the model finds none of its faults"),
        (35, "tried on 1 drive, the model finds none of its faults"),
    ],
)
def test_a_model_that_finds_no_fault_or_was_tried_on_seconds_judges_no_response(
    seconds: int | None, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = tmp_path / "blind.onnx"
    counts = {"drives": 6, "found": dict.fromkeys(NAMES, 2), "false": {}}
    if seconds:
        short = healthy().part(0, 10 * seconds)
        counts = trust_of([(MODEL, [short])], CARD, SETTINGS, "shipped")
    update_card(shipped_model(), replace(CARD, trust=counts), blind)
    assert main(["replay", str(LOG), "--model", str(blind)]) == 3
    said = capsys.readouterr().out
    assert f"not judged: response: {why}" in said and "windows: 0 passed" in said
    assert "passed: activity, communication, range, ready; undecided: response, bias" in said


def test_of_an_output_that_is_no_lambda_lags_and_gains_act_as_on_one() -> None:
    # GIVEN a reading z that falls where phi rises, with the same movement as phi
    drive, rng = healthy(), np.random.default_rng(1)
    column = drive.names.index("lambda_measured")
    phi = 1.0 + 0.01 * np.cumsum(rng.standard_normal(len(drive.values))) / 20.0
    z = 3.0 - 7.0 * (phi - np.median(phi))

    def reading(values: np.ndarray, fault: str, transform: str) -> np.ndarray:
        table = drive.values.copy()
        table[:, column] = values
        put = put_on(replace(drive, values=table), resolve(fault, 0.5), transform=transform)
        return put.values[:, column]

    for fault in ("slow_rich_to_lean", "delay_lean_to_rich", "slow_symmetric"):
        as_phi = 1.0 / reading(1.0 / phi, fault, "phi")
        wanted = 3.0 - 7.0 * (as_phi - np.median(phi))
        np.testing.assert_allclose(reading(z, fault, "none"), wanted, atol=1e-9)
    halved = reading(z, "gain_low", "none")
    np.testing.assert_allclose(halved - 3.0, 0.5 * (z - 3.0), atol=1e-9)


@given(st.dictionaries(st.sampled_from(NAMES), st.integers(0, 9)), st.integers(1, 9))
def test_a_fault_is_tested_if_it_was_found_often_enough_and_never_mistaken(
    found: dict[str, int], drives: int
) -> None:
    found = {name: min(n, drives) for name, n in found.items()}
    trust = Trust.from_card({"drives": drives, "found": found, "false": {"gain_low": 1}}, "m")
    for name, n in found.items():
        assert (name in trust.untested) == (name == "gain_low" or 2 * n < drives)


@pytest.mark.parametrize("given", [{"drives": 3}, {"drives": 3, "found": [1], "false": {}}])
def test_a_card_whose_trust_is_nonsense_is_refused_by_name(given: dict[str, object]) -> None:
    with pytest.raises(ModelError, match=r"car\.onnx: the model card's trust"):
        Trust.from_card(given, "car.onnx")
