"""What no effect of the library explains, as a formula of few plain functions."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from tests.helpers.gap.gap_simulated import known, two_drives
from training.gap.name.formulas.description import ANSWERS, Description, describe
from training.gap.name.formulas.feature_words import _WORDS, words_of
from training.gap.name.formulas.signal_functions import functions_of
from training.greybox.chain import Constants, Path, base_path, simulate
from training.greybox.fit.drive import ChainDrive, make
from training.healthy.base_state import base_state
from training.healthy.features import features
from training.pages.numbers import percent

BASE = Constants(
    gain=1.0, dead_time_s=0.15, dead_time_revolutions=1.5, mixing_s=0.06, sensor_s=0.1, span=1.0
)
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


def described(change: Change) -> Description:
    return describe(base_state([made(change, seed) for seed in (1, 2)], None, BASE))


def unchanged(path: Path, signals: dict[str, FloatArray]) -> Path:
    return path


def volts(path: Path, signals: dict[str, FloatArray]) -> Path:
    more_mg = -0.3 * (signals["battery_voltage_v"] - 13.9) * (path.fuel_mg > 0.0)
    return replace(path, fuel_mg=path.fuel_mg + more_mg)


def volts_and_speed(path: Path, signals: dict[str, FloatArray]) -> Path:
    factor = 1.0 + 1e-5 * (signals["engine_speed_rpm"] - 1900.0)
    return replace(volts(path, signals), factor=path.factor * factor)


def simulated(effect: str) -> Description:
    return describe(base_state(two_drives(2_200_300, (effect, 4.0)), known(), known().base))


def test_noise_alone_has_no_formula() -> None:
    found = described(unchanged)
    assert found.terms == ()
    assert found.share == 0.0
    assert found.sentence.startswith("No plain function")


def test_a_known_formula_is_found_with_its_coefficient_and_unit() -> None:
    # GIVEN injections that give 0.3 mg less per volt above 13.9 V
    term, *others = described(volts).terms
    # THEN that is the one term
    assert others == []
    assert term.name.startswith("battery_voltage_v mass")
    assert term.unit == "mg/stroke per V"
    assert term.coefficient == pytest.approx(-0.3, abs=3.0 * term.standard_error)
    assert term.standard_error < 0.02
    assert term.share > 0.9


def test_two_parts_of_a_formula_are_found_one_after_the_other() -> None:
    found = described(volts_and_speed)
    by_name = {term.name.split()[0]: term for term in found.terms[:2]}
    assert list(by_name) == ["battery_voltage_v", "engine_speed_rpm"]
    speed = by_name["engine_speed_rpm"]
    assert speed.unit == "% of the mixture per 1/min"
    assert speed.coefficient == pytest.approx(1e-3, abs=3.0 * speed.standard_error)
    assert found.terms[0].share > found.terms[1].share
    assert sum(term.share for term in found.terms) == pytest.approx(found.share)
    assert found.share <= 1.0
    assert f"{percent(found.share)} of what can be explained" in found.sentence
    assert all(term.words in found.sentence for term in found.terms)


def test_an_injector_s_voltage_is_described_though_no_effect_of_the_library_has_it() -> None:
    # GIVEN the plant's injectors giving 0.28 mg per volt less, inside the control loop
    found = simulated("battery_voltage")
    assert found.terms[0].name.startswith("battery_voltage_v mass")
    assert found.terms[0].coefficient == pytest.approx(-0.28, abs=0.08)
    assert "mg/stroke per V × (battery voltage - 14" in found.sentence


def test_a_resonance_of_the_intake_is_described_by_its_speed() -> None:
    # GIVEN more charge around 1,850 rpm than the ECU knows
    term = simulated("intake_resonance").terms[0]
    assert term.words.startswith("engine speed around 1,")
    assert float(term.name.removeprefix("engine_speed_rpm about ")) == pytest.approx(
        1850.0, abs=100.0
    )
    assert term.unit == "% of the mixture"
    assert -4.0 < term.coefficient < -1.0


def test_vapour_from_the_oil_is_described_as_what_it_cannot_be_told_from() -> None:
    term = simulated("oil_dilution").terms[0]
    assert 0.4 < term.share < 0.9
    assert len(term.or_else) == 2
    assert "as fuel" in term.text


def test_every_plain_function_has_its_words_and_no_words_lie_idle() -> None:
    drive = made(unchanged, 1)
    signals = dict(drive.signals) | {"lambda_controller": np.ones(len(drive))}
    path = base_path(BASE, signals)
    names = features(replace(drive, signals=signals), path, drive.phi_measured)
    assert len({words_of(name) for name in names}) == len(names)
    assert set(_WORDS) <= set(names)
    assert set(ANSWERS) <= set(names)
    with pytest.raises(KeyError, match="tide"):
        words_of("tide 1")


def test_flags_answers_and_what_differs_between_drives_alone_are_no_functions() -> None:
    drives = [made(unchanged, seed) for seed in (1, 2)]
    weather = [
        replace(
            d,
            signals=dict(d.signals)
            | {
                "ambient_temperature_degc": np.full(len(d), 10.0 * i),
                "lambda_controller": 1.0 + 0.01 * np.sin(np.arange(len(d))),
                "closed_loop": (np.arange(len(d)) % 100 > 50).astype(float),
            },
        )
        for i, d in enumerate(drives)
    ]
    found = {function.signal for function in functions_of(weather)}
    assert {"battery_voltage_v", "engine_speed_rpm", "coolant_temperature_degc"} <= found
    assert not found & {
        "ambient_temperature_degc",
        "ambient_pressure_kpa",
        "lambda_controller",
        "closed_loop",
        "fuel_mass_mg",
    }
