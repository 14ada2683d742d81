"""A fleet judged: the verdicts of a replay, memory over a vehicle's drives, bad files, resuming."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import polars as pl
import pytest
from asammdf import MDF, Signal

from monitor.base import config
from monitor.base.errors import UsageError
from monitor.base.files.manifest import sha256_of
from monitor.cli import main as o2mon
from monitor.memory.store import Memory
from monitor.pipeline import replay
from tests.conftest import ROOT
from tests.helpers.drives import fleet_drives
from tests.helpers.drives.fleet_drives import (
    DELAYED,
    HEALTHY,
    LOGS,
    Tables,
    assert_alike,
    close,
    judged,
    write_piece,
)
from training.cli import main
from training.fleet import columns
from training.fleet import run as fleet
from training.fleet.drives import chunks_of, drives_of
from training.fleet.judging import judge_chunk
from training.fleet.worker_kit import WorkerKit

MODEL = str(replay.shipped_model())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet") / "drives"
    fleet_drives.small_fleet(folder)
    return folder


@pytest.fixture(scope="module")
def local(folder: Path) -> Tables:
    return judged([str(folder)], folder.parent / "local.parquet")


def manifest_of(folder: Path, head: str, *rows: object) -> str:
    """Write a manifest; return its path."""
    path = folder / "manifest.csv"
    path.write_text("\n".join([head, *map(str, rows)]) + "\n")
    return str(path)


def assert_as_replayed(row: dict[str, Any], windows: pl.DataFrame, found: dict[str, Any]) -> None:
    own = windows.filter(pl.col("recording") == row["recording"])
    assert row["samples"] == found["samples"]
    assert round(row["enabled_s"] * 10) == found["enabled_samples"]
    assert row["codes"] == [dtc["code"] for dtc in found["dtcs"]]
    assert row["faults"] == [dtc["fault"] for dtc in found["dtcs"]]
    assert row["states"] == [dtc["state"] for dtc in found["dtcs"]]
    assert row["completed"] == found["completed"]
    assert own["verdict"].to_list() == [w["verdict"] for w in found["windows"]]
    assert own["fault"].to_list() == [w["fault"] for w in found["windows"]]
    for name in ("mean", "std", "t_start_s", "t_end_s"):
        assert close(own[name].to_list(), [w[name] for w in found["windows"]])
    for name in ("evidence", "offset", "gain", "lag_rich_to_lean_s"):
        assert close(own[name].to_list(), [w["statistics"][name] for w in found["windows"]])
    for name in ("offset_low", "offset_high"):
        assert close(row[name], found["limits"][name])


def test_a_fleet_has_the_verdicts_of_a_replay_with_a_memory_for_each_vehicle(
    setup: replay.Setup, tmp_path: Path
) -> None:
    # GIVEN tables of a vehicle that learns its reference and whose sensor then fails, and a log
    names = [HEALTHY, HEALTHY, DELAYED, DELAYED, HEALTHY]
    own = [write_piece(tmp_path / f"v1_{i}.csv", n, 0, 3000 - i) for i, n in enumerate(names)]
    lines = [*(f"{path.name},first" for path in own[:3]), f"{LOGS / DELAYED},second"]
    lines += [f"{path.name},first" for path in own[3:]]
    with closing(Memory(tmp_path / "memory.sqlite")) as memory:
        replayed = [replay.replay(path, setup, memory)[0] for path in own]
    # WHEN the manifest is judged
    manifest = manifest_of(tmp_path, "path,vehicle", *lines)
    rows, windows = judged([manifest], tmp_path / "out.parquet")
    # THEN codes, states and limits follow from drive to drive as with --memory, windows as well
    first = rows.filter(pl.col("vehicle") == "first")
    for row, found in zip(first.to_dicts(), replayed, strict=True):
        assert_as_replayed(row, windows, found)
    assert first["reference_drives"].to_list() == [0, 1, 2, 2, 2]
    told = [states[:1] for states in first["states"].to_list()]
    assert told == [[], [], ["pending"], ["confirmed"], ["confirmed"]]
    # AND those of the log, and what was counted in it, are those of a replay of it alone
    (log,) = rows.filter(pl.col("vehicle") == "second").to_dicts()
    found, _ = replay.replay(LOGS / DELAYED, setup)
    assert_as_replayed(log, windows, found)
    for name in ("windows_interrupted", "sha256", "source"):
        assert log[name] == found[name]
    counted = {column: found["counters"][name] for column, name in columns.COUNTERS.items()}
    assert {column: log[column] for column in counted} == counted


def test_a_copied_drive_counts_once(tmp_path: Path) -> None:
    # GIVEN a late drive, its copy under the same vehicle, and one under another vehicle
    paths = [write_piece(tmp_path / "0.csv", DELAYED, 0, 3000)]
    paths += [Path(shutil.copy(paths[0], tmp_path / f"{i}.csv")) for i in (1, 2)]
    paths.append(write_piece(tmp_path / "3.csv", HEALTHY, 0, 3000))
    lines = [f"{path.name},{vehicle}" for path, vehicle in zip(paths, "aabb", strict=True)]
    manifest = manifest_of(tmp_path, "path,vehicle", *lines)
    # WHEN the fleet is judged
    rows, windows = judged([manifest], tmp_path / "out.parquet")
    # THEN one drive has the code, no copy confirms it, and the copies say of what they are one
    rows = rows.sort("recording")
    assert rows["states"].to_list() == [["pending"], None, None, []]
    told = [None, *(f"{p}: the same content as {paths[0]}, which counts" for p in paths[1:3]), None]
    assert rows["error"].to_list() == told
    assert sorted(set(windows["recording"])) == [0, 3]
    assert rows["windows"].to_list()[1:3] == [None, None]


def test_a_bad_file_is_a_row_with_its_reason(tmp_path: Path, folder: Path) -> None:
    # GIVEN files that cannot be read or judged among good ones
    good = next(folder.glob("*.parquet"))
    bad = tmp_path / "bad"
    bad.mkdir()
    shutil.copy(good, bad / "good.parquet")
    (bad / "empty.log").write_bytes(b"")
    damaged = bytearray((LOGS / HEALTHY).read_bytes())
    damaged[50_000] ^= 0x10
    (bad / "damaged.blf").write_bytes(damaged)
    (bad / "words.csv").write_text("time_s,lambda_measured\n0,one\n1,two\n")
    (bad / "other.csv").write_text("time_s,speed\n" + "".join(f"{k / 10},1\n" for k in range(99)))
    blank = pl.read_parquet(good).with_columns(pl.lit(None, pl.Float64).alias("maf_kg_h"))
    blank.write_parquet(bad / "blank.parquet")
    blank.drop("maf_kg_h").write_parquet(bad / "lacking.parquet")
    blank[::10].write_parquet(bad / "slow.parquet")
    with MDF() as measured:
        measured.append(Signal(np.arange(99.0), np.arange(99) / 10, name="engine_speed_rpm"))
        measured.save(bad / "lacking.mf4")
    (bad / "noise.parquet").write_bytes(b"PAR1 and nothing else")
    wanted = {
        "blank.parquet": "no number in column maf_kg_h",
        "damaged.blf": "damaged or cut short",
        "empty.log": "the log is empty",
        "gone.log": "No such file",
        "lacking.mf4": "there are engine_speed_rpm",
        "lacking.parquet": "the model needs maf_kg_h",
        "noise.parquet": "cannot read the table",
        "other.csv": "the model needs",
        "slow.parquet": "samples every 1 s, the model needs them every 0.1 s",
        "words.csv": "a number is wanted",
    }
    # WHEN they are judged
    manifest = manifest_of(tmp_path, "path", *sorted(bad.iterdir()), bad / "gone.log")
    rows, windows = judged([manifest], tmp_path / "out.parquet")
    # THEN each has a row that names it and says why, and the good one is judged
    failed = {Path(r["path"]).name: r for r in rows.to_dicts() if r["error"] is not None}
    assert sorted(failed) == sorted(wanted)
    for name, reason in wanted.items():
        assert failed[name]["error"].startswith(failed[name]["path"])
        assert reason in failed[name]["error"]
        assert failed[name]["windows"] is None
    assert set(windows["path"]) == {str(bad / "good.parquet")}


def test_a_name_that_is_not_utf_8_is_a_row_with_the_byte_as_an_escape(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("a.csv", os.fsdecode(b"b\xff.csv")):
        (tmp_path / "in" / name).write_text("time_s,lambda_measured\n0,1\n")
    found, _ = judged([str(tmp_path / "in")], tmp_path / "out.parquet")
    assert [Path(path).name for path in found["path"]] == ["a.csv", r"b\udcff.csv"]


def test_names_that_look_like_patterns_urls_or_lines_are_names(tmp_path: Path) -> None:
    (car := tmp_path / "car [1]").mkdir()
    listed = write_piece(car / "a\u2028[1].csv", HEALTHY)
    given = write_piece(car / "10::30.parquet", DELAYED)
    call = ["fleet", manifest_of(car, "path", listed.name), str(given), "--model", MODEL]
    assert main([*call, "--out", str(car / "out [1].parquet"), "--jobs", "1"]) == 0
    rows, _ = fleet_drives.tables(car / "out [1].parquet")
    assert rows["path"].to_list() == [str(listed), str(given)]
    assert rows["error"].to_list() == [None, None]


def test_recordings_are_found_by_folder_pattern_and_manifest(folder: Path, tmp_path: Path) -> None:
    every = [d.path for d in drives_of([str(folder)])]
    assert every == sorted(map(str, folder.iterdir()))
    assert [d.path for d in drives_of([f"{folder}/*.parquet"])] == every[::2]
    shutil.copytree(folder, tmp_path / "day.csv")
    assert len(drives_of([str(tmp_path / "day.csv")])) == len(every)
    (tmp_path / "m.csv").write_text(
        "vehicle, path\nb, x/1.log\na, memory://far/2.log\n, /abs/3.log\nb, x/4.log\n"
    )
    drives = drives_of([str(tmp_path / "m.csv")])
    assert [(d.vehicle, d.drive) for d in drives] == [("b", 0), ("a", 0), ("3.log", 0), ("b", 1)]
    wanted = [str(tmp_path / "x/1.log"), "memory://far/2.log", "/abs/3.log"]
    assert [d.path for d in drives][:3] == wanted
    (tmp_path / "q.csv").write_text('"vehicle","path"\n"7, red","x/1, 2.log"\n')
    (quoted,) = drives_of([str(tmp_path / "q.csv")])
    assert (quoted.vehicle, quoted.path) == ("7, red", str(tmp_path / "x/1, 2.log"))
    named = drives_of([str(folder)], r"drive_0*(\d)")
    assert [(d.vehicle, d.drive) for d in named[:3]] == [("0", 0), ("1", 0), ("2", 0)]
    with pytest.raises(UsageError, match=r"^--vehicle car_\(.\): matches no path, as .*drive_"):
        drives_of([str(folder)], "car_(.)")


def test_what_a_run_writes_among_its_recordings_is_none_of_them(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN results that lie in the folder of the recordings, and chunks of a run that was killed
    out = tmp_path / "results.parquet"
    for path in sorted(folder.iterdir())[:2]:
        shutil.copy(path, tmp_path)
    call = ["fleet", str(tmp_path), "--model", MODEL, "--out", str(out), "--jobs", "1"]
    (mine := tmp_path / "results.parquet.old").mkdir()  # a folder of the user's
    assert main(call) == 0
    assert mine.is_dir()
    fleet.work_folder(out).mkdir()
    shutil.copy(out, fleet.work_folder(out) / "chunk_000000.recordings.parquet")
    # WHEN the same command is given again, by another way to --out, THEN it judges the same
    call[5] = f"{tmp_path}/../{tmp_path.name}/results.parquet"
    assert main(call) == 0
    first, again = (line for line in capsys.readouterr().out.splitlines() if "with a code" in line)
    assert again == first
    assert first.startswith("2 recordings")
    call[1] = str(out)
    assert main(call) == 2
    assert "no recording there but what the run itself writes" in capsys.readouterr().err


def test_a_chunk_holds_whole_vehicles(tmp_path: Path) -> None:
    rows = (f"{k}.log,{k % 100}" for k in range(1000))
    chunks = chunks_of(drives_of([manifest_of(tmp_path, "path,vehicle", *rows)]))
    assert sum(chunk.drives for chunk in chunks) == 1000
    assert len({own[0].vehicle for chunk in chunks for own in chunk.vehicles}) == 100
    assert max(len(chunk.vehicles) for chunk in chunks) == 12
    rounds = list(chunks[0].rounds())
    assert [d.drive for d in rounds[3]] == [3] * 12


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("path,vehicle\n", "no recording"),
        ("path,vehicle\n,a\n", "line 2: no path"),
        ("path,speed\nx.log,3\n", "unknown column 'speed'"),
        ("path\nx.log\nx.log\n", "is there twice"),
        ("path\nx.log\n./x.log\n", "is there twice"),
        ("path,vehicle\nx.log,7, red\n", "line 2: more than path and vehicle"),
    ],
)
def test_a_manifest_that_cannot_be_meant_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(UsageError, match=said):
        drives_of([str(tmp_path / "m.csv")])


@pytest.mark.parametrize("between", [",", ";", "\t"])
def test_a_manifest_has_the_separator_of_its_spreadsheet(between: str, tmp_path: Path) -> None:
    rows = [between.join(row) for row in (("a.log", "first"), ("b.log", ""))]
    found = drives_of([manifest_of(tmp_path, between.join(("path", "vehicle")), *rows)])
    assert [Path(drive.path).name for drive in found] == ["a.log", "b.log"]
    assert [drive.vehicle for drive in found] == ["first", "b.log"]


def test_the_command_says_why_recordings_could_not_be_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = manifest_of(tmp_path, "path", "gone.log", "lost.log")
    assert main(["fleet", manifest, "--model", MODEL, "--out", str(tmp_path / "f.parquet")]) == 3
    said = f"not judged: 2 recordings, {tmp_path}/gone.log: cannot read it: No such file"
    assert said in capsys.readouterr().out


def test_a_logger_s_file_in_any_encoding_is_a_recording_and_no_manifest(tmp_path: Path) -> None:
    path = tmp_path / "live.csv"
    path.write_text("Time(s), O2 Voltage (V)\n0.0, 0.3\n", encoding="utf-16")
    assert [drive.path for drive in drives_of([str(path)])] == [str(path)]
    (tmp_path / "drive.msl").write_text("Time\tRPM\n0\t900\n")
    (tmp_path / "drive.vbo").touch()
    assert len(drives_of([str(tmp_path)])) == 3


def test_a_place_without_recordings_is_named(tmp_path: Path) -> None:
    for given in (str(tmp_path), str(tmp_path / "gone"), f"{tmp_path}/*.blf", "nosuch://x/y"):
        with pytest.raises(UsageError, match=given.replace("*", r"\*")):
            drives_of([given])


def test_threads_of_one_worker_do_not_disturb_each_other(folder: Path, local: Tables) -> None:
    # GIVEN the chunks of a fleet, judged by two threads as on a Dask worker with --nthreads 2
    kit = WorkerKit.of(replay.shipped_model(), config.load())
    chunks = chunks_of(drives_of([str(folder)]))
    with ThreadPoolExecutor(2) as threads:
        done = list(threads.map(partial(judge_chunk, kit), chunks))
    # THEN the rows are those of one thread
    rows, windows = ([getattr(d, k) for d in done] for k in ("recordings", "windows"))
    assert_alike(tuple(pl.concat(each) for each in (rows, windows)), local)


def test_a_killed_run_goes_on_where_it_was(folder: Path, local: Tables, tmp_path: Path) -> None:
    # GIVEN a run that is killed when its first chunk is stored
    out = tmp_path / "out.parquet"
    call = [str(folder), "--model", MODEL, "--out", str(out), "--jobs", "1"]
    run = subprocess.Popen(
        [sys.executable, "-m", "training.cli", "fleet", *call], stderr=subprocess.DEVNULL
    )
    work = fleet.work_folder(out)
    deadline = time.monotonic() + 60
    while not list(work.glob("chunk*.json")) and time.monotonic() < deadline:
        assert run.poll() is None
        time.sleep(0.001)
    run.send_signal(signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    finished = {p: p.stat().st_mtime_ns for p in work.glob("chunk*.json")}
    assert finished and not out.exists()
    # AND a file that was being written
    (work / "chunk_000002.begun").write_bytes(b"half")
    # WHEN it is run again, THEN what was done is taken up and the tables are the same
    assert_alike(judged([str(folder)], out), local)
    assert {p: p.stat().st_mtime_ns for p in finished} == finished


@pytest.mark.parametrize("side", [4, 1], ids=["among others", "alone in its chunk"])
def test_a_file_that_kills_the_process_is_a_row_and_the_others_are_judged(
    side: int, folder: Path, local: Tables, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN ten recordings and between them one at which the process that judges it dies
    monkeypatch.setattr(fleet.parallel, "run", fleet_drives.run_deadly)
    monkeypatch.setattr(fleet.fleet_drives, "LEAST_SIDE", side)
    paths = sorted(folder.iterdir())
    shutil.copy(paths[0], tmp_path / "deadly.parquet")
    given = [*paths[:5], tmp_path / "deadly.parquet", *paths[5:]]
    # WHEN they are judged
    rows, windows = judged([manifest_of(tmp_path, "path", *given)], tmp_path / "out.parquet")
    # THEN it has a row that says so, and all others are as without it
    (bad,) = rows.filter(pl.col("error").is_not_null()).to_dicts()
    assert bad["error"] == f"{tmp_path / 'deadly.parquet'}: {fleet.DIED}"
    good = rows.filter(pl.col("error").is_null())
    assert_alike(
        (good.drop("recording"), windows.drop("recording")),
        tuple(table.drop("recording") for table in local),
    )


def test_a_folder_of_another_run_is_refused(folder: Path, tmp_path: Path) -> None:
    one = [str(next(folder.glob("*.parquet")))]
    judged(one, tmp_path / "out.parquet")
    with pytest.raises(UsageError, match="holds a run with another manifest;"):
        judged([str(folder)], tmp_path / "out.parquet")
    # AND says each thing that differs once, as with a model of another name and content
    known = fleet.work_folder(tmp_path / "out.parquet") / "run.json"
    known.write_text("{}")
    with pytest.raises(UsageError, match="with another model and another config and"):
        judged(one, tmp_path / "out.parquet")


def test_a_killed_run_does_not_go_on_with_a_recording_that_has_grown(tmp_path: Path) -> None:
    path = write_piece(tmp_path / "drive.csv", HEALTHY)
    judged([str(path)], tmp_path / "out.parquet")
    write_piece(path, HEALTHY, n=2000)
    with pytest.raises(UsageError, match="holds a run with another manifest;"):
        judged([str(path)], tmp_path / "out.parquet")


def test_the_command_says_what_it_found(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.parquet"
    call = ["fleet", f"{folder}/*.parquet", "--model", MODEL, "--out", str(out), "--jobs", "1"]
    assert main(call) == 0
    told = "1 with a code, 0 could not be judged; the response test decided 5\n"
    assert f"5 recordings, 0.2 h: {told}" in capsys.readouterr().out
    assert not fleet.work_folder(out).exists()
    rows, windows = fleet_drives.tables(out)
    assert rows.schema == pl.Schema(columns.schema(columns.RECORDINGS))
    assert windows.schema == pl.Schema(columns.schema(columns.WINDOWS))
    # AND the page lists vehicle, code and drive, with the command for a page that says the same
    page = re.sub(r"<wbr>", "", out.with_suffix(".html").read_text())
    (words,) = re.findall(r"o2mon (replay .+ --html \S+\.html)", page)
    *drive, html = words.split()
    assert o2mon([*drive, str(tmp_path / html), "--quiet"]) == 1
    assert "P015A" in (tmp_path / html).read_text()
    (tmp_path / "empty.log").touch()
    call[1] = str(tmp_path / "empty.log")
    assert main(call) == 3
    assert "1 recording, 0.0 h: 0 with a code" in capsys.readouterr().out
    call[-3] = str(tmp_path / "out.csv")
    assert main(call) == 2


def test_every_column_is_documented() -> None:
    text = (ROOT / "docs" / "reference" / "fleet_tables.md").read_text()
    first, _, second = text.partition("### `results.windows.parquet`")
    _, _, first = first.partition("### `results.parquet`")
    for part, table in ((first, columns.RECORDINGS), (second, columns.WINDOWS)):
        rows = [line.split(" | ") for line in part.splitlines() if line.startswith("| `")]
        said = {name.strip("| `"): what.removesuffix(" |") for name, _, what in rows}
        assert said == {name: what for name, (_, what) in table.items()}


def test_tables_with_names_of_their_own_and_logs_with_another_map_are_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a table whose columns have other names, a columns map, and a copy of DBC and signal map
    write_piece(tmp_path / "drive.csv", HEALTHY)
    table = (tmp_path / "drive.csv").read_text().replace("lambda_measured", "LAM", 1)
    (tmp_path / "drive.csv").write_text(table)
    (tmp_path / "names.toml").write_text('lambda_measured = "LAM"\n')
    for suffix in ("dbc", "toml"):
        shutil.copy(ROOT / "dbc" / f"o2_ecu.{suffix}", tmp_path / f"mine.{suffix}")
    out = tmp_path / "out.parquet"
    call = ["fleet", str(tmp_path / "drive.csv"), str(LOGS / DELAYED), "--model", MODEL]
    call += ["--out", str(out), "--jobs", "1", "--columns", str(tmp_path / "names.toml")]
    call += ["--dbc", str(tmp_path / "mine.dbc"), "--map", str(tmp_path / "mine.toml")]
    # WHEN they are judged THEN both are
    assert main(call) == 0
    rows, _ = fleet_drives.tables(out)
    assert rows["error"].to_list() == [None, None]
    assert rows["codes"].to_list() == [[], ["P015A"]]
    # AND a columns map that cannot be meant is refused at once
    (tmp_path / "names.toml").write_text("lambda_measured = 3\n")
    assert main(call) == 2
    said = f"{tmp_path / 'names.toml'}: lambda_measured is 3, a text is wanted"
    assert said in capsys.readouterr().err


def test_recordings_are_read_over_http(folder: Path, tmp_path: Path) -> None:
    # GIVEN a server with the fleet's files
    handler = partial(QuietServer, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        root = f"http://127.0.0.1:{server.server_port}"
        names = sorted(path.name for path in folder.iterdir())[:2]
        given = [names[0], f"{names[1]}?signature=a/b.log", "gone.log"]
        manifest = manifest_of(tmp_path, "path", *(f"{root}/{name}" for name in given))
        # WHEN they are judged by their URLs
        rows, _ = judged([manifest], tmp_path / "out.parquet")
        server.shutdown()
    # THEN they are, and the one that is not there says so
    assert rows["error"].to_list()[:2] == [None, None]
    assert rows["sha256"].to_list()[:2] == [sha256_of(folder / name) for name in names]
    assert rows["vehicle"].to_list()[:2] == names
    assert rows["error"][2].startswith(f"{root}/gone.log: cannot be read")


class QuietServer(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass
