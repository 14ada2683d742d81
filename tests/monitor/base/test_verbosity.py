"""``-q`` and ``-v`` of every command."""

import argparse
from collections.abc import Iterator

import pytest

from monitor.base.command_line import verbosity
from monitor.cli import _parser as o2mon_parser
from monitor.cli import main
from tests.conftest import ROOT
from training.cli import _parser as o2train_parser

DATABASE = str(ROOT / "dbc" / "o2_ecu.dbc")


def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    inner = [each for each in parser._actions if isinstance(each, argparse._SubParsersAction)]
    for commands in inner:
        for command in commands.choices.values():
            yield from leaves(command)
    if not inner:
        yield parser


def test_every_command_takes_quiet_and_verbose() -> None:
    for parser in (o2mon_parser(None), o2train_parser(None)):
        verbosity.add_options(parser)
        commands = list(leaves(parser))
        assert len(commands) >= 9
        for command in commands:
            wanted = {"-q", "--quiet", "-v", "--verbose"}
            assert wanted <= command._option_string_actions.keys(), command.prog


def test_a_quiet_command_prints_nothing_and_keeps_its_exit_code(
    capfd: pytest.CaptureFixture[str],
) -> None:
    usual = main(["map", DATABASE])
    assert "lambda_measured" in capfd.readouterr().out
    assert main(["map", "-q", DATABASE]) == usual
    assert capfd.readouterr() == ("", "")
    # and an error is still printed
    assert main(["map", "-q", "missing.dbc"]) == 2
    said = capfd.readouterr()
    assert said.out == ""
    assert "missing.dbc" in said.err


def test_a_verbose_command_says_versions_files_and_duration(
    capfd: pytest.CaptureFixture[str],
) -> None:
    code = main(["map", DATABASE])
    usual = capfd.readouterr()
    assert main(["map", "-v", DATABASE]) == code
    verbose = capfd.readouterr()
    assert verbose.out == usual.out
    assert "reads" not in usual.err
    for part in ("onnxruntime ", f"reads {DATABASE}", "took "):
        assert part in verbose.err
