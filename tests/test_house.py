"""The house stays small, its levels short and its names unique."""

import ast
import re
from collections import defaultdict
from pathlib import Path

from tests.house import ROOT, over, sizes

ENTRIES = 14  # at most on one level
QUIET = {"__init__.py", "__main__.py", "__pycache__", "py.typed"}
# One room for each layer of the import contract: their order is the reader's map.
ROOMS = {"monitor": 16, "tests/monitor": 16}


def test_no_level_of_the_house_has_more_entries_than_a_reader_can_hold() -> None:
    crowded = {
        place: len(entries)
        for folder in _folders()
        if len(entries := {each.name for each in folder.iterdir()} - QUIET)
        > ROOMS.get(place := folder.relative_to(ROOT).as_posix(), ENTRIES)
    }

    assert not crowded


def test_no_two_classes_of_the_product_have_one_name() -> None:
    places = defaultdict(list)
    for package in ("monitor", "training"):
        for file in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places[node.name].append(file.relative_to(ROOT).as_posix())

    assert not {name: files for name, files in places.items() if len(files) > 1}


def test_no_number_is_shown_to_a_reader_with_an_exponent() -> None:
    # "1e+02 %": a format of few digits; monitor.base.counts.plain shows 100
    rounds = re.compile(r'[:"+]\.[1-6]g["}]')
    ours = "float(f", "PREFIX", "{name}:{signal}", "text = f"  # values, names of effects, itself
    found = [
        f"{file.relative_to(ROOT)}:{number}"
        for package in ("monitor", "training")
        for file in sorted((ROOT / package).rglob("*"))
        if file.suffix in (".py", ".html")
        for number, line in enumerate(file.read_text("utf-8").splitlines(), 1)
        if rounds.search(line) and not any(each in line for each in ours)
    ]

    assert not found


def test_a_room_above_its_budget_is_reported_and_one_without_a_budget_too() -> None:
    assert over({"a": 2, "b": 1, "c": 1}, {"a": 1, "c": 1}) == [
        "house: a has 2, its budget in pyproject.toml is 1",
        "house: b has 1, its budget in pyproject.toml is 0",
    ]


def test_a_setting_with_bounds_counts_once(tmp_path: Path) -> None:
    settings = tmp_path / "monitor" / "default.toml"
    settings.parent.mkdir()
    (tmp_path / "training").mkdir()
    settings.write_text("[window]\nn = { value = 50, min = 10 }\nm = [1, 2]\n")

    assert sizes(tmp_path)["settings of monitor"] == 2


def _folders() -> list[Path]:
    tops = ("monitor", "training", "benchmarks", "dbc", "docs", "tests")
    below = [folder for top in tops for folder in (ROOT / top).rglob("*") if folder.is_dir()]
    return [each for each in (*(ROOT / top for top in tops), *below) if each.name not in QUIET]
