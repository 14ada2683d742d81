"""The numbers of the gap workflow and of the healthy behaviour have the types of their fields."""

from dataclasses import fields

from training.gap.config import CONFIG
from training.healthy.config import CONFIG as HEALTHY


def test_a_number_is_of_the_type_that_its_section_declares() -> None:
    for section in (HEALTHY, *(getattr(CONFIG, each.name) for each in fields(CONFIG))):
        for each in fields(section):
            value = getattr(section, each.name)
            if each.type in (int, float):
                assert type(value) is each.type, f"{section} {each.name} = {value!r}"
