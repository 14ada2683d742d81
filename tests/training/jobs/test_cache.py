"""Files that later runs use again, and the code of a run."""

import os
from pathlib import Path

import pytest

from training.jobs import cache
from training.jobs.cache import cached
from training.jobs.run_folder import code_sha256


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give an empty cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def test_every_identity_has_a_place_of_its_own() -> None:
    one, again, other = (cached("numbers", {"model": m}) for m in ("a", "a", "b"))
    assert one == again != other


def test_the_oldest_files_go(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "KEPT", 2)
    for i in range(4):
        path = cached("numbers", i)
        assert path is not None
        path.write_text("")
        os.utime(path, (i, i))
    cached("numbers", 4)
    assert sorted(int(p.stat().st_mtime) for p in (home / "o2-monitor/numbers").iterdir()) == [2, 3]


def test_where_nothing_can_be_written_there_is_no_place(home: Path) -> None:
    home.write_text("a file where the folder should be")
    assert cached("numbers", 1) is None


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
