"""The numbers of the gap workflow: one file, all of it read."""

import tomllib
from dataclasses import asdict
from importlib.resources import files

import pytest

from training.gap.config import CONFIG, ErrorAloneConfig
from training.healthy.config import CONFIG as HEALTHY


def test_every_number_of_the_file_is_read_and_no_other() -> None:
    tree = tomllib.loads(files("training.gap").joinpath("default.toml").read_text())
    read = {
        name: {k: list(v) if isinstance(v, tuple) else v for k, v in section.items()}
        for name, section in asdict(CONFIG).items()
    }
    assert read == tree


def test_a_number_is_of_the_type_that_its_section_declares() -> None:
    for section in CONFIG.__annotations__:
        part = getattr(CONFIG, section)
        for key, kind in part.__annotations__.items():
            value = getattr(part, key)
            if kind in (int, float):
                assert type(value) is kind, f"[{section}] {key} = {value!r}"


def test_an_unknown_number_is_refused() -> None:
    with pytest.raises(TypeError, match="worse"):
        ErrorAloneConfig(same_correlation=1.0, lean_phi=0.7, before_cut_s=1.0, worse=2.0)  # type: ignore[call-arg]


def test_the_numbers_of_the_healthy_behaviour_are_those_of_their_file() -> None:
    tree = tomllib.loads(files("training.healthy").joinpath("default.toml").read_text())
    assert {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(HEALTHY).items()} == tree
