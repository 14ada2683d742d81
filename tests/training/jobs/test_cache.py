"""Files that later runs use again."""

import os
from pathlib import Path

import pytest

from training.jobs import cache
from training.jobs.cache import cached


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
