"""Results that later runs use again."""

import os
from pathlib import Path

import pytest

from training.jobs import checkpoints
from training.jobs.checkpoints import Checkpoints


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Give an empty cache folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def test_a_result_is_made_once_for_each_identity() -> None:
    made: list[int] = []

    def make() -> int:
        made.append(1)
        return len(made)

    first = [Checkpoints.kept("numbers", {"model": "a"}).done("n", int, make) for _ in range(2)]
    other = Checkpoints.kept("numbers", {"model": "b"}).done("n", int, make)
    assert (first, other) == ([1, 1], 2)


def test_the_oldest_results_go(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoints, "KEPT", 2)
    for i in range(4):
        Checkpoints.kept("numbers", i).done("n", int, lambda i=i: i)
        for path in (home / "o2-monitor" / "numbers").iterdir():
            os.utime(path, (i, i)) if path.stat().st_mtime > 100 else None
    Checkpoints.kept("numbers", 3)
    assert sorted(int(p.stat().st_mtime) for p in (home / "o2-monitor/numbers").iterdir()) == [2, 3]


def test_where_nothing_can_be_written_every_result_is_made(home: Path) -> None:
    home.write_text("a file where the folder should be")
    assert Checkpoints.kept("numbers", 1).done("n", int, lambda: 5) == 5
