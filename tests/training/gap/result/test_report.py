"""What the gap workflow reports: ``gap.json`` by its contract, and the page for a review."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from playwright.sync_api import Browser

from monitor.model.card import TrainingRecording
from tests.helpers.bus.chromium import plots_of
from training.gap import result
from training.gap.add.addition import Addition
from training.gap.name.verdict import (
    Answer,
    Base,
    BlockError,
    Candidate,
    Merit,
    Naming,
    NextDrives,
    Round,
    Trials,
    Verdict,
)
from training.gap.pages import gap_page
from training.gap.pages.verdict_words import actions, verdict_sentence
from training.gap.result import Inputs, Result, as_json
from training.gap.verify.error_curve import ErrorCurve
from training.gap.verify.evidence import Count, Detection, Error, ErrorTrace, Verification
from training.greybox.chain import Constants
from training.greybox.effects import LIBRARY
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.joint import JointFit
from training.greybox.fit.sensor_faults import FAULTS
from training.pages.numbers import percent

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
SECTIONS = ("now", "much", "what", "where")  # before what is folded
NOTHING = np.empty(0)
NO_FIT = JointFit(
    terms=(),
    base=Constants(),
    parameters=(),
    residual=NOTHING,
    jacobian=NOTHING,
    hessian=NOTHING,
    cost=0.0,
)
CONTRACT = {
    *("schema", "verdict", "where", "effects", "rmse_before", "rmse_after", "noise_floor"),
    *("detection_before", "detection_after", "experiment", "model"),
}
MODEL = (Path("models/base.onnx"), "b" * 64, "greybox")


def candidate(name: str, score: float) -> Candidate:
    fault = next((f for f in FAULTS if f.name == name), None)
    term = fault or LIBRARY[name]
    values = np.array([p.start[0] for p in term.parameters])
    fit = replace(NO_FIT, terms=(term,), parameters=(values,), hessian=1e4 * np.eye(len(values)))
    return Candidate(fit, Merit(score, 80.0, score / 100.0, physical=True), np.zeros(1))


def but(one: Candidate, **changes: Any) -> Candidate:
    """The candidate with another merit."""
    return replace(one, merit=replace(one.merit, **changes))


RANKING = (
    candidate("purge", 900.0),
    candidate("wall_film", 300.0),
    candidate("gain_low", 200.0),
    *(candidate(name, 10.0) for name in LIBRARY if name not in ("purge", "wall_film")),
)


PURGE_ADDED = Addition(
    path=Path("out/model.onnx"),
    form="The effect acts before the transport.",
    effects=RANKING[0].fit.effects,
)

OFFERED = replace(PURGE_ADDED, path=None, offer=Path("out/offer.onnx"), withdrawn="a fault")


MORE = NextDrives(1440.0, "<purge>", 0.66)


def naming(verdict: Verdict, ranking: tuple[Candidate, ...] = RANKING, **changes: Any) -> Naming:
    chosen: dict[Verdict, tuple[Candidate, ...]] = {
        "named": RANKING[:1],
        "ambiguous": (RANKING[0], *RANKING[3:6]),
    }
    answer = Answer(
        effects=chosen.get(verdict, ()),
        suspected="gain_low" if verdict == "sensor_fault_suspected" else None,
        experiment=MORE if verdict == "ambiguous" else None,
    )
    answer = replace(answer, **{k: v for k, v in changes.items() if k != "rounds"})
    rounds = (Round(RANKING[0], 0.0112, RANKING),) if verdict == "named" else ()
    return Naming(
        verdict=verdict,
        answer=answer,
        trials=Trials(
            ranking=ranking,
            rounds=changes.get("rounds", rounds),
            skipped={"scavenging": ("manifold_pressure_kpa",)},
        ),
        base=Base(Constants(), Constants(gain=1.01), Constants(*([0.001] * 6))),
        error=BlockError(
            before=0.0200,
            after=0.0110 if verdict == "named" else None,
            floor=0.0100,
            explained_share=0.4,
        ),
        warnings=("purge may be <something> else",),
    )


def error(kind: str, regime: str, after: float | None, worse: bool = False) -> Error:
    low, high = (0.001, 0.003) if worse else (-0.011, -0.009)
    return Error(
        kind=kind,
        regime=regime,
        samples=1000,
        blocks=20,
        before=0.0210,
        after=after,
        floor=0.0102,
        change_low=None if after is None else low,
        change_high=None if after is None else high,
    )


def verified(after: float | None = 0.0112, worse: bool = False, lost: bool = False) -> Verification:
    now = None if after is None else Count(4, 4, 1 if lost else 4, 1, ("gain_low",))
    alarm = None if after is None else Count(4, 4, 0, 0, ())
    t_s = np.arange(50) * 0.1
    wave = 1.0 + 0.02 * np.sin(t_s)
    at, level = np.linspace(10.0, 90.0, 5), np.full(5, 0.02)
    trace = ErrorTrace(
        recording="held.csv",
        t_s=t_s,
        measured=wave,
        before=wave - 0.02,
        after=wave - 0.005,
        scored=t_s > 1.0,
    )
    return Verification(
        overall=error("all", "all scored samples", after),
        regimes=(
            error("temperature", "coolant below 70 °C", after),
            error("edge", "from lean to rich", None if after is None else 0.0230, worse),
        ),
        healthy=None,
        faults=(Detection("gain_low", 0.6, Count(4, 4, 3, 3, ("gain_low",)), now),),
        alarms=Detection("", None, Count(4, 4, 0, 0, ()), alarm),
        healthy_alarms=None,
        notes=("The control loop has not seen them.",),
        trace=None if after is None else trace,
        curve=ErrorCurve("maf_kg_h", at, level, None if after is None else 0.5 * level),
    )


def used(name: str, source: str = "") -> TrainingRecording:
    return TrainingRecording(name, name[0] * 64, 6000, source)


def made(verdict: Verdict) -> Result:
    named = verdict == "named"
    return Result(
        inputs=Inputs(
            *MODEL,
            recordings=(used("new<1>.csv"),),
            healthy=(used("old.csv"),),
            verify=(used("held & out.csv"),),
        ),
        naming=naming(verdict),
        addition=PURGE_ADDED if named else Addition(),
        verified=verified() if named else verified(None),
        unknown="phi = 0.01 x <oil>" if verdict == "unknown_effect" else None,
        warnings=("given twice", "given twice"),
        seconds=12.0,
    )


@cache
def page_of(verdict: Verdict) -> str:
    """Return the page of a verdict."""
    return gap_page.as_page(made(verdict))


def unverified() -> Result:
    """A named effect without a recording that was kept from the fits."""
    one = made("named")
    return replace(one, verified=None, inputs=replace(one.inputs, verify=()))


def added(*effects: ModelEffect) -> Result:
    """A named effect with other constants in the new model."""
    return replace(made("named"), addition=replace(PURGE_ADDED, effects=effects))


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_json_of_every_verdict_keeps_the_contract(verdict: Verdict, tmp_path: Path) -> None:
    made_one = made(verdict)
    result.save(made_one, tmp_path / "new" / "gap.json")
    read = json.loads((tmp_path / "new" / "gap.json").read_text())
    assert read == as_json(made_one)
    assert read.keys() >= CONTRACT
    assert read["schema"] == "o2train.gap/1"
    assert read["verdict"] == verdict
    assert len(read["effects"]) == {"named": 1, "ambiguous": 3}.get(verdict, 0)
    assert [c["name"] for c in read["ranking"]] == [c.name for c in RANKING]
    for effect in read["effects"]:
        assert effect["class"] == list(LIBRARY[effect["name"]].like)
        assert isinstance(effect["separated"], bool)
        assert effect["runner_up"] in LIBRARY
    # RMSE and floor come from the same held-out samples
    figures = (read["rmse_before"], read["rmse_after"], read["noise_floor"])
    assert figures == (0.0210, 0.0112 if verdict == "named" else None, 0.0102)
    assert read["detection_before"] == 0.75
    assert read["detection_after"] == (1.0 if verdict == "named" else None)
    assert read["model"] == ("out/model.onnx" if verdict == "named" else None)
    assert (read["experiment"] is not None) == (verdict == "ambiguous")
    assert read["warnings"] == ["purge may be <something> else", "given twice"]


def test_an_effect_carries_the_constants_that_stand_in_the_model() -> None:
    refitted = ModelEffect.with_values("purge", [0.77], [0.05])
    effect = as_json(added(refitted))["effects"][0]
    assert effect["parameters"] == {"concentration": 0.77}
    assert effect["standard_errors"] == {"concentration": 0.05}
    assert effect["score"] == 900.0
    assert effect["runner_up"] == "wall_film"
    assert effect["separated"] is True


@pytest.mark.parametrize(
    ("addition", "added", "after", "to_do"),
    [
        (PURGE_ADDED, "purge", 0.0112, "Use out/model.onnx"),
        (Addition(), None, None, "Keep the model: no new one was written"),
        (OFFERED, None, 0.0112, "Keep the model, or use out/offer.onnx knowing this: a fault."),
    ],
)
def test_json_and_page_agree_on_what_was_added(
    addition: Addition, added: str | None, after: float | None, to_do: str
) -> None:
    tree = as_json(found := replace(made("named"), addition=addition))
    page = gap_page.as_page(found)
    assert to_do in page[page.index('id="now"') : page.index('id="much"')]
    assert ("but not added" in verdict_sentence(found)) == (after is None)
    assert [(e["name"], e["added"]) for e in tree["effects"]] == [("purge", added is not None)]
    assert [(s["named"], s["added"]) for s in tree["steps"]] == [(None, None), ("purge", added)]
    assert (tree["rmse_after"], tree["model"] is None) == (after, added is None)


def test_the_runner_up_is_of_the_step_in_which_the_effect_was_chosen() -> None:
    # GIVEN two effects, each chosen out of a ranking of its own, and a last one with neither
    first = (RANKING[0], candidate("delay_flow", 500.0))
    second = (RANKING[1], candidate("rail_exponent", 50.0))
    rounds = (Round(first[0], 0.015, first), Round(second[0], 0.011, second))
    last = (candidate("ethanol", 1.0),)
    named = naming("named", effects=RANKING[:2], ranking=last, rounds=rounds)
    both = replace(added(*(c.fit.effects[-1] for c in RANKING[:2])), naming=named)
    tree = as_json(both)
    told = [(e["runner_up"], e["separated"]) for e in tree["effects"]]
    assert told == [("delay_flow", True), ("rail_exponent", True)]
    assert [s["rmse"] for s in tree["steps"]] == [0.02, 0.015, 0.011]
    page = gap_page.as_page(both)
    assert "Candidates: purge" in page
    assert "Candidates of the last step" in page


def test_without_held_out_recordings_the_figures_are_those_of_held_out_blocks() -> None:
    tree = as_json(unverified())
    figures = (tree["rmse_before"], tree["rmse_after"], tree["noise_floor"])
    assert figures == (0.0200, 0.0110, 0.0100)
    assert tree["measured_on"] == "blocks held out of the recordings"
    assert tree["detection_before"] is None
    assert tree["verified"] is None
    assert "Not verified" in gap_page.as_page(unverified())


def test_what_is_not_finite_is_null_and_numpy_is_plain() -> None:
    best = but(RANKING[0], score=np.float64(5.0), t=np.nan)
    named = naming("named", effects=(best,), ranking=(best,))
    tree = as_json(replace(made("named"), naming=named))
    text = json.dumps(tree, allow_nan=False)
    assert json.loads(text)["ranking"][0]["t"] is None
    assert type(tree["ranking"][0]["score"]) is float


def test_the_page_says_how_sure_it_is_beside_the_verdict() -> None:
    found = made("named")
    weighed = replace(found.naming, posterior={"wall_film": 0.97, "none": 0.02, "purge": 0.01})
    page = gap_page.as_page(replace(found, naming=weighed)).replace("\xa0", " ")
    first = page[: page.index("<h2")]
    assert "Confidence: of all hypotheses, 97 % for wall film." in first


def test_where_are_the_regimes_in_which_the_excess_is_dense() -> None:
    # GIVEN an excess of 100 in 1,000 samples, 60 of it in 300 samples at edges
    whole = error("all", "all scored samples", None)
    excess = whole.before**2 - 0.0102**2
    dense = replace(
        error("edge", "rich", None), samples=300, before=(2 * excess + 0.0102**2) ** 0.5
    )
    thin = replace(error("edge", "none", None), samples=700, before=(excess / 2 + 0.0102**2) ** 0.5)
    shown = replace(verified(None), overall=whole, regimes=(thin, dense))
    # WHEN the JSON is made THEN it names them with their share, and not the others
    (found,) = as_json(replace(made("unknown_effect"), verified=shown))["where"]
    assert (found["kind"], found["regime"]) == ("edge", "rich")
    assert found["share_of_excess"] == pytest.approx(0.6)


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_page_has_every_section_in_order_and_escapes_what_it_shows(verdict: Verdict) -> None:
    page = page_of(verdict)
    places = [page.index(f'<h2 id="{name}">') for name in SECTIONS]
    assert places == sorted(places)
    assert page.index(f'class="verdict {verdict}"') < places[0]
    assert all(page.rindex("<details") > at for at in places)
    # AND names and texts from outside are escaped
    assert "new&lt;1&gt;.csv" in page
    assert "held &amp; out.csv" in page
    for tag in ("<1>", "<something>", "<2,600>", "<oil>"):
        assert tag not in page


@pytest.mark.parametrize("verdict", VERDICTS)
def test_plots_of_verdicts_are_drawn(browser: Browser, tmp_path: Path, verdict: Verdict) -> None:
    found = made(verdict)
    gap_page.save(found, tmp_path / "report.html")
    trace = found.verified is not None and found.verified.trace is not None
    wanted = 2 * trace + 2 * (found.verified is not None)
    assert plots_of(browser, tmp_path / "report.html") == wanted


@pytest.mark.parametrize(
    ("verdict", "words", "to_do"),
    [
        (
            "named",
            "Named: purge (canister purge brings fuel vapour). With it in the model the "
            "error on recordings that no fit saw falls, from 0.0210 to 0.0112",
            "Use out/model.onnx: the monitor runs it unchanged",
        ),
        ("no_gap", "No gap: the error on recordings that no fit saw is 0.0210", "Keep the model."),
        (
            "ambiguous",
            "Ambiguous: purge (canister purge brings fuel vapour), ",
            f"To tell them apart record {MORE}".replace("<purge>", "&lt;purge&gt;"),
        ),
        ("unknown_effect", "Unknown effect: the error", "Look at the errors by regime"),
        (
            "sensor_fault_suspected",
            "Sensor fault suspected: gain_low;",
            "run again with --sensor-known-good",
        ),
    ],
)
def test_the_verdict_stands_first_with_its_figures_and_what_to_do_now(
    verdict: Verdict, words: str, to_do: str
) -> None:
    page = page_of(verdict)
    first = page[page.index("<h1>") : page.index('id="now"')]
    assert words in first
    assert "0.0102" in first
    assert "simulated" not in first
    assert to_do in page[page.index('id="now"') : page.index('id="much"')]


def test_a_page_about_simulated_recordings_says_so() -> None:
    one, driven = made("named"), (used("wltc.csv", "simulated"),)
    some = replace(one, inputs=replace(one.inputs, recordings=driven))
    every = replace(one, inputs=Inputs(*MODEL, driven, healthy=driven, verify=driven))
    for one, words in (
        (some, "Some of the recordings are simulated."),
        (every, "All of it is about simulated recordings."),
    ):
        page = gap_page.as_page(one)
        assert words in page[page.index("<h1>") : page.index('id="now"')]
        assert as_json(one)["simulated"] is True


def test_a_fall_of_the_error_that_is_not_beyond_confidence_is_none_to_use() -> None:
    shown = verified()
    overall = replace(shown.overall, after=0.0208, change_low=-0.0006, change_high=0.0002)
    found = replace(made("named"), verified=replace(shown, overall=overall))
    page = gap_page.as_page(found)
    assert "does not fall beyond confidence, from 0.0210 to 0.0208" in page
    assert "Keep the model: that out/model.onnx is better on other recordings is not shown." in page
    assert "Use out/model.onnx" not in page


def test_an_effect_in_the_other_direction_says_what_to_look_at() -> None:
    contrary = but(candidate("back_pressure", 900.0), physical=False)
    found = naming("unknown_effect", (contrary,), effects=(contrary,))
    result = replace(made("unknown_effect"), naming=found, addition=Addition(), unknown=None)
    assert "→ back_pressure reversed" in gap_page.as_page(result)
    words = "Back pressure, but in the other direction: look at a pressure correction"
    assert verdict_sentence(result).startswith(words)
    assert "It is not added to the model" in verdict_sentence(result)
    assert as_json(result)["effects"][0]["hypothesis"] == "back_pressure reversed"
    # AND a model that was asked for all the same is called one with it, not one with a formula
    asked = replace(result, addition=PURGE_ADDED, verified=verified())
    assert actions(asked)[:2] == [actions(result)[0], actions(made("named"))[0]]


def test_an_unknown_effect_that_a_sensor_fault_explains_as_well_has_the_sensor_checked() -> None:
    found = replace(made("unknown_effect"), naming=naming("unknown_effect", suspected="gain_low"))
    assert "The sensor is among the suspects: gain_low explains" in verdict_sentence(found)
    assert any(each.startswith("Check the sensor") for each in actions(found))


def test_a_suspicion_says_which_effect_it_cannot_be_told_from() -> None:
    found = naming("sensor_fault_suspected", indistinguishable=RANKING[:1])
    page = gap_page.as_page(replace(made("sensor_fault_suspected"), naming=found))
    first = page[page.index("<h1>") : page.index('id="now"')]
    assert "cannot be told from purge (canister purge brings fuel vapour)." in first
    now = page[page.index('id="now"') : page.index('id="much"')]
    assert "run again with --sensor-known-good: then purge may be named." in now
    assert as_json(replace(made("named"), naming=found))["indistinguishable"] == ["purge"]


@pytest.mark.parametrize(("verdict", "word"), [("named", "or"), ("sensor_fault_suspected", "and")])
def test_what_may_be_there_beside_it_is_said_and_how_to_tell(verdict: Verdict, word: str) -> None:
    found = replace(made(verdict), naming=naming(verdict, beside=RANKING[1:3], experiment=MORE))
    says = [f"{c.name} ({c.term.says})" for c in RANKING[1:3]]
    assert f"Beside it there may be {says[0]} {word} {says[1]}." in verdict_sentence(found)
    assert any(str(MORE) in each for each in actions(found))
    assert "Beside it" not in verdict_sentence(made(verdict))


def test_worse_regimes_and_lost_faults_are_warned_of() -> None:
    lost = replace(made("named"), verified=verified(worse=True, lost=True))
    page = gap_page.as_page(lost)
    now = page[page.index('id="now"') : page.index('id="much"')]
    assert "Look at the warnings before using out/model.onnx" in now
    worse = (
        "worse beyond confidence with the new model: from lean to rich, "
        "RMSE 0.0210 before and 0.0230 after, in phi"
    )
    assert now.count(worse) == 1
    assert worse in as_json(lost)["warnings"]
    assert "gain_low 0.6 was found in 3 of 4 drives with the old model, in 1 with" in now
    assert ">lost<" in page


def test_a_model_with_which_the_monitor_decides_less_is_not_the_headline_s() -> None:
    # GIVEN a new model that closes the gap, and a monitor that decides nothing with it
    own = verified()
    own = replace(own, faults=(replace(own.faults[0], after=Count(4, 0, 0, 0, ())),))
    assert own.harm is not None
    # WHEN it is therefore an offer
    offered = replace(OFFERED, withdrawn=own.harm)
    found = replace(made("named"), verified=own, addition=offered)
    # THEN the first sentence says why, and no sentence says that it is to be used
    lost = "the monitor decides in 0 of 4 drives with the new model, in 4 with the old one"
    assert f"out/offer.onnx is an offer only: {lost}." in verdict_sentence(found)
    page = gap_page.as_page(found)
    assert "Use out/model.onnx" not in page
    assert "Keep the model, or use out/offer.onnx" in page
    tree = as_json(found)
    assert (tree["withdrawn"], tree["model"], tree["offer"]) == (lost, None, "out/offer.onnx")


def test_an_old_model_that_takes_the_gap_for_a_fault_is_no_measure() -> None:
    # GIVEN a new model that finds fewer faults than the old one
    every, half = Count(4, 4, 4, 0, ("gain_low",)), Count(4, 4, 2, 2, ())
    weak = Detection("gain_low", 0.6, every, half)
    told = replace(verified(), faults=(weak,))
    assert told.harm is not None
    assert (
        "finds a fault put on in 2 of 4 drives with the new model, in 4 with the old" in told.harm
    )
    # WHEN the old one raises codes without a fault THEN what it finds is no measure
    unquiet = replace(told, alarms=Detection("", None, every, half))
    assert unquiet.harm is None


def test_a_gap_is_measured_from_the_error_on_healthy_recordings_where_there_are_some() -> None:
    healthy = replace(error("healthy", "healthy recordings", 0.0300), before=0.0110)
    own = replace(verified(), healthy=healthy)
    # 0.0210 to 0.0112 where healthy drives have 0.0110
    gone = (0.0210**2 - 0.0112**2) / (0.0210**2 - 0.0110**2)
    assert own.closed_beyond_healthy == pytest.approx(gone)
    page = gap_page.as_page(replace(made("named"), verified=own))
    assert f"{percent(gone)} of what exceeds the error on healthy recordings is gone" in page
    # and where the new model errs less than the old one did on healthy drives
    less = replace(own, healthy=replace(healthy, before=0.0130))
    page = gap_page.as_page(replace(made("named"), verified=less))
    assert "and all of what exceeds the error on healthy recordings is gone" in page
