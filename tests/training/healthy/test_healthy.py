"""What healthy drives teach of the broadcast charge, and their errors beside an effect."""

import json
from dataclasses import replace

import numpy as np
import pytest

from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.gap import gap_simulated
from tests.helpers.gap.gap_simulated import known, simulated
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive, phi_of
from training.healthy import behaviour
from training.healthy.behaviour import Healthy
from training.healthy.card import KEY, from_card, to_card
from training.healthy.without import LIMITS, corrections


def _rmse(driven: ChainDrive, taught: Healthy) -> float:
    own = taught.with_own(driven)
    e = phi_of(own, taught.base) - own.phi_measured
    return float(np.sqrt(np.mean(e[own.scored] ** 2)))


def test_the_chain_misses_less_of_an_unseen_drive_with_the_right_charge() -> None:
    # GIVEN healthy drives of an ECU whose air per stroke follows its air meter slowly
    taught, fresh = known(), simulated("hwfet", 2_020_019)
    assert taught.charge is not None
    # WHEN the same drives teach the constants and volumes alone
    as_broadcast = [replace(drive, charged=True) for drive in gap_simulated.healthy()]
    alone = behaviour.learn(as_broadcast, taught.plain)
    assert alone.charge is None
    # THEN a drive that taught neither is predicted better with the charge's error
    assert _rmse(fresh, taught) < 0.9 * _rmse(fresh, alone)


def test_healthy_drives_say_nothing_of_coolant_temperatures_between_those_they_had() -> None:
    # GIVEN warm drives only, whose reading rises a little with small changes of the temperature
    def warm(drive: ChainDrive) -> ChainDrive:
        change_k = np.sin(np.arange(len(drive)) * drive.period_s / 40.0)
        coolant = {"coolant_temperature_degc": 87.0 + change_k}
        read = drive.phi_measured + 0.002 * change_k
        return replace(drive, signals=dict(drive.signals) | coolant, phi_measured=read)

    taught = behaviour.learn([warm(drive) for drive in gap_simulated.healthy()], Constants())
    weights = dict(zip(taught.names, taught.ridge.weights.tolist(), strict=True))
    # THEN that slope is not carried on over the 15 K to a temperature where none was
    assert abs(weights["coolant 3"] - weights["coolant 4"]) < 0.02  # 15 times 0.002 is 0.03
    # nor are colder engines held to have no such miss at all
    assert weights["coolant 0"] == pytest.approx(weights["coolant 3"], abs=0.005) != 0.0
    assert taught.ridge.high[taught.names.index("coolant 0")] == 1.0
    # nor do samples there count
    fresh = gap_simulated.healthy()[0]
    cool = {"coolant_temperature_degc": np.full(len(fresh), 75.0)}
    assert not taught.visited.on(replace(fresh, signals=dict(fresh.signals) | cool)).any()


def test_the_charge_is_put_right_once() -> None:
    taught, fresh = known(), simulated("hwfet", 2_020_019)
    once = taught.with_own(fresh)
    twice = taught.known_of(taught.with_own(once))
    assert once.charged
    assert not np.allclose(once.signals["air_mass_mg"], fresh.signals["air_mass_mg"])
    assert np.array_equal(once.signals["air_mass_mg"], twice.signals["air_mass_mg"])
    # nor is one that a model has put right already
    right = replace(fresh, charged=True)
    assert taught.with_own(right).signals is right.signals


def test_the_model_card_holds_the_charge_s_error() -> None:
    taught, fresh = known(), simulated("hwfet", 2_020_019)
    stored = json.loads(json.dumps(to_card(taught, ())))
    card = replace(Model.load(shipped_model()).card, reference={KEY: stored})
    read, doubts = from_card(card)
    assert doubts is None
    assert read is not None
    theirs, own = (each.with_own(fresh).signals["air_mass_mg"] for each in (read, taught))
    assert np.allclose(theirs, own)
    # and cards from before it was learned have none
    del stored["charge"]
    older, _ = from_card(card)
    assert older is not None
    assert older.charge is None


def test_an_effect_on_the_mixture_is_taken_out_of_fuel_and_controller() -> None:
    # GIVEN an effect that makes the mixture richer by 5 % wherever the engine runs
    richer = ModelEffect.with_values("empirical:engine_speed_rpm:factor:2000:1000", [5.0, 0.0])
    drive = known().known_of(simulated("hwfet", 2_020_019))
    # WHEN the healthy errors are asked for without it
    (read,) = corrections(known(), [drive], (richer,))
    # THEN they are those of a drive with 5 % more fuel, and a controller that asks for it
    share = np.where(drive.signals["fuel_mass_mg"] > LIMITS.controller_fuel_min_mg, 1.05, 1.0)
    moved = {n: share * drive.signals[n] for n in ("fuel_mass_mg", "lambda_controller")}
    like = replace(drive, signals={**drive.signals, **moved})
    np.testing.assert_allclose(read, known().correction(like), atol=1e-9)
    assert not np.allclose(read, known().correction(drive), atol=1e-4)
    # AND without any effect they are the drive's own
    (same,) = corrections(known(), [drive], ())
    np.testing.assert_allclose(same, known().correction(drive))
