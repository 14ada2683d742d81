"""The configuration: a file changes what it names, and a mistake is an error that says where."""

import re
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import pytest

from monitor.base import config
from monitor.base.errors import ConfigError
from monitor.base.files.settings import ShippedSettings

SETTINGS = ShippedSettings("monitor.base")
SHIPPED = SETTINGS.values()
KEYS = [(section, key) for section, values in SHIPPED.items() for key in values]


def file_of(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "own.toml"
    path.write_text(text)
    return path


def refusal(tmp_path: Path, text: str) -> str:
    """Return the one line that refuses the file, after its path."""
    path = file_of(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        config.load(path)
    before, found, message = str(caught.value).partition(str(path))
    assert found, before
    assert "\n" not in message
    return message


def test_the_shipped_file_sets_every_key_and_nothing_else() -> None:
    shipped = config.load()
    for section in fields(config.Config):
        held = getattr(shipped, section.name)
        assert is_dataclass(held)
        assert [f.name for f in fields(held)] == list(SHIPPED[section.name])
    assert shipped.window.n_samples == 50
    assert shipped.response.lags_s == tuple(SHIPPED["response"]["lags_s"])


def test_a_partial_file_keeps_the_shipped_value_of_what_it_leaves_out(tmp_path: Path) -> None:
    own = config.load(file_of(tmp_path, "[enable]\ncoolant_min_degc = 40\n[bias]\nn_windows = 5\n"))
    shipped = config.load()
    enable = replace(shipped.enable, coolant_min_degc=40.0)
    assert own == replace(shipped, enable=enable, bias=replace(shipped.bias, n_windows=5))


IMPOSSIBLE = (
    ("enable", "engine_speed_max_rpm", "900.0"),
    ("enable", "manifold_pressure_max_kpa", "18.0"),
    ("response", "lags_s", "[]"),
    ("response", "lags_s", "[0.2, 0.0]"),
    ("response", "lags_s", '[0.2, "0.3"]'),
    ("response", "lags_s", "[0.2, true]"),
    ("response", "lags_s", "[0.1, 0.2]"),
    ("response", "delays_s", "[0.1, 0.25]"),
    ("response", "gain_weak_max", "0.8"),
    ("response", "gain_least", "0.0"),
    ("response", "gain_least", "0.7"),
    ("catalyst", "position", '"behind"'),
    ("debounce", "response_fail", "128"),
    ("obd", "profile", '"obd3"'),
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[window]\nn_sample = 50\n", r"\[window\].*n_sample .*n_samples"),
        ("[windows]\nn_samples = 50\n", r"\[windows\].*\bwindow\b"),
        ("window = 50\n", "window"),
        ("[window\nn_samples = 50\n", "TOML"),
        *((f"[{s}]\n{k} = {v}\n", rf"\[{s}\].*{k}") for s, k, v in IMPOSSIBLE),
    ],
)
def test_what_is_wrong_is_told_with_section_and_key(tmp_path: Path, text: str, words: str) -> None:
    assert re.search(words, refusal(tmp_path, text))


@pytest.mark.parametrize("value", ['"50"', "true", "{ a = 1 }", "1979-05-27"])
def test_a_value_of_the_wrong_type_is_refused(tmp_path: Path, value: str) -> None:
    for section, key in KEYS:
        assert f"[{section}] {key}" in refusal(tmp_path, f"[{section}]\n{key} = {value}\n")


def test_a_count_is_a_whole_number(tmp_path: Path) -> None:
    counts = [(s, k) for s, k in KEYS if type(SHIPPED[s][k]) is int]
    assert ("window", "n_samples") in counts
    for section, key in counts:
        assert f"[{section}] {key}" in refusal(tmp_path, f"[{section}]\n{key} = 50.5\n")


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", f"1{'0' * 400}"])
def test_a_value_that_is_no_finite_number_is_refused(tmp_path: Path, value: str) -> None:
    for section, key in KEYS:
        listed = f"[{value}]" if isinstance(SHIPPED[section][key], list) else value
        assert f"[{section}] {key}" in refusal(tmp_path, f"[{section}]\n{key} = {listed}\n")


def test_every_number_beyond_its_bounds_is_refused(tmp_path: Path) -> None:
    for section, settings in SETTINGS.sections.items():
        for key, setting in settings.items():
            listed = isinstance(setting.value, list)
            if isinstance((setting.value or [""])[0] if listed else setting.value, str):
                continue
            below = 0 if setting.min is None else setting.min - 1
            for number in (below, setting.max + 1):
                value = repr(int(number) if number == int(number) else number)
                message = refusal(
                    tmp_path, f"[{section}]\n{key} = {f'[{value}]' if listed else value}\n"
                )
                assert f"[{section}] {key} = " in message
                assert f"at most {setting.max:g}" in message


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [
        ("window", "n_samples", "10"),
        ("enable", "fuel_cut_recovery_s", "0.0"),
        ("enable", "coolant_min_degc", "-40.0"),
        ("response", "gain_memory", "1.0"),
        ("response", "lags_s", "[0.5]"),
        ("debounce", "response_fail", "127"),
        ("debounce", "response_fail", "1"),
        ("bias", "n_windows", "1"),
    ],
)
def test_a_value_on_a_boundary_is_taken(tmp_path: Path, section: str, key: str, value: str) -> None:
    own = config.load(file_of(tmp_path, f"[{section}]\n{key} = {value}\n"))
    held = getattr(getattr(own, section), key)
    assert held == (tuple(tomllib.loads(f"x={value}")["x"]) if "[" in value else float(value))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml: cannot read the settings: No such file"):
        config.load(tmp_path / "nowhere.toml")
