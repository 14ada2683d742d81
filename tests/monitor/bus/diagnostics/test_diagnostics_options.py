"""Options of ``o2mon run`` for diagnostics: who answers, and when nobody does."""

import argparse
from contextlib import closing
from pathlib import Path

import can
import pytest

from monitor.base import config
from monitor.base.command_line import signature
from monitor.base.errors import RecordingError, UsageError
from monitor.bus.diagnostics.server import Diagnostics, answer
from monitor.bus.loop import Loop
from monitor.cli import diagnostics, main
from monitor.memory.dtc_store import Saved
from monitor.memory.store import Memory
from monitor.pipeline import replay
from tests.helpers.bus.diagnostics_state import VIN

SETUP = replay.set_up(None, [], config.load())


def attached(*words: str, memory: Memory | None = None) -> list[Diagnostics]:
    """Return what answers testers with these options, of a monitor with a code."""
    parser = argparse.ArgumentParser()
    signature.add_options(parser, diagnostics.DiagnosticsOptions)
    with can.Bus("options", interface="virtual") as bus:
        loop = Loop(bus, SETUP, memory=memory, say=lambda _: None)
        loop.pipeline.monitor.store.fail("gain_low", 0)
        found = diagnostics.diagnostics(parser.parse_args(words), SETUP, loop)
    assert all(isinstance(each, Diagnostics) for each in found)
    return [each for each in found if isinstance(each, Diagnostics)]


def test_nothing_is_answered_unless_transmitting_is_asked_for() -> None:
    assert attached() == []


@pytest.mark.parametrize(
    "words", [("--diagnostics-id", "7EA"), ("--vin", VIN), ("--clear-while-running",)]
)
def test_options_of_diagnostics_need_transmitting(words: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match="only with --transmit"):
        attached(*words)
    if words[0] != "--diagnostics-id":
        with pytest.raises(UsageError, match="not with --diagnostics-id none"):
            attached("--transmit", "--diagnostics-id", "none", *words)


@pytest.mark.parametrize("option", ["--obd-request=7E0", "--obd-rate=5", "--sink-rate=2"])
def test_an_option_without_the_one_that_it_belongs_to_is_refused(option: str) -> None:
    assert main(["run", "-i", "virtual", "-c", "q", "--duration", "0.1", option]) == 2


def test_with_transmit_the_monitor_answers_as_the_second_control_unit() -> None:
    (server,) = attached("--transmit")
    assert set(server.identifiers) == {(0x7DF, False), (0x7E1, False)}
    assert server.state.identity.vin is None
    assert server.state.identity.model_sha256 == SETUP.model.sha256
    assert "engine_speed_rpm" in server.state.names
    assert not server.state.clear_while_running


def test_the_engines_own_identifier_and_a_wrong_vin_are_refused() -> None:
    with pytest.raises(UsageError, match="7E8 is the engine's"):
        attached("--transmit", "--diagnostics-id", "7E8")
    with pytest.raises(UsageError, match="wanted 17"):
        attached("--transmit", "--vin", "SHORT")


def test_without_can_isotp_transmitting_goes_on_and_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(diagnostics, "find_spec", lambda _: None)
    assert attached("--transmit") == []
    assert "pip install '.[diagnostics]'" in capsys.readouterr().out
    with pytest.raises(UsageError, match="can-isotp is not installed"):
        attached("--transmit", "--diagnostics-id", "7E9")


@pytest.mark.parametrize("is_full", [False, True])
def test_only_a_clearing_that_is_stored_is_confirmed(
    is_full: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # GIVEN a code, and a disk that is full or not
    with closing(Memory(tmp_path / "o2")) as memory:
        (server,) = attached("--transmit", "--clear-while-running", memory=memory)
        if is_full:
            monkeypatch.setattr(memory, "save", full)
        # WHEN a tester clears
        told = answer(b"\x04", False, server.state)
        # THEN it is told so only if the memory on disk is clear, too
        assert told == (b"\x7f\x04\x22" if is_full else b"\x44")
        assert is_full or all(not d.state for d in memory.load().dtcs)


def full(saved: Saved) -> None:
    raise RecordingError("disk full")
