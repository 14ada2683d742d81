"""What was driven is written in time; a full or read-only disk costs nothing that was stored."""

import errno
import random
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from benchmarks.damage.killing.kills import assert_sound, loaded
from monitor.base.errors import RecordingError
from monitor.memory import block
from monitor.memory.block import Block
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import Saved
from monitor.memory.store import Memory
from monitor.pipeline.events import CutJudged, Event, Tick, WindowJudged
from monitor.pipeline.replay import Setup
from tests.conftest import ROOT
from tests.helpers.bus.played_bus import Ear, run_on
from tests.helpers.logs.replays import frames_of, replay_log


class Told(Ear):
    """Counts the events that are stored before they are told."""

    n = 0

    def push(self, event: Event) -> None:
        self.n += not isinstance(event, Tick | WindowJudged | CutJudged)


def test_what_is_driven_is_written_from_time_to_time_and_at_the_end(
    setup: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written_s = list[float]()
    save = Memory.save

    def noted(memory: Memory, saved: Saved) -> None:
        save(memory, saved)
        written_s.append(saved.counts.engine_run_since_clear_s)

    monkeypatch.setattr(Memory, "save", noted)
    monkeypatch.setattr("monitor.bus.judging.STORE_DRIVEN_S", 15.0)  # else a minute
    told = Told()
    with closing(Memory(tmp_path / "o2.db")) as memory:
        frames = frames_of("healthy_micro_trips", 60.0)
        recording, _ = run_on(frames, setup, memory=memory, attachments=[told])
        last_s = memory.load().counts.engine_run_since_clear_s
    assert not recording["dtcs"]
    gaps_s = [b - a for a, b in pairwise(written_s)]
    assert len(gaps_s) > 2 and max(gaps_s) < 15.0 + 2.0
    # and beside what is stored when it is told, and at the end, no more often
    assert told.n < len(written_s) <= told.n + 1 + last_s / 15.0
    assert written_s[-1] == last_s > recording["samples"] * 0.1 * 0.9


@contextmanager
def no_file_larger_than(n_bytes: int) -> Iterator[None]:
    """Let every write beyond a file's first so many bytes fail, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("hold", [False, True])
def test_a_full_disk_is_one_line_and_the_memory_stays(tmp_path: Path, *, hold: bool) -> None:
    path = tmp_path / "o2.db"
    with closing(Memory(path, hold=hold)) as memory:
        memory.save(Saved((Dtc("P0133", t_ns=1),)))
        with (
            no_file_larger_than(100),
            pytest.raises(RecordingError, match=r"o2\.db: cannot store the fault memory") as error,
        ):
            memory.save(Saved((Dtc("P0133", t_ns=2),)))
        assert "\n" not in str(error.value)
        assert memory.load().dtcs[0].t_ns == 1
        assert loaded(path).dtcs[0].t_ns == 1
        # WHEN there is room again THEN storing goes on
        memory.save(Saved((Dtc("P0133", t_ns=1000),)))
    assert loaded(path).dtcs[0].t_ns == 1000
    assert_sound(path)


def test_what_was_stored_is_in_both_files_whichever_writing_fails_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a disk on which writing fails at random
    path, rng, write = tmp_path / "o2.db", random.Random(3), block._replace

    def failing(file: Path, data: bytes) -> None:
        if rng.random() < 0.4:
            raise OSError(errno.ENOSPC, "No space left on device")
        write(file, data)

    with closing(Memory(path, hold=True)) as memory:
        monkeypatch.setattr(block, "_replace", failing)
        stored, tried, failures = Saved(), list[Saved](), 0
        for _ in range(200):
            # WHEN changes are stored, some of them taken back
            tried.append(Saved((Dtc("P0133", t_ns=rng.randrange(3)),)))
            try:
                memory.save(tried[-1])
                stored, tried = tried[-1], []
            except RecordingError:
                failures += 1
            # THEN each file alone holds what was stored last, or what was tried since
            found = [part.content for part in Block(path).parts]
            assert all(each and each.saved in (stored, *tried) for each in found)
            assert loaded(path) in (stored, *tried)
        assert 50 < failures < 150


def test_a_memory_that_cannot_be_made_on_a_full_disk_is_one_clear_line(tmp_path: Path) -> None:
    one_line = pytest.raises(RecordingError, match=r"o2\.db: cannot store the fault memory")
    with no_file_larger_than(0), one_line:
        Memory(tmp_path / "o2.db", hold=True)


def mounted(command: list[object], folder: Path, then: str) -> list[str]:
    """Return a command that runs with a small file system of its own on a folder, or skip."""
    unshare = shutil.which("unshare")
    own = [unshare or "unshare", "--user", "--map-root-user", "--mount"]
    mount = f"mount -t tmpfs -o size=192k tmpfs {folder}"
    if unshare is None or subprocess.run([*own, "sh", "-c", mount], check=False).returncode:
        pytest.skip("no file system can be mounted: user namespaces are not permitted")
    words = " ".join(map(str, command))
    return [*own, "sh", "-c", f"{mount} && {then} && exec {words}"]


@pytest.mark.parametrize("is_new", [True, False])
def test_a_read_only_file_system_is_one_line_and_exit_code_2(tmp_path: Path, is_new: bool) -> None:
    path = tmp_path / "o2.db"
    cli, log = [sys.executable, "-m", "monitor.cli"], replay_log("stuck_")
    command = [*cli, *(("replay", log) if is_new else ("dtc", "clear")), "--memory", path]
    make = f"{sys.executable} -m benchmarks.damage.killing.driven_memory make {path} && "
    then = f"{'' if is_new else make}mount -o remount,ro {tmp_path}"
    words = mounted(command, tmp_path, then)
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"o2mon: {path}: cannot open the fault memory")
