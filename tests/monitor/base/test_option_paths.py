"""No command writes over a file that it reads: asked of every option of every command."""

import argparse
import os
import shutil
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monitor import cli as o2mon
from monitor import report
from monitor.base import config
from monitor.base.command_line import option_paths as paths
from monitor.base.errors import UsageError
from monitor.base.files.json_text import write_json
from monitor.pipeline.replay import shipped_model
from training import cli as o2train
from training.recordings.files.table_files import write_table

REPORT = Path(report.__file__).parent / "static" / "report.html"
PROGRAMS = ("o2mon", "o2train")


@cache
def parser_of(program: str, command: str) -> argparse.ArgumentParser:
    return (o2mon if program == "o2mon" else o2train)._parser([command])


def _branches(parser: argparse.ArgumentParser) -> list[Any]:
    return [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]


def commands(
    parser: argparse.ArgumentParser, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], argparse.ArgumentParser]]:
    """Yield the words and the parser of every command, of actions of commands too."""
    branches = _branches(parser)
    for branch in branches:
        for name, below in branch.choices.items():
            yield from commands(below, (*words, name))
    if not branches:
        yield words, parser


def options(parser: argparse.ArgumentParser, *roles: Any) -> list[argparse.Action]:
    """Return the options of a command whose paths have one of the roles."""
    return [action for action in parser._actions if action.type in roles]


def words_of(parser: argparse.ArgumentParser, chosen: dict[str, str]) -> list[str]:
    """Return a command line with the options chosen and all that are required.

    chosen : value by the option's name in the namespace
    """
    words: list[str] = []
    positional: list[str] = []
    left = dict(chosen)  # two options may fill one name, one of them is given
    for action in parser._actions:
        if action.dest in left:
            value = left.pop(action.dest)
        elif action.dest not in chosen and action.required and action.nargs not in ("?", "*"):
            value = f"/nowhere/{action.dest}"
        else:
            continue
        if action.option_strings:
            words += [action.option_strings[-1], value]
        else:
            positional.append(value)
    return [*positional, *words]


COMMANDS = [
    pytest.param(program, words, id=" ".join((program, *words)))
    for program in PROGRAMS
    for name in _branches(parser_of(program, ""))[0].choices
    for words, _ in commands(parser_of(program, name))
    if words[0] == name
]
LOOKS_LIKE_A_FILE = ("FILE", "LOG", "OUT", "DIR", "HTML", "TOML", "onnx", "RECORDING", "DBC")


def parsed(
    program: str, words: tuple[str, ...], chosen: dict[str, str]
) -> tuple[argparse.ArgumentParser, argparse.Namespace]:
    parser = parser_of(program, words[0])
    return parser, parser.parse_args([*words, *words_of(leaf_of(program, words), chosen)])


def leaf_of(program: str, words: tuple[str, ...]) -> argparse.ArgumentParser:
    (leaf,) = [below for found, below in commands(parser_of(program, words[0])) if found == words]
    return leaf


@pytest.mark.parametrize(("program", "words"), COMMANDS)
def test_every_option_that_names_a_file_has_a_role(program: str, words: tuple[str, ...]) -> None:
    for action in leaf_of(program, words)._actions:
        assert action.type is not Path, action
        named = str(action.metavar or "")
        is_file = any(word in named for word in LOOKS_LIKE_A_FILE) and "NAME" not in named
        has_role = isinstance(action.type, paths.PathRole) or action.type is paths.pattern
        assert has_role or not is_file, action


def alike(path: Path) -> list[Path]:
    link, hard, folder = (path.with_name(name) for name in ("link", "hard", "folder"))
    link.symlink_to(path)
    hard.hardlink_to(path)
    folder.mkdir()
    return [path, link, hard, folder / ".." / path.name, Path(os.path.relpath(path))]


@pytest.mark.parametrize(("program", "words"), COMMANDS)
def test_no_command_writes_over_a_file_it_reads_under_any_name(
    tmp_path: Path, program: str, words: tuple[str, ...]
) -> None:
    path = tmp_path / "file.onnx"
    path.write_text("read")
    leaf = leaf_of(program, words)
    goals = [a.dest for a in options(leaf, paths.written, paths.written_model)]
    sources = [a.dest for a in options(leaf, paths.read, paths.recording, paths.kept)]
    in_place = leaf.get_default("changed_in_place")
    names = alike(path)
    for goal in goals:
        for source in sources:
            if source == in_place and goal == "out":
                continue
            for name in names:
                parser, args = parsed(program, words, {source: str(path), goal: str(name)})
                with pytest.raises(UsageError, match=r"is read, too|would be written twice"):
                    paths.check(parser, args)


@pytest.mark.parametrize(("program", "words"), COMMANDS)
def test_no_command_writes_one_file_twice_or_over_a_manifest_beside_a_recording(
    tmp_path: Path, program: str, words: tuple[str, ...]
) -> None:
    leaf = leaf_of(program, words)
    goals = [a.dest for a in options(leaf, paths.written, paths.written_model)]
    for first, second in pairwise(goals):
        both = dict.fromkeys((first, second), str(tmp_path / "new.onnx"))
        with pytest.raises(UsageError, match="would be written twice"):
            paths.check(*parsed(program, words, both))
    manifest = tmp_path / "manifest.json"
    manifest.write_text("{}")
    for goal in goals:
        for source in options(leaf, paths.read, paths.recording):
            chosen = {source.dest: str(tmp_path / "drive.log"), goal: str(manifest)}
            with pytest.raises(UsageError, match=r"manifest\.json: is read, too"):
                paths.check(*parsed(program, words, chosen))


@pytest.mark.parametrize(("program", "words"), COMMANDS)
def test_no_result_is_written_over_the_program_s_own(program: str, words: tuple[str, ...]) -> None:
    own = [shipped_model(), Path(config.__file__).with_name("default.toml")]
    for goal in options(leaf_of(program, words), paths.written):
        for path in own:
            with pytest.raises(UsageError, match="belongs to the program"):
                paths.check(*parsed(program, words, {goal.dest: str(path)}))


@pytest.mark.parametrize(("program", "words"), COMMANDS)
def test_no_command_reads_a_fifo(tmp_path: Path, program: str, words: tuple[str, ...]) -> None:
    fifo = tmp_path / "fifo.log"
    os.mkfifo(fifo)
    leaf = leaf_of(program, words)
    for source in options(leaf, paths.read, paths.recording, paths.kept):
        with pytest.raises(UsageError, match="is a FIFO, a regular file is wanted"):
            paths.check(*parsed(program, words, {source.dest: str(fifo)}))


def test_the_files_of_a_fault_memory_are_not_written_over(tmp_path: Path) -> None:
    memory = tmp_path / "o2.db"
    for name in ("o2.db", "o2.db.b", "o2.db-lock", "o2.db.b-begun"):
        (tmp_path / name).write_text("kept")
        chosen = {"memory": str(memory), "json": str(tmp_path / name)}
        with pytest.raises(UsageError, match=r"is read, too|belongs to the fault memory"):
            paths.check(*parsed("o2mon", ("replay",), chosen))


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("gap",), "model.onnx"),
        (("gap",), "report.html"),
        (("study",), "study.json"),
        (("fit",), "model.html"),
        (("fleet",), "model.html"),
    ],
)
def test_files_without_an_option_of_their_own_are_not_written_over_what_is_read(
    tmp_path: Path, words: tuple[str, ...], name: str
) -> None:
    (tmp_path / name).write_text("read")
    leaf = leaf_of("o2train", words)
    is_folder = any(a.dest == "out" for a in options(leaf, paths.folder))
    out = tmp_path if is_folder else tmp_path / "model.onnx"
    source = options(leaf, paths.recording, paths.read)[0].dest
    with pytest.raises(UsageError, match="is read, too"):
        paths.check(*parsed("o2train", words, {"out": str(out), source: str(tmp_path / name)}))


@pytest.mark.parametrize("out", [[], ["--out", "model.onnx"], ["--out", "./model.onnx"]])
def test_a_calibration_may_change_its_own_model_but_a_report_must_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, out: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(shipped_model(), tmp_path / "model.onnx")
    parser = parser_of("o2train", "calibrate")
    base = ["calibrate", "--model", "model.onnx", "--healthy", "drive.log", *out]
    paths.check(parser, parser.parse_args(base))
    with pytest.raises(UsageError, match="would be written twice"):
        paths.check(parser, parser.parse_args([*base, "--report", "model.onnx"]))


def test_only_a_file_that_a_command_wrote_is_replaced_without_force(tmp_path: Path) -> None:
    table, page, own = tmp_path / "t.parquet", tmp_path / "page.html", tmp_path / "own.json"
    write_table(table, np.array([0.0, 0.1]), ["lambda"], np.ones((2, 1)))
    shutil.copy(REPORT, page)
    write_json(own, {"schema": "o2mon.replay/1"})
    paths.check_replaced([table, page, own, Path(shipped_model()), tmp_path / "new.csv"])
    # WHEN the very same names hold what somebody else wrote
    for path in (table, page, own):
        path.write_text("mine")
    for command, option, path in (
        ("replay", "--html", page),
        ("replay", "--json", own),
        ("check", "--write-profile", table),
    ):
        parser = parser_of("o2mon", command)
        words = [command, "drive.log", option, str(path)]
        with pytest.raises(UsageError, match="is there already; --force replaces it"):
            paths.check(parser, parser.parse_args(words))
        paths.check(parser, parser.parse_args([*words, "--force"]))
    # AND a log of a live bus gets a number instead
    parser = parser_of("o2mon", "run")
    paths.check(parser, parser.parse_args(["run", "-i", "virtual", "--record", str(own)]))


def test_a_folder_to_write_into_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match="is a file, a folder is wanted"):
        paths.check(*parsed("o2train", ("simulate",), {"out": str(tmp_path / "file")}))


def test_results_may_go_to_a_pipe_and_twice_to_nowhere() -> None:
    chosen = {"json": "/dev/null", "html": "/dev/null"}
    paths.check(*parsed("o2mon", ("replay",), chosen))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (
            "o2mon inject TABLE --out o.csv --fault gain_low --keep-counters",
            "for a CAN log or a bus",
        ),
        (
            "o2mon replay LOG --columns NAMES",
            "--profile/--columns is for a table, not for a CAN log",
        ),
        ("o2mon replay TABLE --channel 1", "--channel is for a CAN log or a bus, not for a table"),
        ("o2mon check LOG --seconds 9", "--seconds is for a bus, not for a CAN log"),
        ("o2mon check TABLE -i virtual", "-i/--interface is for a bus, not for a table"),
        ("o2train fit TABLE TABLE --out m.onnx --dbc NAMES --map NAMES", "--dbc is for a CAN log"),
        ("o2train gap --model NAMES --out o LOG --healthy LOG --profile NAMES", "is for a table"),
    ],
)
def test_an_option_that_does_nothing_with_its_input_is_refused(
    call: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {"LOG": "drive.log", "TABLE": "drive.csv", "NAMES": "names.toml"}
    for name in files.values():
        (tmp_path / name).write_text("time_s,lambda_measured\n0,1\n1,1\n")
    program, *words = (
        str(tmp_path / files[word]) if word in files else word for word in call.split()
    )
    assert (o2mon if program == "o2mon" else o2train).main(words) == 2
    assert says in capsys.readouterr().err
    # but one of two kinds of recordings may need it, and what is of no known kind
    both = [str(tmp_path / files[kind]) for kind in ("LOG", "TABLE")]
    (unknown := tmp_path / "drive").write_text("time_s,lambda_measured\n0,1\n1,1\n")
    for given in both, [str(unknown)]:
        assert o2mon.main(["replay", *given, "--columns", "cobb"]) == 2
        assert "is for a" not in capsys.readouterr().err
