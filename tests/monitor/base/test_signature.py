"""A function's signature as a command: every value comes back as it was given."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.signature import REPEATED, _help, add_command


@dataclass(frozen=True, kw_only=True)
class Tank:
    """A group of options.

    fuel_l : litres in
        the tank
    """

    fuel_l: float = 1.5


@dataclass(frozen=True, kw_only=True)
class FullTank(Tank):
    """A group with those of its base.

    cap : whether 100 % are in
    """

    cap: Annotated[bool, "--closed"] = False


def drive(
    logs: Annotated[Sequence[Path], paths.read, "LOG"],
    *,
    gears: Sequence[int] = (1, 2),
    note: Annotated[Sequence[str], REPEATED, "TEXT"] = (),
    road: Literal["dry", "wet"] = "dry",
    out: Annotated[Path, paths.written, "FILE"],
    stop_s: Annotated[float | None, "S"] = None,
    tank: FullTank,
    rest: argparse.Namespace,
) -> dict[str, Any]:
    """Drive somewhere.

    The second sentence.

    logs : drives to repeat
    gears : gears in use
    stop_s : time of a stop (default: at the end)
    Raises nothing.
    """
    return dict(locals())


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser()
    add_command(made, drive, "examples: none", also_written="beside")
    return made


def called(*words: str) -> Any:
    args = parser().parse_args(words)
    return args.func(args)


def test_what_is_not_given_has_the_default_of_the_signature() -> None:
    values = called("a.log", "b.log", "--out", "c.csv")
    rest = values.pop("rest")
    assert values == {
        "logs": [Path("a.log"), Path("b.log")],
        "gears": [1, 2],
        "note": [],
        "road": "dry",
        "out": Path("c.csv"),
        "stop_s": None,
        "tank": FullTank(fuel_l=1.5, cap=False),
    }
    assert rest.also_written == "beside"
    assert vars(rest).keys() >= {"logs", "fuel_l", "cap"}


WORDS = st.text("abc xyz", min_size=1).filter(lambda text: text.strip() == text)


@given(
    st.lists(st.integers(0, 9), min_size=1),
    st.lists(WORDS),
    st.sampled_from(["dry", "wet"]),
    st.none() | st.floats(0, 1e9),
    st.booleans(),
)
def test_every_given_value_reaches_the_function(
    gears: list[int], notes: list[str], road: str, stop_s: float | None, cap: bool
) -> None:
    words = ["a.log", "--gears", *map(str, gears), "--road", road, "--out", "c.csv"]
    words += [word for note in notes for word in ("--note", note)]
    words += ["--stop-s", repr(stop_s)] if stop_s is not None else []
    words += ["--closed"] if cap else []
    values = called(*words)
    assert (values["gears"], values["note"], values["road"]) == (gears, notes, road)
    assert (values["stop_s"], values["tank"]) == (stop_s, FullTank(cap=cap))


@pytest.mark.parametrize(
    "words",
    [
        ("a.log",),
        ("--out", "c.csv"),
        ("a.log", "--out", "c.csv", "--road", "icy"),
        ("a.log", "--out", "c.csv", "--gears", "first"),
        ("a.log", "--out", "c.csv", "--cap"),
    ],
)
def test_what_the_signature_does_not_allow_is_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit):
        called(*words)


def test_the_help_is_the_docstring_and_says_the_defaults() -> None:
    text = parser().format_help()
    assert "Drive somewhere.\nThe second sentence.\n" in text
    assert text.endswith("examples: none\n")
    lines = " ".join(text.split())
    for line in (
        "LOG drives to repeat",
        "--gears GEARS [GEARS ...] gears in use (default: 1 2)",
        "--stop-s S time of a stop (default: at the end)",
        "--fuel-l FUEL_L litres in the tank (default: 1.5)",
        "--closed whether 100 % are in",
    ):
        assert line in lines
    assert "Raises" not in text
    assert [_help("full", default) for default in (False, None, (), "")] == ["full"] * 4


def test_the_options_of_a_class_stand_before_those_of_its_bases() -> None:
    names = [action.dest for action in parser()._actions]
    assert names.index("cap") < names.index("fuel_l")


def test_the_role_of_a_file_is_the_type_of_its_option() -> None:
    types = {action.dest: action.type for action in parser()._actions}
    assert (types["logs"], types["out"]) == (paths.read, paths.written)
