"""What no effect of the library explains, as the plain function that it is most like."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from monitor.base.types import FloatArray
from tests.helpers.gap.gap_drives import PERIOD_S, plain_signals
from tests.helpers.gap.gap_simulated import known, two_drives
from training.gap.name.formulas.description import ANSWERS, describe
from training.gap.name.formulas.feature_words import _WORDS, words_of
from training.gap.name.formulas.signal_functions import functions_of
from training.greybox.chain import Constants, Path, base_path, simulate
from training.greybox.fit.drive import ChainDrive, make
from training.healthy.base_state import base_state
from training.healthy.features import features

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


def described(change: Change) -> str:
    return describe(base_state([made(change, seed) for seed in (1, 2)], None, BASE))


def unchanged(path: Path, signals: dict[str, FloatArray]) -> Path:
    return path


def volts(path: Path, signals: dict[str, FloatArray]) -> Path:
    more_mg = -0.3 * (signals["battery_voltage_v"] - 13.9) * (path.fuel_mg > 0.0)
    return replace(path, fuel_mg=path.fuel_mg + more_mg)


def simulated(effect: str) -> str:
    return describe(base_state(two_drives(2_200_300, (effect, 4.0)), known(), known().base))


def test_noise_alone_is_like_no_function() -> None:
    assert described(unchanged).startswith("No plain function")


def test_injections_that_follow_a_voltage_are_described_by_it() -> None:
    # GIVEN injections that give 0.3 mg less per volt above 13.9 V
    assert "goes most with (battery voltage - 13.9 V), as fuel" in described(volts)


def test_an_injector_s_voltage_is_described_though_no_effect_of_the_library_has_it() -> None:
    # GIVEN the plant's injectors giving 0.28 mg per volt less, inside the control loop
    assert "goes most with (battery voltage - 14" in simulated("battery_voltage")


def test_a_resonance_of_the_intake_is_described_by_its_speed() -> None:
    # GIVEN more charge around 1,850 rpm than the ECU knows
    at = simulated("intake_resonance").partition("goes most with engine speed around ")[2]
    assert float(at.split(" ")[0].replace(",", "")) == pytest.approx(1850.0, abs=100.0)


def test_vapour_from_the_oil_is_described_beside_what_it_cannot_be_told_from() -> None:
    words = simulated("oil_dilution")
    assert words.count(", or ") == 2
    assert "as fuel" in words


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
