"""Values of a run as files: what was stored comes back, and nothing else can come out."""

import ast
import json
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest

from monitor.base.types import BoolArray, FloatArray
from tests.conftest import ROOT
from training.greybox.chain import Constants
from training.greybox.effects import LIBRARY
from training.greybox.effects.form.air_meter import following
from training.greybox.fit.case import NAMED
from training.greybox.fit.joint import Fit
from training.greybox.fit.sensor_faults import FAULTS
from training.jobs import values
from training.jobs.checkpoints import Checkpoints
from training.jobs.values import ValuesError

# Processes of one user send each other objects; nothing of them is kept in a folder.
BETWEEN_PROCESSES = {"training/jobs/cluster.py"}


class Edge(NamedTuple):
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Part:
    """A value with every kind of field that stages hold."""

    says: Literal["one", "two"]
    count: int
    on: bool
    share: float
    where: Path
    edge: Edge
    maybe: float | None
    either: Edge | str
    table: Mapping[str, tuple[str, ...]]
    pairs: tuple[tuple[str, FloatArray], ...]
    mask: BoolArray


PART = Part(
    says="two",
    count=3,
    on=True,
    share=float("inf"),
    where=Path("a/b"),
    edge=Edge(0.1, -0.0),
    maybe=None,
    either="text",
    table={"a": ("b", "c")},
    pairs=(("x", np.array([0.1, np.nan])), ("y", np.zeros((0, 2)))),
    mask=np.array([True, False]),
)


def alike(a: Any, b: Any) -> bool:
    """Return whether two values are equal, arrays by their content."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if hasattr(a, "__dataclass_fields__"):
        return all(alike(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, tuple):
        same = type(a) is type(b) and len(a) == len(b)
        return same and all(map(alike, a, b))
    return type(a) is type(b) and repr(a) == repr(b)


def test_a_value_comes_back_as_it_was(tmp_path: Path) -> None:
    for part in (PART, replace(PART, either=Edge(1.0, 2.0), maybe=0.1, share=float("nan"))):
        values.save(tmp_path / "part.npz", part)
        assert alike(values.load(tmp_path / "part.npz", Part), part)


def test_effects_and_faults_come_back_by_name_with_what_differs(tmp_path: Path) -> None:
    # GIVEN a fit with an effect of the library, the same effect for another air meter, and a fault
    effect = LIBRARY["maf_offset"]
    terms = (effect, following(effect, 3.0), FAULTS[0])
    assert terms[0] != terms[1]
    fit = Fit(terms, Constants(), (np.ones(2),) * 3, *(np.zeros((2, 2)),) * 3, 1.0)
    # WHEN it is stored and read
    values.save(tmp_path / "fit.npz", fit, NAMED)
    # THEN the terms are the library's, functions included
    found = values.load(tmp_path / "fit.npz", Fit, NAMED)
    assert found.terms == terms
    assert alike(found, fit)


def test_an_object_that_stands_twice_is_one_object_again(tmp_path: Path) -> None:
    # GIVEN a value whose parts hold arrays, so that only identity can find one among others
    other = replace(PART, count=4)
    twice = ((PART, other), PART)
    kind = tuple[tuple[Part, ...], Part]
    values.save(tmp_path / "twice.npz", twice)
    (first, second), again = values.load(tmp_path / "twice.npz", kind)
    assert again is first
    assert again is not second
    assert (second.count, again.count) == (4, 3)


def test_a_value_with_code_inside_has_no_form(tmp_path: Path) -> None:
    for value in (len, np.array([len]), {1}, LIBRARY["maf_offset"]):
        with pytest.raises(TypeError, match="has no form in a file"):
            values.save(tmp_path / "x.npz", value)
    assert not list(tmp_path.iterdir())


class Boom:
    """Writes a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_a_folder_of_a_run_executes_nothing_and_its_stage_is_made_anew(tmp_path: Path) -> None:
    # GIVEN a folder of stages that somebody else made: pickled objects under the name of a stage
    run = Checkpoints.of(tmp_path / "stages", 1)
    assert run.done("name", int, lambda: 5) == 5
    (path,) = (tmp_path / "stages").iterdir()
    boom = Boom(tmp_path / "boom")
    with path.open("wb") as file:
        np.savez(file, tree=np.array([boom], dtype=object))
    hostile = [path.read_bytes(), pickle.dumps(boom), pickle.dumps(5), b"", b"PK\x03\x04"]
    for content in hostile:
        # WHEN the run goes on
        path.write_bytes(content)
        # THEN the stage is made anew, and nothing of the folder ran
        assert run.done("name", int, lambda: 6) == 6
        assert not boom.path.exists()


def test_a_damaged_file_of_a_run_is_refused_whatever_was_changed(tmp_path: Path) -> None:
    path = tmp_path / "part.npz"
    values.save(path, PART)
    good, draw = path.read_bytes(), np.random.default_rng(7)
    refused = 0
    for _ in range(300):
        bad = bytearray(good)
        bad[draw.integers(len(bad))] ^= 1 << draw.integers(8)
        path.write_bytes(bad if draw.random() < 0.7 else good[: draw.integers(len(good))])
        try:
            assert isinstance(values.load(path, Part), Part)
        except ValuesError as error:
            refused += 1
            assert "part.npz: is no stored Part" in str(error)
    assert refused > 100


def test_a_value_of_another_type_is_refused(tmp_path: Path) -> None:
    values.save(tmp_path / "x.npz", 1.5)
    for kind in (int, str, bool, Edge, Part, tuple[float, ...], Mapping[str, float], np.ndarray):
        with pytest.raises(ValuesError, match="is no stored"):
            values.load(tmp_path / "x.npz", kind)


@pytest.mark.parametrize("name", ["os.system", "pathlib.Path", "training.jobs.values.load", "os"])
def test_a_file_that_names_other_code_than_our_dataclasses_is_refused(
    tmp_path: Path, name: str
) -> None:
    tree = json.dumps({"is": name, "at": 0, "of": {}}).encode()
    np.savez(tmp_path / "x.npz", tree=np.frombuffer(tree, dtype=np.uint8))
    with pytest.raises(ValuesError, match=r"none of ours|has no form|issubclass"):
        values.load(tmp_path / "x.npz", Part)


UNSAFE = {"pickle", "cloudpickle", "dill", "shelve", "marshal", "read_pickle", "to_pickle"}


def unsafe_words(path: Path) -> set[str]:
    """Return the words in a file's code that read or write objects with code inside."""
    words = set[str]()
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.Import(names=names):
                words |= {each.name.split(".")[0] for each in names} & UNSAFE
            case ast.ImportFrom(module=str(module)):
                words |= {module.split(".")[0]} & UNSAFE
            case ast.Attribute(value=ast.Name(id="joblib" | "torch" as package), attr="load"):
                words.add(f"{package}.load")
            case ast.Attribute(attr=word):
                words |= {word} & UNSAFE
            case ast.keyword(arg="allow_pickle", value=value):
                allowed = not isinstance(value, ast.Constant) or bool(value.value)
                words |= {"allow_pickle"} if allowed else set()
    return words


def test_no_package_reads_pickled_objects_from_a_file() -> None:
    files = [path for package in ("monitor", "training") for path in (ROOT / package).rglob("*.py")]
    found = {path.relative_to(ROOT).as_posix() for path in files if unsafe_words(path)}
    assert found == BETWEEN_PROCESSES
