"""Naming on simulated vehicles: the plant's own effects, sensor faults, and nothing at all."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.gap_cases.answers import contradicts
from tests.helpers.gap.gap_simulated import healthy, known, two_drives
from training.gap.name import naming
from training.gap.name.decision import StepOutcome
from training.gap.name.formulas.contest import beats
from training.gap.name.ranking import rank
from training.gap.name.steps import Advance
from training.gap.name.verdict import Naming
from training.greybox.chain import Constants, simulate
from training.greybox.effects import LIBRARY
from training.greybox.effects.empirical import effect_of
from training.greybox.effects.model_effect import ModelEffect, along
from training.greybox.fit.drive import ChainDrive, path_of
from training.greybox.fit.sensor_faults import FAULTS
from training.greybox.quantity.dynamics import delayed
from training.healthy import yardstick
from training.healthy.base_state import base_state
from training.healthy.scoring import win
from training.healthy.without import corrections


def name(*given: Any, **options: Any) -> Naming:
    """Return what is said, which is never another answer than the likeliest hypotheses."""
    found = naming.name(*given, **options)
    labels = [effect.label for effect in found.answer.effects]
    answer = {"verdict": found.verdict, "labels": labels, "posterior": found.posterior}
    assert not contradicts(answer)
    likelier = {"another": 1.0 - 1e-6} | dict.fromkeys(found.posterior, 1e-06)
    assert contradicts(answer | {"posterior": likelier})
    return found


@cache
def named(effect: str, severity: float) -> Naming:
    """Return what is said of drives with an effect in the plant's form."""
    return name(two_drives(2_200_140, (effect, severity)), known())


def test_drives_like_the_healthy_ones_have_no_gap() -> None:
    found = name(two_drives(2_200_120), known())
    assert found.verdict == "no_gap"
    assert found.answer.effects == ()
    assert found.error.after is None
    # AND no gap is the likeliest of all hypotheses
    assert next(iter(found.posterior)) == "none"
    assert {"unknown", "none", "biased"} <= set(found.posterior)
    assert sum(found.posterior.values()) == pytest.approx(1.0)
    # nor is what two healthy drives leave open one, and it hides no effect
    few = yardstick.learn(healthy()[1:3], Constants())
    assert name(two_drives(2_200_120), few).verdict == "no_gap"
    film = name(two_drives(2_200_140, ("wall_film", 4.0)), few)
    assert (film.verdict, [e.name for e in film.answer.effects]) == ("named", ["wall_film"])


@pytest.mark.parametrize(("effect", "severity"), [("wall_film", 4.0), ("purge", 4.0)])
def test_a_hidden_effect_is_named_and_the_gap_shrinks(
    monkeypatch: pytest.MonkeyPatch, effect: str, severity: float
) -> None:
    # GIVEN drives with an effect well above the noise, in the plant's form, and where no signal
    # comes near it, as for the film, a search for a formula that would fail: no name needs one
    if effect == "wall_film":
        monkeypatch.setattr("training.gap.name.naming.first_term", None)
    # WHEN it is looked for
    found = named(effect, severity)
    # THEN it is named, with constants and their uncertainty, and most of the gap is gone
    assert (found.verdict, [e.name for e in found.answer.effects]) == ("named", [effect])
    best = found.answer.effects[0]
    assert found.posterior[effect] > 0.9
    assert all(error > 0.0 for error in best.standard_errors.values())
    assert found.error.after is not None
    gap = found.error.before**2 - found.error.floor**2
    assert found.error.after**2 - found.error.floor**2 < 0.4 * gap


def test_a_small_leak_that_looks_like_a_rail_exponent_is_ambiguous_with_an_experiment() -> None:
    found = name(two_drives(2_200_160, ("exhaust_leak", 4.0)), known())
    assert found.verdict == "ambiguous"
    assert [e.name for e in found.answer.effects] == ["exhaust_leak", "rail_exponent"]
    assert found.answer.experiment is not None


def test_two_effects_at_once_are_named_one_after_the_other() -> None:
    first = two_drives(2_200_170, ("wall_film", 4.0), also=("delay_flow", 4.0))
    found = name(first, known(), steps=2)
    assert found.verdict == "named"
    assert {effect.name for effect in found.answer.effects} == {"wall_film", "delay_flow"}
    assert found.error.after is not None
    assert found.error.after < 0.5 * found.error.before


@pytest.mark.parametrize("begins", [False, True], ids=["everywhere", "onset of what comes first"])
def test_what_one_signal_explains_far_better_than_any_effect_is_unknown_and_gets_a_formula(
    begins: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    drives = two_drives(2_200_300, ("battery_voltage", 8.0 if begins else 4.0))
    if begins:
        monkeypatch.setattr("training.gap.name.decision.onset_s", lambda *_: (drives[0].name, 10.0))
    found = name(drives, known())
    assert found.verdict == "unknown_effect"
    kinds = {(term.kind, term.name.split(":")[1]) for term in found.answer.effects}
    assert kinds == {("empirical", "battery_voltage_v")}
    assert next(iter(found.posterior)) == "unknown"


def test_a_sensor_slow_from_the_start_is_suspected_and_nothing_is_added() -> None:
    found = name(two_drives(2_200_180, fault=("slow_symmetric", 0.3)), known())
    assert found.verdict == "sensor_fault_suspected"
    assert found.answer.effects == ()
    assert found.error.after is None
    assert found.base is not None
    shift = found.base.shift
    assert shift is not None
    lag_s = shift.mixing_s + shift.sensor_s
    assert lag_s == pytest.approx(0.3, abs=0.1)


@pytest.mark.parametrize(
    ("seed", "late_s", "start_s"),
    [(2_200_310, 2.0, 0.0), (2_200_186, 0.5, 300.0)],
    ids=["that leads with 43 %", "from the middle of the drives on"],
)
def test_a_late_sensor_is_suspected(seed: int, late_s: float, start_s: float) -> None:
    fault = ("delay_rich_to_lean", late_s)
    found = name(two_drives(seed, fault=fault, fault_start_s=start_s), known())
    first = found.trials.ranking[0]
    assert (first.kind, found.answer.effects) == ("sensor fault", ())
    assert (found.verdict, found.answer.suspected) == ("sensor_fault_suspected", first.name)


def test_a_formula_that_does_not_beat_a_sensor_fault_is_not_added(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # GIVEN an unknown effect that a sensor of another gain explains in part, and no candidate that
    # loses against another
    monkeypatch.setattr("training.gap.name.formulas.contest.HALF", 0.0)
    monkeypatch.setattr("training.gap.name.formulas.contest.WIN", 1.1)
    found = name(two_drives(2_200_300, ("battery_voltage", 8.0)), known())
    # THEN the effect stays without formula, and the sensor is among the suspects
    assert (found.verdict, found.answer.suspected) == ("unknown_effect", "gain_low")
    assert (found.answer.effects, found.error.after) == ((), None)


def test_an_effect_that_a_formula_clearly_beats_is_unknown_and_not_named() -> None:
    # GIVEN a reading that falls beyond 60 kPa, of which scavenging explains a large part
    drive = two_drives(2_200_300)[0]
    pressure_kpa = delayed(drive.signals["manifold_pressure_kpa"], 3)
    share = 1.0 - 0.1 * np.maximum(pressure_kpa - 60.0, 0.0) / 50.0
    found = name([replace(drive, phi_measured=drive.phi_measured * share)], known())
    first = found.trials.ranking[0]
    assert first.merit.is_large
    # THEN the formula stands in its place, and no hypothesis is likelier than an unknown cause
    assert found.verdict == "unknown_effect"
    assert {term.kind for term in found.answer.effects} == {"empirical"}
    assert next(iter(found.posterior)) == "unknown"


def test_a_formula_of_what_a_fuel_does_to_the_healthy_errors_does_not_beat_the_fuel() -> None:
    # GIVEN a vehicle with large errors when healthy, learned over fuel and controller, and a drive
    # on another fuel, which moves both
    large = replace(known(), ridge=replace(known().ridge, weights=10.0 * known().ridge.weights))
    fuel = (ModelEffect.with_values("ethanol", [0.2]),)
    drive = large.known_of(two_drives(2_200_120)[1])
    path = along(path_of(drive, large.base), fuel, drive.signals, drive.period_s)
    noise = 0.002 * np.random.default_rng(1).standard_normal(len(drive))
    read = simulate(path, drive.period_s) + corrections(large, [drive], fuel)[0] + noise
    first = base_state([replace(drive, phi_measured=read)], large, large.base)
    # WHEN a curve of the air flow explains more than the fuel beside the errors of that mixture
    terms = [LIBRARY["ethanol"], effect_of("empirical:maf_kg_h:curve:80:70")]
    curve, ethanol = ranking = rank(first, terms)
    assert curve.kind == "empirical"
    assert win(curve.left, ethanol.left) > 0.99
    # THEN it beats neither the fuel nor a sensor that is said to look like it
    (biased,) = rank(first, [fault for fault in FAULTS if fault.name == "biased"])
    for fault in (ethanol, biased):
        said = StepOutcome("sensor_fault_suspected", ranking, (ethanol,), fault=fault)
        assert beats(first, curve, Advance(first, said, (), (ethanol, biased), {})) == 0.0


def test_another_fuel_and_a_biased_sensor_are_each_said_to_look_like_the_other() -> None:
    # GIVEN drives on fuel with ethanol, and drives with a sensor that reads lean
    fuel = two_drives(2_200_190, ("ethanol", 4.0))
    sensor = two_drives(2_200_192, fault=("biased_lean", 0.05))
    # WHEN they are looked at, THEN the sensor is suspected of both, and ethanol is beside it
    for each in (fuel, sensor):
        found = name(each, known())
        assert found.verdict == "sensor_fault_suspected"
        assert found.answer.effects == ()
        assert [c.name for c in found.answer.indistinguishable] == ["ethanol"]
    # AND with a sensor known to be good the fuel has its name
    found = name(fuel, known(), sensor_known_good=True)
    assert [c.name for c in found.answer.effects] == ["ethanol"]
    assert found.answer.indistinguishable == ()


def test_a_charge_that_is_broadcast_too_early_on_every_drive_is_no_phase_of_its_message() -> None:
    # GIVEN drives whose charge is broadcast 45 ms before the cylinder has it, whatever the speed
    def early(drive: ChainDrive) -> ChainDrive:
        air = drive.signals["air_mass_mg"]
        t_s = np.arange(len(drive)) * drive.period_s
        sooner = {"air_mass_mg": np.interp(t_s + 0.045, t_s, air)}
        return replace(drive, signals=dict(drive.signals) | sooner)

    found = name([early(drive) for drive in two_drives(2_200_194)], known())
    # THEN it has its name, and no lag of the sensor is made of what the name leaves
    assert found.verdict == "named"
    assert [c.name for c in found.answer.effects] == ["manifold_filling"]
    assert found.answer.effects[0].parameters["time"] == pytest.approx(0.045, abs=0.02)


def test_an_error_far_above_that_of_healthy_drives_is_a_gap_though_nothing_fits_it() -> None:
    # GIVEN drives whose mixture wanders slowly, by what no signal tells
    def wandering(drive: ChainDrive, periods_s: tuple[float, float]) -> ChainDrive:
        t_s = np.arange(len(drive)) * drive.period_s
        slow = sum(0.02 * np.sin(2.0 * np.pi * t_s / period_s) for period_s in periods_s)
        return replace(drive, phi_measured=drive.phi_measured + slow)

    first, second = two_drives(2_200_120)
    found = name([wandering(first, (47.0, 31.0)), wandering(second, (59.0, 37.0))], known())
    # THEN that is no error of a healthy drive
    assert found.verdict == "unknown_effect"
    assert all(c.merit.score < c.merit.needed or c.merit.t < 3.0 for c in found.trials.ranking)


def test_an_effect_that_explains_too_little_is_said_beside_an_ambiguous_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # GIVEN a first step that takes a small part of a gap, and a second that cannot decide
    driven = two_drives(2_200_140, ("wall_film", 4.0))
    film, *others = named("wall_film", 4.0).trials.ranking
    small = next(c for c in others if c.kind == "effect")
    first, second = {"unknown": 1.0, small.name: 0.0}, {"unknown": 0.2, "wall_film": 0.8}
    steps = iter(
        [
            StepOutcome("unknown_effect", (small, film), posterior=first, part=small),
            StepOutcome("ambiguous", (film, *others), (film, *others[:1]), posterior=second),
        ]
    )
    monkeypatch.setattr("training.gap.name.steps.step", lambda *_, **__: next(steps))
    # WHEN two steps are asked for
    found = name(driven, known(), steps=2)
    # THEN the second's candidates are the answer, and the first is not lost
    assert (found.verdict, found.answer.effects) == ("ambiguous", (film, *others[:1]))
    (text,) = [w for w in found.warnings if "came first" in w]
    assert text.startswith(f"{small.name} came first and explains too little by itself")
    # and the probabilities are of both together
    assert found.posterior == pytest.approx({f"{small.name}+wall_film": 0.8, "unknown": 0.2})


def test_the_error_with_a_reversed_effect_is_measured_as_with_a_named_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = named("wall_film", 4.0)
    film = found.answer.effects[0]
    film = replace(film, merit=replace(film.merit, physical=False))
    odds = {film.label: 1.0, "none": 0.0, "unknown": 0.0}
    said = StepOutcome("unknown_effect", (film,), (film,), posterior=odds)
    monkeypatch.setattr("training.gap.name.steps.step", lambda *_, **__: said)
    again = name(two_drives(2_200_140, ("wall_film", 4.0)), known())
    assert (again.answer.effects, again.error.after) == ((film,), found.error.after)


def test_a_sensor_slow_in_one_direction_may_be_made_so_and_an_effect_beside_it_is_said() -> None:
    slow = ("slow_rich_to_lean", 0.6)
    for effect, beside in ((None, []), (("wall_film", 4.0), ["wall_film"])):
        found = name(two_drives(2_200_181, effect, fault=slow), known(), steps=2)
        assert found.verdict == "sensor_fault_suspected"
        assert found.answer.suspected == "slow_rich_to_lean"
        assert [c.name for c in found.answer.indistinguishable] == [*beside, "sensor_asymmetry"]
        assert found.answer.effects == ()
        assert [c.name for c in found.answer.beside] == beside


def test_healthy_recordings_and_signals_that_are_missing_are_said() -> None:
    # GIVEN two drives, one of them without rail pressure, and no healthy ones
    (drive, other) = two_drives(2_200_120)
    fewer = {k: v for k, v in drive.signals.items() if k != "rail_pressure_mpa"}
    found = name([replace(drive, signals=fewer), other], None, None)
    # THEN the effect that needs it is left out, and no fault of the sensor stands in the ranking
    assert found.trials.skipped == {"rail_exponent": ("rail_pressure_mpa",)}
    assert "rail_exponent" not in [c.name for c in found.trials.ranking]
    assert any("no healthy recordings" in text for text in found.warnings)
    assert any("no reference" in text for text in found.warnings)
    assert {c.kind for c in found.trials.ranking} == {"effect"}
    assert found.base is not None
    assert found.base.shift is None
