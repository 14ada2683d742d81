"""What ``o2mon check`` says of the signals on a bus or in a log."""

import math
import threading

import can
import numpy as np
import pytest

from monitor.base.types import Frame
from monitor.cli import main
from monitor.decode.bus_map import BusMap
from monitor.frames.blocks import block_of
from monitor.report.check import CheckResult, SignalSeen
from monitor.report.check import check as check_blocks
from tests.helpers.bus.beside import beside, send_as_driven
from tests.helpers.logs.bus_maps import ECU_S, OWN, RUSEFI, ecu


def check(frames: list[Frame], bus_map: BusMap) -> CheckResult:
    half = len(frames) // 2
    return check_blocks([block_of(frames[:half]), block_of(frames[half:])], bus_map)


def seen(result: CheckResult, name: str) -> SignalSeen:
    return next(s for s in result.signals if s.name == name)


def without(message: str, all_frames: list[Frame]) -> list[Frame]:
    can_id = next(c.message.frame_id for c in OWN.channels.values() if c.message.name == message)
    return [f for f in all_frames if f.can_id != can_id]


def test_a_complete_bus_is_plausible_in_every_signal() -> None:
    result = check(ecu(), OWN)
    assert {s.name for s in result.signals} == set(OWN.channels)
    assert {s.verdict(result.end_ns) for s in result.signals} == {"plausible"}
    assert result.missing(OWN.names) == []
    assert sum(result.rejected.values()) == 0


def test_range_rate_and_age_are_those_of_the_frames() -> None:
    sent = ecu(air_mass_mg=np.linspace(100.0, 300.0, round(ECU_S * 100)))
    result = check(sent, OWN)
    assert (result.frames, result.end_ns) == (len(sent), max(f.t_ns for f in sent))
    for name, channel in OWN.channels.items():
        assert channel.message.cycle_time
        expected_hz = 1000.0 / channel.message.cycle_time
        assert seen(result, name).rate_hz == pytest.approx(expected_hz, rel=1e-6), name
    air = seen(result, "air_mass_mg")
    assert air.minimum == pytest.approx(100.0, abs=0.02)
    assert air.maximum == pytest.approx(300.0, abs=2.1)
    assert (result.end_ns - air.last_ns) / 1e9 < 0.05


def test_a_message_that_never_comes_leaves_its_signals_missing() -> None:
    result = check(without("ECU_Lambda", ecu()), OWN)
    lost = [n for n, c in OWN.channels.items() if c.message.name == "ECU_Lambda"]
    assert "lambda_measured" in lost
    assert sorted(result.missing(OWN.names)) == sorted(lost)
    assert {s.name for s in result.signals if s.verdict(result.end_ns) == "MISSING"} == set(lost)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [("rail_pressure_mpa", math.nan, "not available"), ("lambda_measured", 0.31, "out of range")],
)
def test_a_signal_without_a_good_value_says_why(name: str, value: float, said: str) -> None:
    result = check(ecu(**{name: value}), OWN)
    assert seen(result, name).verdict(result.end_ns) == said
    assert result.missing([name, "fuel_mass_mg"]) == [name]


def test_a_signal_that_is_sometimes_implausible_says_how_often() -> None:
    wobbly = np.ones(round(ECU_S * 100))
    wobbly[50:100] = math.nan
    result = check(ecu(lambda_measured=wobbly), OWN)
    lam = seen(result, "lambda_measured")
    assert lam.verdict(result.end_ns) == f"{lam.invalid} bad values"
    assert lam.invalid / (lam.count + lam.invalid) == pytest.approx(0.25, abs=0.02)
    assert result.missing(["lambda_measured"]) == []


def test_frames_that_break_their_checksum_are_counted_and_give_no_values() -> None:
    broken = [f._replace(data=f.data[:-1] + bytes([f.data[-1] ^ 1])) for f in ecu()]
    result = check(broken, OWN)
    assert result.rejected["checksum"] == len(broken)
    assert result.missing(OWN.names) == list(OWN.names)
    assert f"checksum {len(broken)}" in list(result.lines())[-1]


def test_the_table_has_one_line_per_signal_with_unit_and_verdict() -> None:
    result = check(without("ECU_Temps", ecu()), OWN)
    lines = list(result.lines())
    assert len(lines) == len(result.signals) + 2
    for line, signal in zip(lines[1:-1], result.signals, strict=True):
        assert line.startswith(signal.name)
        assert f" {signal.unit} " in line
        assert line.endswith(signal.verdict(result.end_ns))
    assert max(map(len, lines)) <= 100
    assert len({line.rindex("  ") for line in lines[1:-1]}) == 1  # verdicts stand in one column


def test_a_clock_that_falls_back_changes_neither_rate_nor_verdict() -> None:
    # GIVEN a log whose clock was set back between two frames, as replay reads it
    sent, later_ns = ecu(), 20_000_000_000
    fallen = [f._replace(t_ns=f.t_ns + later_ns * (i < len(sent) // 3)) for i, f in enumerate(sent)]
    result, calm = check(fallen, OWN), check(sent, OWN)
    # THEN no signal has stopped, and no frame is counted that was not there
    assert {s.verdict(result.end_ns) for s in result.signals} == {"plausible"}
    assert result.frames == calm.frames
    rates = [[s.rate_hz for s in each.signals] for each in (result, calm)]
    assert rates[0] == pytest.approx(rates[1], rel=0.01)


def test_a_derived_signal_is_there_when_all_it_is_made_of_is() -> None:
    result = check(ecu(RUSEFI), RUSEFI)
    assert "fuel_mass_mg" in result.derived
    assert result.missing(["fuel_mass_mg"]) == []
    assert check([], RUSEFI).missing(["fuel_mass_mg"]) == ["fuel_mass_mg"]


def test_a_message_that_stops_is_said_to_have_stopped_and_counts_as_missing() -> None:
    every = ecu()
    lambda_id = OWN.channels["lambda_measured"].message.frame_id
    half = [f for f in every if f.can_id != lambda_id or f.t_ns < 1_000_000_000]
    result = check(half, OWN)
    assert seen(result, "lambda_measured").verdict(result.end_ns).startswith("STOPPED 1.0 s")
    assert result.missing(["lambda_measured", "air_mass_mg"]) == ["lambda_measured"]


def test_a_bus_that_fell_silent_lacks_its_signals(capsys: pytest.CaptureFixture[str]) -> None:
    def play(over: threading.Event) -> None:
        with can.Bus("stops", interface="virtual") as bus:
            send_as_driven(bus, ecu()[:100], over)

    with beside(play):
        assert main(["check", "-i", "virtual", "-c", "stops", "--seconds", "2"]) == 3
    assert "STOPPED 1." in capsys.readouterr().out


def test_an_engine_that_is_off_is_said_to_be(capsys: pytest.CaptureFixture[str]) -> None:
    def play(over: threading.Event) -> None:
        with can.Bus("off", interface="virtual") as bus:
            while not over.is_set():
                send_as_driven(bus, ecu(engine_speed_rpm=0.0), over)

    with beside(play):
        main(["check", "-i", "virtual", "-c", "off", "--seconds", "1"])
    assert "the engine is off (engine_speed_rpm at most 0): check" in capsys.readouterr().out
    assert not check(ecu(engine_speed_rpm=800.0), OWN).standing(500.0)


def test_a_signal_slower_than_its_timeout_is_stale_with_age_and_timeout() -> None:
    # GIVEN a coolant temperature that comes once a second, under a timeout of half a second
    coolant = OWN.channels["coolant_temperature_degc"]
    timeout_s = coolant.mapped.timeout_s
    sent, last_ns = [], -(10**12)
    for frame in ecu():
        if frame.can_id == coolant.message.frame_id:
            if frame.t_ns - last_ns < 1.5 * timeout_s * 1e9:
                continue
            last_ns = frame.t_ns
        sent.append(frame)
    result = check(sent, OWN)
    assert "coolant_temperature_degc" in result.stale
    words = seen(result, "coolant_temperature_degc").verdict(result.end_ns)
    assert words.startswith("STALE") and f"timeout_s is {timeout_s:g}: set timeout_s = " in words
