"""o2mon inject as a gateway between two buses."""

import os
import signal
import threading
import time
from collections import Counter
from pathlib import Path

import can
import pytest
from can.interfaces.virtual import VirtualBus

from monitor import cli
from monitor.base.errors import BusError
from monitor.base.types import Frame
from monitor.bus.link.recorder import message_of
from monitor.frames.logs import read_frames
from monitor.frames.loop_frames import BUS_STATE_ID, codes_cleared, is_own
from monitor.inject.gateway import Gateway
from monitor.inject.injection import Injection
from monitor.inject.injector import Injector
from monitor.inject.side import Side
from tests.helpers.logs.bus_maps import OWN
from tests.helpers.logs.injected_frames import HALF_STEP, LAMBDA_ID, decoded, lambda_frames


class Loose(VirtualBus):
    """An interface that can be pulled out."""

    def __init__(self, channel: str) -> None:
        super().__init__(channel=channel)
        self.is_out = False

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.is_out:
            raise can.CanOperationError("network is down")
        return super()._recv_internal(timeout)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.is_out:
            raise can.CanOperationError("network is down")
        super().send(msg, timeout)


class Bench:
    """A gateway whose interfaces go away and come back, on a clock of its own."""

    def __init__(self, *faults: Injection) -> None:
        self.now_s = 0.0
        self.said: list[str] = []
        self.gave: list[Frame] = []
        self.is_there = True
        self.channels = {name: f"{name}-{time.monotonic_ns()}" for name in ("ecu", "other")}
        self.opened = {name: [Loose(channel)] for name, channel in self.channels.items()}
        self.ecu, self.other = (
            can.Bus(interface="virtual", channel=channel) for channel in self.channels.values()
        )
        self.gateway = Gateway(
            self.side("ecu"),
            self.side("other"),
            Injector(OWN, faults),
            self.gave.append,
            lambda: self.now_s,
        )

    def side(self, name: str) -> Side:
        def reopen() -> can.BusABC:
            if not self.is_there:
                raise BusError("no such device")
            self.opened[name].append(Loose(self.channels[name]))
            return self.opened[name][-1]

        first = self.opened[name][0]
        return Side(first, reopen, self.said.append, lambda: self.now_s, name)

    def pull_out(self, name: str) -> None:
        self.opened[name][-1].is_out, self.is_there = True, False

    def run(self, seconds: float) -> None:
        """Let the gateway work for so long of its own time, in steps that are none to wait for."""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.gateway.step()
            self.now_s += 0.05

    def send(self, bus: can.BusABC) -> None:
        bus.send(reading(1.25))
        self.run(0.1)

    def __enter__(self) -> "Bench":
        return self

    def __exit__(self, *_: object) -> None:
        self.gateway.close()
        for bus in (self.ecu, self.other, *(buses[0] for buses in self.opened.values())):
            bus.shutdown()


def received(bus: can.BusABC) -> list[can.Message]:
    return list(iter(lambda: bus.recv(0.0), None))


def message(can_id: int, data: bytes, **others: object) -> can.Message:
    return can.Message(arbitration_id=can_id, is_extended_id=False, data=data, **others)  # type: ignore[arg-type]


def reading(value: float) -> can.Message:
    return message(LAMBDA_ID, lambda_frames([value])[0].data)


def test_a_gateway_rewrites_the_ecus_frames_and_passes_the_others_untouched() -> None:
    frames = lambda_frames([1.25] * 5)
    with Bench(Injection("gain_low", 0.5)) as bench:
        for frame in frames:
            bench.ecu.send(message(LAMBDA_ID, frame.data))
        bench.ecu.send(message(0x123, b"", is_remote_frame=True, dlc=8))
        bench.ecu.send(message(0x124, bytes(range(20)), is_fd=True, bitrate_switch=True))
        bench.ecu.send(message(0x124, bytes(range(8))))
        bench.other.send(message(0x7DF, b"\x02\x01\x0c"))
        bench.other.send(message(LAMBDA_ID, frames[0].data))
        bench.run(0.1)
        got, back = received(bench.other), received(bench.ecu)
    read = decoded([Frame(0, m.arbitration_id, False, bytes(m.data)) for m in got[:5]])
    assert read == pytest.approx([1.0 / 0.9] * 5, abs=HALF_STEP)
    kinds = {(m.arbitration_id, m.is_remote_frame, m.is_fd, m.bitrate_switch) for m in got[5:]}
    classical = {(0x123, True, False, False), (0x124, False, False, False)}
    assert kinds == classical | {(0x124, False, True, True)}
    assert [(m.arbitration_id, bytes(m.data)) for m in back] == [
        (0x7DF, b"\x02\x01\x0c"),
        (LAMBDA_ID, frames[0].data),
    ]
    lines = list(bench.gateway.lines())
    assert lines == [
        "7 frames from the ECU, 7 passed on; rewritten 5",
        "2 frames to the ECU; 0 not sent, 0 error frames",
    ]


def test_a_serial_interface_takes_the_frames_of_another_clock() -> None:
    with can.Bus(interface="serial", channel="loop://") as bus:
        assert Side(bus).send(message(0x124, b"\1", timestamp=1.7e9))
        assert (got := bus.recv(1.0)) and got.data == b"\1"


def test_a_delayed_frame_and_a_flood_go_out_although_the_ecu_is_silent() -> None:
    flood = Injection("frame_flood", 100.0, end_s=0.5, can_id=0x700)
    came = list[tuple[int, float]]()
    with Bench(Injection("frame_delay", 0.2), flood) as bench:
        bench.ecu.send(reading(1.0))
        while bench.now_s < 1.0:
            bench.run(0.05)
            came += [(m.arbitration_id, bench.now_s) for m in received(bench.other)]
    assert Counter(can_id for can_id, _ in came) == {LAMBDA_ID: 1, 0x700: 50}
    assert 0.19 <= next(at_s for can_id, at_s in came if can_id == LAMBDA_ID) <= 0.3
    assert 0.4 <= came[-1][1] <= 0.6


def test_time_passes_for_the_judge_when_the_ecu_falls_silent() -> None:
    with Bench() as bench:
        bench.ecu.send(reading(1.0))
        bench.run(3.0)
    assert [len(frame.data) for frame in bench.gave[:3]] == [8, 0, 0]  # time marks
    assert bench.gave[2].t_ns - bench.gave[0].t_ns > 0.8e9


def test_a_frame_under_a_monitors_own_identifier_passes_and_the_judge_does_not_heed_it() -> None:
    with Bench() as bench:
        bench.send(bench.ecu)
        bench.ecu.send(message_of(codes_cleared(0)))
        bench.run(0.1)
        assert len(received(bench.other)) == 2
    assert [frame.can_id for frame in bench.gave] == [LAMBDA_ID]


def test_frames_that_the_interface_does_not_take_are_counted() -> None:
    def full(*_: object, **__: object) -> None:
        raise can.CanOperationError("no buffer space")

    with Bench() as bench:
        bench.opened["other"][0].send = full  # type: ignore[method-assign]
        bench.send(bench.ecu)
    assert list(bench.gateway.lines())[1] == "0 frames to the ECU; 1 not sent, 0 error frames"


def test_a_gateway_does_not_pass_on_its_own_frames_where_it_hears_them() -> None:
    # GIVEN both buses opened so that a sender hears itself
    own = {"interface": "virtual", "receive_own_messages": True}
    with (
        can.Bus(interface="virtual", channel="l-ecu") as player,
        can.Bus(channel="l-ecu", **own) as ecu,
        can.Bus(channel="l-other", **own) as other,
    ):
        gateway = Gateway(Side(ecu), Side(other), Injector(OWN, []))
        player.send(message(0x123, b"1"))
        gateway.run(duration_s=0.2)
        assert player.recv(0.0) is None
    assert next(gateway.lines()) == "1 frame from the ECU, 1 passed on; none changed"


@pytest.mark.parametrize("which", ["ecu", "other"])
def test_a_gateway_passes_frames_again_after_an_interface_was_gone(which: str) -> None:
    with Bench(Injection("gain_low", 0.5)) as bench:
        bench.send(bench.ecu)
        bench.send(bench.other)
        assert (len(received(bench.other)), len(received(bench.ecu))) == (1, 1)
        # WHEN one of its interfaces is gone for a while, in which both sides go on sending
        bench.pull_out(which)
        bench.run(20.0)
        bench.send(bench.ecu)
        bench.send(bench.other)
        assert (received(bench.other), received(bench.ecu)) == ([], [])
        bench.is_there = True
        bench.run(6.0)
        # THEN frames pass again, with the fault in them, and what was lost meanwhile is counted
        bench.send(bench.ecu)
        bench.send(bench.other)
        passed = bench.other.recv(0.0)
        assert passed is not None
        (read,) = decoded([Frame(0, LAMBDA_ID, False, bytes(passed.data))])
        assert read == pytest.approx(1.0 / 0.9, abs=HALF_STEP)
        assert len(received(bench.ecu)) == 1
        assert bench.gateway.passed.failed == 1
        # and it said so once, and at the end
        assert [line.split(";")[0] for line in bench.said] == [
            f"{which}: lost: network is down",
            bench.said[1],
        ]
        assert bench.said[1].startswith(f"{which}: back after 2")
        assert list(bench.gateway.lines())[2:] == [f"{which}: lost 1 time, back 1 time"]


def test_the_judge_is_told_that_the_gateway_itself_is_off_a_bus() -> None:
    with Bench(Injection("gain_low", 0.5)) as bench:
        bench.send(bench.ecu)
        # WHEN the interface to it is gone and comes back
        bench.pull_out("ecu")
        bench.run(3.0)
        bench.is_there = True
        bench.run(6.0)
        bench.send(bench.ecu)
    # THEN the judge hears of it, as a monitor on the bus would know of its own interface
    states = [frame for frame in bench.gave if frame.can_id == BUS_STATE_ID]
    assert [frame.data for frame in states] == [b"\x01", b"\x00"]
    own = [frame for frame in bench.gave if is_own(frame)]
    assert len(own) > 10
    assert [frame.t_ns for frame in own] == sorted(frame.t_ns for frame in own)


def test_between_two_buses_what_goes_out_is_judged_when_a_signal_ends_it(
    ninety_seconds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a drive on a bus that keeps its time, so that it need not last as long
    scenario = tmp_path / "s.toml"
    fault = '[[fault]]\nname = "gain_low"\nstart_s = 20.0\n'
    scenario.write_text(f'{fault}[[expect]]\ncode = "P2A00"\nwithin_s = 120.0\n')
    frames = list(read_frames(ninety_seconds))
    ecu, other, heard = "judged-ecu", "judged-other", list[can.Message]()

    def play() -> None:
        with (
            can.Bus(interface="virtual", channel=ecu, preserve_timestamps=True) as player,
            can.Bus(interface="virtual", channel=other) as listener,
        ):
            while len(can.interfaces.virtual.channels[ecu]) < 2:
                time.sleep(0.01)
            for frame in frames:
                player.send(message_of(frame))
            while len(heard) < len(frames) and (got := listener.recv(10.0)):
                heard.append(got)
            os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=play, daemon=True)
    thread.start()
    argv = ["-i", "virtual", "-c", ecu, "--to-channel", other, "--scenario", str(scenario)]
    assert cli.main(["inject", *argv, "--assert", "--duration", "60"]) == 0
    thread.join(5.0)
    assert len(heard) == len(frames)
    assert "NOT MET" not in capsys.readouterr().out
