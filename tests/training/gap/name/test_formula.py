"""An effect of no library becomes a formula of one signal, which a model can hold."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from tests.helpers.gap.gap_drives import PERIOD_S, noisy_drive, plain_signals
from tests.training.greybox.test_effects import (
    test_the_arrays_and_the_graph_of_an_effect_agree as graph_agrees,
)
from training.gap.name.formulas.formula import _place_of, _rate_of, first_term, formula_of
from training.gap.name.formulas.signal_functions import functions_of
from training.gap.name.verdict import Candidate
from training.greybox.chain import Constants, Path, base_path, simulate
from training.greybox.effects.empirical import FORMS, effect_of, formula, growing, name_of, parts_of
from training.greybox.fit.drive import ChainDrive, make
from training.healthy.base_state import base_state
from training.healthy.scoring import Score

BASE = Constants(
    gain=1.0, dead_time_s=0.15, dead_time_revolutions=1.5, mixing_s=0.06, sensor_s=0.1, span=1.0
)
PLAIN = plain_signals(n=600)
Change = Callable[[Path, dict[str, FloatArray]], Path]


def made(change: Change, seed: int, noise: float = 0.003) -> ChainDrive:
    """A drive of plain formulas on which the chain reads something more, in coloured noise."""
    rng = np.random.default_rng(seed)
    signals = plain_signals(seed=seed)
    n = len(signals["fuel_mass_mg"])
    wander = lfilter([np.sqrt(1 - 0.98**2)], [1, -0.98], rng.standard_normal(n))
    signals |= {"battery_voltage_v": 13.9 + 0.4 * wander}
    path = change(base_path(BASE, signals), signals)
    coloured = lfilter([noise * np.sqrt(1 - 0.8**2)], [1, -0.8], rng.standard_normal(n))
    phi = simulate(path, PERIOD_S) + coloured
    return make(f"made {seed}", PERIOD_S, signals, 1.0 / np.maximum(phi, 0.07))


def found(change: Change, seeds: Sequence[int] = (1,)) -> tuple[Candidate, ...]:
    begun = first_term(state := base_state([made(change, seed) for seed in seeds], None, BASE))
    return formula_of(begun, state).terms if begun else ()


def by_intake(more: Callable[..., FloatArray]) -> Change:
    """Return a mixture that is richer by a share of the intake's temperature and the voltage."""

    def change(path: Path, signals: dict[str, FloatArray]) -> Path:
        share = more(signals["manifold_temperature_degc"], signals["battery_voltage_v"])
        return replace(path, factor=path.factor * (1.0 + share))

    return change


warm_intake = by_intake(lambda degc, _: -0.0088 * (degc - 30.0))


@pytest.mark.parametrize(
    ("change", "form", "constant", "per_degc"),
    [
        (warm_intake, "factor", "size", -0.88),  # percent
        (by_intake(lambda c, _: 0.12 * np.exp(-(c - 20.0) / 10.0)), "exponential", "rate", -0.1),
    ],
    ids=["a share per degree", "a share that halves every 7 K"],
)
def test_what_goes_with_a_temperature_is_found_in_its_form_with_its_size(
    change: Change, form: str, constant: str, per_degc: float
) -> None:
    (term,) = found(change)
    _, *of, _, half = term.name.split(":")
    assert (term.kind, of) == ("empirical", ["manifold_temperature_degc", form])
    assert term.parameters[constant] / float(half) == pytest.approx(per_degc, rel=0.1)


def test_a_resonance_is_found_at_its_speed_with_its_width() -> None:
    # GIVEN a charge that is larger by 8 % about 1,900 rpm
    def resonance(path: Path, signals: dict[str, FloatArray]) -> Path:
        bell = np.exp(-(((signals["engine_speed_rpm"] - 1900.0) / 150.0) ** 2))
        return replace(path, air_mg=path.air_mg * (1.0 + 0.08 * bell))

    # WHEN a formula is looked for
    (term,) = found(resonance)
    # THEN it is a bell, though no knot of a curve lies there, and the ECU learns nothing of it
    _, signal, form, at, half = term.name.split(":")
    assert (signal, form) == ("engine_speed_rpm", "bump")
    values = term.parameters
    assert float(at) + values["place"] * float(half) == pytest.approx(1900.0, abs=20.0)
    assert values["width"] * float(half) == pytest.approx(150.0, rel=0.1)
    assert values["size"] == pytest.approx(8.0, rel=0.1)


def test_a_constant_is_part_of_a_formula() -> None:
    # GIVEN fuel that enters at 10 mg/s whatever the engine does
    def seep(path: Path, signals: dict[str, FloatArray]) -> Path:
        strokes_per_s = signals["engine_speed_rpm"] / 30.0
        return replace(path, fuel_mg=path.fuel_mg + 10.0 / strokes_per_s)

    # WHEN a formula is looked for
    (term,) = found(seep)
    # THEN it is a mass per second that hardly changes with its signal
    assert term.name.split(":")[2] == "vapour"
    assert term.parameters["middle"] == pytest.approx(10.0, abs=1.0)
    assert abs(term.parameters["size"]) < 2.0


def test_a_share_that_grows_with_a_second_signal_is_found_with_it() -> None:
    # GIVEN a mixture that is leaner per degree of the intake, and the more so at high voltage
    # WHEN a formula is looked for
    (term,) = found(by_intake(lambda degc, v: -0.008 * (degc - 30.0) * (1.0 + 0.8 * (v - 13.9))))
    # THEN it is one term, a product of the two
    _, signal, _, _, _, second, *_ = term.name.split(":")
    assert {signal, second} == {"manifold_temperature_degc", "battery_voltage_v"}


def test_a_product_is_found_though_a_third_signal_explains_more_than_either_alone() -> None:
    # GIVEN a mixture that goes with load times speed, as the air flow nearly does
    def product(path: Path, signals: dict[str, FloatArray]) -> Path:
        load, speed = signals["air_mass_mg"] / 370.0, signals["engine_speed_rpm"] / 1900.0
        return replace(path, factor=path.factor * (1.0 + 0.05 * (load - 0.75) * speed))

    # WHEN a formula is looked for
    (term,) = found(product)
    # THEN its two signals are load and speed
    _, signal, _, _, _, second, *_ = term.name.split(":")
    assert {signal, second} == {"air_mass_mg", "engine_speed_rpm"}


def test_where_no_form_gains_on_held_out_blocks_there_is_no_formula(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # GIVEN forms that all lose on blocks that their fit did not see
    monkeypatch.setattr("training.healthy.scoring.score", lambda *_: Score(-1.0, 0.0))
    assert found(warm_intake) == ()


NAMES = {form: name_of("manifold_pressure_kpa", form, 70.0, 20.0) for form in FORMS}
GROWING = growing(NAMES["bump"], "engine_speed_rpm", 2000.0, 1000.0)


@pytest.mark.parametrize("name", [*(NAMES[form] for form in FORMS if form != "factor"), GROWING])
def test_arrays_and_graph_of_a_formula_agree(name: str) -> None:
    graph_agrees(effect_of(name))


def test_a_formula_reads_as_one() -> None:
    name = name_of("rail_pressure_mpa", "slow", 10.0, 4.0)
    assert formula(name, [1.0, 2.0, 1.5]) == (
        "mixture × (1 + 1 % + 0.5 % per unit of (rail_pressure_mpa behind a lag of 1.5 s - 10))"
    )


@given(
    form=st.sampled_from(sorted(FORMS)),
    at=st.floats(-50.0, 200.0),
    width=st.floats(0.5, 100.0),
    share=st.floats(0.0, 1.0),
)
def test_every_formula_can_be_read_again_and_leaves_a_mixture(
    form: str, at: float, width: float, share: float
) -> None:
    # GIVEN a form with constants anywhere within their limits
    path, signals = base_path(BASE, PLAIN), PLAIN
    name = name_of("manifold_pressure_kpa", form, at, width)
    effect = effect_of(name)
    values = [p.low + share * (p.high - p.low) for p in effect.parameters]
    # THEN the mixture stays finite and not negative, and the formula names the signal
    changed = effect.apply(path, np.array(values), signals, 0.1)
    mixture = changed.fuel_mg * changed.factor / changed.air_mg
    assert np.isfinite(mixture).all()
    assert (mixture >= 0.0).all()
    assert "manifold_pressure_kpa" in formula(name, values)
    # AND a name with a colon, as a log's column may have, is read again
    over, *_, growth = parts_of(growing(name_of("flap:angle", form, at, width), "a:b", at, width))
    assert (over.signal, growth) == ("flap:angle", ("a:b", *over[1:]))


@pytest.mark.parametrize(
    "name",
    ["empirical:x", "empirical:x:cube:1:1", "empirical:x:mass:a:1", "empirical:x:mass:1:1:y"],
)
def test_a_name_that_says_no_formula_is_refused(name: str) -> None:
    with pytest.raises(ModelError, match="no empirical effect"):
        effect_of(name)


def by_pressure(form: str, *values: float) -> tuple[FloatArray, FloatArray]:
    """Return the pressure, and how many times as rich a formula about 70 kPa makes the mixture."""
    path, signals = base_path(BASE, PLAIN), PLAIN
    effect = effect_of(name_of("manifold_pressure_kpa", form, 70.0, 10.0))
    changed = effect.apply(path, np.array(values), signals, 0.1)
    return signals["manifold_pressure_kpa"], changed.factor / path.factor


def test_a_curve_is_constant_beyond_its_knots() -> None:
    kpa, ratio = by_pressure("curve", 1.0, 0.0, 0.0, 0.0, 3.0)
    np.testing.assert_allclose(ratio[kpa > 80.0], 1.03)
    np.testing.assert_allclose(ratio[kpa < 60.0], 1.01)


def test_a_bend_is_level_up_to_its_place_and_straight_beyond_it() -> None:
    # GIVEN a bend at 75 kPa, with 2 % per u of 10 kPa above it
    kpa, ratio = by_pressure("bend", 0.0, 0.0, 2.0, 0.5)
    # THEN the mixture is richer by 0.2 % per kPa beyond it, up to the end of the line
    np.testing.assert_allclose(ratio, 1.0 + 0.002 * np.clip(kpa - 75.0, 0.0, 25.0))


def test_a_bend_begins_at_the_corner_of_a_curve_and_an_exponential_with_its_rate() -> None:
    assert _place_of("bend", np.array([1.0, 1.0, 1.0, 2.0, 3.0])) == pytest.approx(0.0, abs=0.2)
    knots = np.linspace(-1.0, 1.0, 5)
    assert _rate_of(1.0 + 3.0 * np.exp(2.0 * knots)) == 2.0


def test_flags_answers_and_what_differs_between_drives_alone_are_no_functions() -> None:
    drives = []
    for i, drive in enumerate((noisy_drive(1), noisy_drive(2))):
        more = {
            "ambient_temperature_degc": np.full(len(drive), 10.0 * i),
            "lambda_controller": 1.0 + 0.01 * np.sin(np.arange(len(drive))),
            "closed_loop": (np.arange(len(drive)) % 100 > 50).astype(float),
        }
        drives.append(replace(drive, signals=dict(drive.signals) | more))
    found = {function.signal for function in functions_of(drives)}
    assert {"engine_speed_rpm", "coolant_temperature_degc"} <= found
    assert not found & {*more, "ambient_pressure_kpa", "fuel_mass_mg"}
