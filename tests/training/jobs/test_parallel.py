"""Jobs side by side on this machine; their code and what they may read."""

import ast
import os
import time
from pathlib import Path

import pytest

from tests.conftest import ROOT
from training.jobs import parallel, worker
from training.jobs.run_folder import code_sha256


def job(shared: int, item: int) -> int:
    """Add two numbers; a negative item kills the process."""
    if item < 0:
        time.sleep(0.2)  # so that the one before it is done
        os._exit(9)
    return shared + item


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_job_comes_back_under_its_key(jobs: int) -> None:
    items = {f"job {i}": i for i in range(9)}
    found = dict(parallel.run(job, 100, items.items(), jobs=jobs))
    assert found == {key: 100 + i for key, i in items.items()}


def test_a_job_whose_process_dies_is_named() -> None:
    jobs = [("good", 1), ("bad", -1)]
    with pytest.raises(worker.WorkerDiedError, match=r"a worker died.*bad") as died:
        list(parallel.run(job, 0, jobs, jobs=2))
    assert died.value.keys in (("bad",), ("good", "bad"))


# Processes of one user send each other objects; nothing of them is kept in a folder.
BETWEEN_PROCESSES = {"training/jobs/cluster.py"}
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


def test_the_code_of_a_run_is_another_after_a_change_of_any_source(tmp_path: Path) -> None:
    # GIVEN a folder of sources and numbers beside those of the product
    (tmp_path / "a.py").write_text("x = 1\n")
    (tmp_path / "numbers.toml").write_text("x = 1\n")
    found = [code_sha256(), code_sha256(tmp_path)]
    # WHEN one after the other changes THEN the digest does; other files do not count
    for name, text in (("a.py", "x = 2\n"), ("numbers.toml", "x = 2\n"), ("notes.txt", "")):
        (tmp_path / name).write_text(text)
        code_sha256.cache_clear()
        found.append(code_sha256(tmp_path))
    assert len(set(found)) == 4
    assert found[-1] == found[-2]
