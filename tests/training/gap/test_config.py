"""The numbers of the gap workflow and of the healthy behaviour: one file each, all of it read."""

import json
import tomllib
from dataclasses import asdict
from importlib.resources import files

import pytest

from training.gap.config import CONFIG
from training.healthy.config import CONFIG as HEALTHY


@pytest.mark.parametrize(
    ("package", "config"), [("training.gap", CONFIG), ("training.healthy", HEALTHY)]
)
def test_every_number_of_the_file_is_read_and_no_other(package: str, config: object) -> None:
    tree = tomllib.loads(files(package).joinpath("default.toml").read_text())
    assert json.loads(json.dumps(asdict(config))) == tree  # type: ignore[call-overload]


def test_a_number_is_of_the_type_that_its_section_declares() -> None:
    for section in CONFIG.__annotations__:
        part = getattr(CONFIG, section)
        for key, kind in part.__annotations__.items():
            value = getattr(part, key)
            if kind in (int, float):
                assert type(value) is kind, f"[{section}] {key} = {value!r}"
