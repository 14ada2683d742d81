"""o2mon inject: faults put into an ECU's frames, from log to log and between two buses."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dbc
from monitor import cli
from monitor.bus.recorder import message_of
from monitor.bus_map import load_pairs
from monitor.checksum import payload_checksum
from monitor.decode import Decoder
from monitor.dtc import CODES
from monitor.errors import BusError, SignalMapError, UsageError
from monitor.faults import DropOuts, Noise, SensorFault, TimedSensorFault, resolve
from monitor.inject.gateway import Gateway
from monitor.inject.injection import FRAME_FAULTS, NAMES, Injection
from monitor.inject.injector import Injector
from monitor.inject.rewrite import writers
from monitor.sources import read_frames
from monitor.types import Frame

ROOT = Path(__file__).resolve().parents[1]
HEALTHY = ROOT / "replay_logs" / "healthy_micro_trips_v102_s102.blf"
OWN = load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))])
RUSEFI = load_pairs([(dbc.path("rusefi.dbc"), dbc.path("rusefi.toml"))])
LAMBDA_ID, AIR_ID, MS = 0xC2, 0xC0, 1_000_000
WRITER = writers(OWN.channels)[LAMBDA_ID, False]


def lambda_frames(readings: list[float], period_ms: int = 20) -> list[Frame]:
    """Sound frames of ECU_Lambda with these readings, its counter counting."""
    frames = []
    for n, reading in enumerate(readings):
        empty = bytes([0, 0, 0, 0x10, 0b010101, 0, (n % 16) << 4, 0])
        values = {"lambda_measured": reading, "sensor_ready": 1.0}
        data = WRITER.write(empty, values)
        sound = payload_checksum("crc8_sae_j1850_id", LAMBDA_ID, data, 7)
        frames.append(Frame(n * period_ms * MS, LAMBDA_ID, False, data[:7] + bytes([sound])))
    return frames


def decoded(frames: list[Frame], name: str = "lambda_measured") -> list[float]:
    """The values that the project's decoder takes from the frames."""
    decoder = Decoder(OWN, [name])
    updates = [decoder.push(frame) for frame in frames]
    return [update[1][0] for update in updates if update is not None]


def injected(
    frames: list[Frame], *faults: Injection, seed: int = 0, keep: bool = False
) -> list[Frame]:
    return list(Injector(OWN, faults, seed=seed, keep_counters=keep).stream(frames))


def counted(frames: list[Frame]) -> list[int]:
    return [frame.data[6] >> 4 for frame in frames]


HALF_STEP = WRITER.signals["lambda_measured"].step / 2 + 1e-9
readings = st.lists(st.floats(0.7, 1.4), min_size=2, max_size=60)


# The sensor's faults in frame time


IN_PHI = ("slow_rich_to_lean", "slow_symmetric", "delay_lean_to_rich", "delay_symmetric",
          "transient", "gain_low", "biased_lean", "stuck_rich", "out_of_range")  # fmt: skip


@pytest.mark.parametrize("name", IN_PHI)
@settings(max_examples=20)
@given(values=readings)
def test_at_even_times_a_fault_reads_as_defined(name: str, values: list[float]) -> None:
    fault = resolve(name)
    timed = TimedSensorFault(fault)
    got = [timed.push(n * 20 * MS, value) for n, value in enumerate(values)]
    np.testing.assert_allclose(got, SensorFault(fault, 0.02).apply(values), rtol=1e-12)


@given(st.lists(st.integers(1, 80), min_size=30, max_size=60), st.floats(0.1, 0.5))
def test_at_uneven_times_a_ramp_of_phi_is_late_by_the_dead_time(
    steps_ms: list[int], delay_s: float
) -> None:
    # GIVEN frames at uneven times of a phi that rises evenly
    times_ns = np.cumsum(steps_ms) * MS
    slope = 0.05
    timed = TimedSensorFault(resolve("delay_symmetric", delay_s))
    for t_ns in times_ns.tolist():
        phi = 1.0 / timed.push(t_ns, 1.0 / (0.8 + slope * t_ns / 1e9))
        then_s = max(t_ns / 1e9 - round(delay_s * 1e9) / 1e9, times_ns[0] / 1e9)
        assert phi == pytest.approx(0.8 + slope * then_s, abs=1e-9)


@given(st.lists(st.integers(1, 200), min_size=1, max_size=40), st.floats(0.1, 2.0))
def test_at_uneven_times_a_lag_has_its_time_constant(steps_ms: list[int], tau_s: float) -> None:
    timed = TimedSensorFault(resolve("slow_symmetric", tau_s))
    timed.push(0, 1.0 / 0.9)
    for t_ns in (np.cumsum(steps_ms) * MS).tolist():
        phi = 1.0 / timed.push(t_ns, 1.0 / 1.1)
        assert phi == pytest.approx(1.1 - 0.2 * np.exp(-t_ns / 1e9 / tau_s), abs=1e-9)


def test_noise_has_its_standard_deviation_and_drop_outs_their_share() -> None:
    noise, loose = Noise(0.02, "1"), DropOuts(0.2, "1")
    noisy = np.array([noise.push(n * 20 * MS, 1.0) for n in range(20_000)])
    assert noisy.std() == pytest.approx(0.02, rel=0.03)
    assert abs(noisy.mean() - 1.0) < 0.001
    lost = np.isnan([loose.push(n * 20 * MS, 1.0) for n in range(100_000)])
    assert lost.mean() == pytest.approx(0.2, abs=0.03)


# In the frames


@given(readings)
def test_a_gain_is_read_from_the_frames_within_half_a_step(values: list[float]) -> None:
    frames = lambda_frames(values)
    out = injected(frames, Injection("gain_low", 0.5))
    healthy = decoded(frames)
    wanted = SensorFault(resolve("gain_low", 0.5), 0.02).apply(healthy)
    np.testing.assert_allclose(decoded(out), wanted, atol=HALF_STEP)
    assert [frame.t_ns for frame in out] == [frame.t_ns for frame in frames]


@given(
    readings, st.sampled_from([n for n in NAMES if n not in FRAME_FAULTS and n != "signal_missing"])
)
def test_a_sensor_fault_changes_its_signals_and_the_checksum_only(
    values: list[float], name: str
) -> None:
    frames = lambda_frames(values)
    out = injected(frames, Injection.of(name))
    assert len(out) == len(frames)
    for before, after in zip(frames, out, strict=True):
        assert after._replace(data=b"") == before._replace(data=b"")
        assert after.data[2:4] == before.data[2:4]
        assert after.data[4] & ~0x30 == before.data[4] & ~0x30
        assert (after.data[4] & 0x30 == before.data[4] & 0x30) is (name != "not_ready")
        assert after.data[5:7] == before.data[5:7]
        assert WRITER.is_sound(after.data)


@given(readings)
def test_a_fault_that_does_nothing_leaves_every_bit(values: list[float]) -> None:
    # GIVEN a lag much faster than the frames, noise below half a step, one that has not begun
    frames = lambda_frames(values)
    for nothing in (
        Injection("slow_symmetric", 1e-9),
        Injection("noise", 1e-9),
        Injection("gain_low", 0.5, start_s=1e6),
    ):
        assert injected(frames, nothing) == frames


def test_a_fault_acts_from_its_start_to_before_its_end() -> None:
    frames = lambda_frames([1.0] * 10)
    read = decoded(injected(frames, Injection("stuck_lean", 0.25, start_s=0.04, end_s=0.12)))
    assert [value > 1.2 for value in read] == [False] * 2 + [True] * 4 + [False] * 4


def test_faults_act_in_their_order() -> None:
    out = injected(
        lambda_frames([1.25] * 3), Injection("gain_low", 0.5), Injection("biased_lean", 0.1)
    )
    assert decoded(out) == pytest.approx([1.0 / 0.9 + 0.1] * 3, abs=HALF_STEP)


def test_not_ready_tells_so_and_gives_no_reading_and_invalid_gives_none_though_ready() -> None:
    frames = lambda_frames([1.0] * 3)
    for name, ready in (("not_ready", 0.0), ("signal_invalid", 1.0)):
        out = injected(frames, Injection.of(name))
        assert np.isnan(decoded(out)).all()
        assert decoded(out, "sensor_ready") == [ready] * 3


def test_a_map_that_cannot_say_not_available_refuses_such_faults_and_holds_through_drop_outs() -> (
    None
):
    for name in ("not_ready", "signal_invalid"):
        with pytest.raises(SignalMapError, match="rusefi"):
            Injector(RUSEFI, [Injection.of(name)])
    message = RUSEFI.channels["lambda_measured"].message
    ramp = [
        Frame(
            n * 20 * MS, message.frame_id, False, int(10_000 + n).to_bytes(2, "little") + bytes(6)
        )
        for n in range(2000)
    ]
    injector = Injector(RUSEFI, [Injection("drop_outs", 0.3)])
    read = [int.from_bytes(frame.data[:2], "little") for frame in injector.stream(ramp)]
    held = sum(here == before for before, here in pairwise(read))
    assert 0.15 < held / len(read) < 0.45
    assert all(value in range(9_999, 12_000) for value in read)


def test_frames_that_are_not_sound_are_passed_as_they_are() -> None:
    frames = lambda_frames([1.0] * 4)
    frames[1] = frames[1]._replace(data=frames[1].data[:5])
    frames[2] = frames[2]._replace(data=frames[2].data[:7] + bytes([frames[2].data[7] ^ 1]))
    injector = Injector(OWN, [Injection("gain_low", 0.5), Injection("biased_lean", 0.1)])
    out = list(injector.stream(frames))
    assert out[1:3] == frames[1:3]
    assert out[0] != frames[0]
    assert injector.counts.changed["unsound, left as it is"] == 2


def test_only_the_message_that_carries_lambda_is_touched() -> None:
    other = [Frame(n * 10 * MS, 0x100 + n, bool(n % 2), bytes([n] * (n % 9))) for n in range(50)]
    for name in NAMES:
        if name != "frame_flood":
            assert injected(other, Injection.of(name)) == other


# The frames' own faults


def test_lost_frames_leave_gaps_in_the_counter_or_none_if_it_is_kept() -> None:
    frames = lambda_frames([1.0] * 2000)
    gaps = injected(frames, Injection("frame_loss", 0.3))
    kept = injected(frames, Injection("frame_loss", 0.3), keep=True)
    assert len(gaps) == len(kept) == pytest.approx(1400, abs=80)
    assert set(gaps) < set(frames)
    assert counted(kept) == [n % 16 for n in range(len(kept))]
    assert all(WRITER.is_sound(frame.data) for frame in kept)
    decoder = Decoder(OWN, ["lambda_measured"])
    for frame in gaps:
        decoder.push(frame)
    assert decoder.counters["ECU_Lambda"].lost > 300


def test_a_counter_that_is_kept_still_shows_what_was_lost_before() -> None:
    frames = lambda_frames([1.0] * 2000)
    del frames[1000]
    kept = counted(injected(frames, Injection("frame_loss", 0.3), keep=True))
    jumps = Counter((b - a) % 16 for a, b in pairwise(kept))
    assert jumps == {1: len(kept) - 2, 2: 1}


def test_doubled_frames_repeat_the_counter_or_count_on_if_it_is_kept() -> None:
    frames = lambda_frames([1.0] * 2000)
    twice = injected(frames, Injection("frame_duplication", 0.25))
    kept = injected(frames, Injection("frame_duplication", 0.25), keep=True)
    assert len(twice) == len(kept) == pytest.approx(2500, abs=80)
    assert all(n <= 2 for n in Counter(twice).values())
    assert len(decoded(twice)) == 2000  # a repeated counter is not used
    assert counted(kept) == [n % 16 for n in range(len(kept))]
    assert len(decoded(kept)) == len(kept)


def test_a_corrupted_frame_has_one_bit_flipped_and_is_dropped_by_the_decoder() -> None:
    frames = lambda_frames([1.0] * 1000)
    out = injected(frames, Injection("frame_corruption", 0.2))
    flipped = [
        (int.from_bytes(a.data, "little") ^ int.from_bytes(b.data, "little")).bit_count()
        for a, b in zip(frames, out, strict=True)
    ]
    assert set(flipped) == {0, 1}
    assert sum(flipped) == pytest.approx(200, abs=50)
    assert len(decoded(out)) == 1000 - sum(flipped)


def test_delayed_frames_come_later_and_all_in_the_order_of_time() -> None:
    other = [Frame(n * 7 * MS, AIR_ID, False, bytes(8)) for n in range(60)]
    frames = sorted(lambda_frames([1.0] * 20) + other)
    out = injected(frames, Injection("frame_delay", 0.05))
    assert [f.t_ns for f in out] == sorted(f.t_ns for f in out)
    moved = [f._replace(t_ns=f.t_ns + 50 * MS) if f.can_id == LAMBDA_ID else f for f in frames]
    assert sorted(out) == sorted(moved)


def test_a_flood_has_its_rate_and_identifier_in_its_time() -> None:
    other = [Frame(n * 10 * MS, AIR_ID, False, bytes(8)) for n in range(300)]
    out = injected(
        other, Injection("frame_flood", 500.0, start_s=0.5, end_s=1.5, can_id=0x18FF0001)
    )
    flood = [frame for frame in out if frame.can_id != AIR_ID]
    assert len(flood) == 500
    assert {(frame.can_id, frame.is_extended, len(frame.data)) for frame in flood} == {
        (0x18FF0001, True, 8)
    }
    assert min(f.t_ns for f in flood) == 500 * MS
    assert max(f.t_ns for f in flood) == 1498 * MS
    assert [f for f in out if f.can_id == AIR_ID] == other
    assert [f.t_ns for f in out] == sorted(f.t_ns for f in out)


def test_messages_say_which_frames_a_frame_fault_is_for() -> None:
    rng = random.Random(1)
    frames = [
        Frame(n * MS, rng.choice([AIR_ID, LAMBDA_ID, 0x555]), False, bytes(8)) for n in range(900)
    ]
    lost = {
        of: set(frames) - set(injected(frames, Injection("frame_loss", 0.5, messages=of)))
        for of in ((), ("ECU_Air",), ("all",))
    }
    assert {f.can_id for f in lost[()]} == {LAMBDA_ID}
    assert {f.can_id for f in lost[("ECU_Air",)]} == {AIR_ID}
    assert {f.can_id for f in lost[("all",)]} == {AIR_ID, LAMBDA_ID, 0x555}
    with pytest.raises(UsageError, match="'ECU_Brake' is not in the signal map; there are ECU_Air"):
        Injector(OWN, [Injection("frame_loss", 0.5, messages=("ECU_Brake",))])


@pytest.mark.parametrize("name", ["noise", "drop_outs", *FRAME_FAULTS])
def test_the_same_seed_gives_the_same_frames_and_another_seed_others(name: str) -> None:
    frames = lambda_frames([1.0] * 400)
    fault = Injection.of(name)
    assert injected(frames, fault, seed=3) == injected(frames, fault, seed=3)
    if name != "frame_delay":  # nothing random in it
        assert injected(frames, fault, seed=3) != injected(frames, fault, seed=4)


frame_lists = st.lists(
    st.builds(
        Frame,
        st.integers(0, 10**10),
        st.sampled_from([LAMBDA_ID, AIR_ID, 0x2A0, 0x7FF]),
        st.booleans(),
        st.binary(max_size=8),
    ),
    max_size=30,
)


@given(
    frame_lists,
    st.lists(st.sampled_from([n for n in NAMES if n != "frame_flood"]), max_size=4),
    st.booleans(),
)
def test_any_frames_with_any_faults_are_survived(
    frames: list[Frame], names: list[str], keep: bool
) -> None:
    injector = Injector(OWN, [Injection.of(name) for name in names], keep_counters=keep)
    out = list(injector.stream(frames))
    counts = injector.counts
    assert counts.taken == len(frames)
    assert counts.given == len(out)
    done = counts.changed
    assert len(out) == len(frames) - done["lost"] - done["left out"] + done["duplicated"]


# From log to log


def stem(path: Path) -> str:
    return path.stem


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 210 s of a healthy drive."""
    path = tmp_path_factory.mktemp("drive") / "healthy.log"
    frames = list(read_frames(HEALTHY))
    kept = [frame for frame in frames if frame.t_ns - frames[0].t_ns < 210e9]
    write(path, kept)
    return path


def write(path: Path, frames: list[Frame]) -> None:
    from monitor.inject.gateway import write_log

    assert write_log(path, frames) == len(frames)


SEVERITY = {"biased_lean": 0.2}  # this vehicle's own offset is -0.03
FOUND = [name for name in CODES if name in NAMES]


@pytest.mark.parametrize("name", FOUND)
def test_a_healthy_drive_with_a_fault_put_on_has_the_code_of_the_fault(
    name: str, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a scenario that expects every code of the fault, pending in the first drive
    scenario = tmp_path / "s.toml"
    severity = f"severity = {SEVERITY[name]}\n" if name in SEVERITY else ""
    expected = "".join(
        f'[[expect]]\ncode = "{code}"\nstate = "pending"\nwithin_s = 120.0\n'
        for code in CODES[name]
    )
    scenario.write_text(f'[[fault]]\nname = "{name}"\n{severity}start_s = 20.0\n{expected}')
    # THEN it is met, and no other code came
    assert cli.main(["inject", str(drive), "--scenario", str(scenario), "--assert"]) == 0
    assert "NOT MET" not in capsys.readouterr().out


@pytest.mark.parametrize("name", ["noise", "drop_outs", *FRAME_FAULTS])
def test_disturbances_that_are_no_fault_of_the_sensor_raise_no_code(
    name: str, drive: Path, tmp_path: Path
) -> None:
    scenario = tmp_path / "s.toml"
    scenario.write_text(f'[[fault]]\nname = "{name}"\n[[expect]]\ncode = "none"\n')
    assert cli.main(["inject", str(drive), "--scenario", str(scenario), "--assert"]) == 0


def test_an_expectation_that_is_not_met_ends_with_1_and_a_table(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "s.toml"
    scenario.write_text('[[fault]]\nname = "gain_low"\n[[expect]]\ncode = "P0133"\n')
    assert cli.main(["inject", str(drive), "--scenario", str(scenario), "--assert"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[-3].split() == ["drive", "expected", "seen"]
    assert lines[-2].startswith("1      P0133          P2A00 pending (gain_low) after ")
    assert lines[-2].endswith("NOT MET")
    assert lines[-1].startswith("1      no other code  P2A00 pending")


@pytest.mark.parametrize("scenario", sorted((ROOT / "docs" / "scenarios").glob("*.toml")), ids=stem)
def test_the_shipped_scenarios_are_met(
    scenario: Path, drive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = HEALTHY if scenario.stem.startswith("offset") else drive  # what is healthy takes longer
    assert cli.main(["inject", str(log), "--scenario", str(scenario), "--assert"]) == 0
    assert "  met" in capsys.readouterr().out


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".asc", ".blf", ".csv.gz", ".trc", ".mf4"])
def test_every_log_format_is_written_and_judged_alike(suffix: str, tmp_path: Path) -> None:
    frames = lambda_frames([1.0 + 0.2 * np.sin(n / 9) for n in range(500)])
    source, out = tmp_path / "in.log", tmp_path / f"out{suffix}"
    write(source, frames)
    assert cli.main(["inject", str(source), "--out", str(out), "--fault", "gain_low=0.5@2-8"]) == 0
    wanted = injected(frames, Injection("gain_low", 0.5, 2.0, 8.0))
    got = list(read_frames(out))
    assert [f.data for f in got] == [f.data for f in wanted]
    shifts = {(a.t_ns - b.t_ns) // 1000 for a, b in zip(got, wanted, strict=True)}
    assert max(shifts) - min(shifts) <= 1  # some formats keep no absolute time


def test_the_frames_of_several_drives_go_to_numbered_logs(tmp_path: Path) -> None:
    source, scenario = tmp_path / "in.log", tmp_path / "s.toml"
    write(source, lambda_frames([1.1] * 100))
    scenario.write_text('drives = 2\n[[fault]]\nname = "stuck_at_one"\ndrives = [2]\n')
    out = tmp_path / "out.log.gz"
    assert cli.main(["inject", str(source), "--scenario", str(scenario), "--out", str(out)]) == 0
    means = [np.mean(decoded(list(read_frames(tmp_path / f"out_{n}.log.gz")))) for n in (1, 2)]
    assert means == pytest.approx([1.1, 1.0], abs=1e-3)


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["IN"], "nothing to do with LOG"),
        (["IN", "--out", "OUT", "--fault", "slow"], "fault 'slow' is unknown"),
        (["IN", "--out", "OUT", "--assert"], "--assert needs a --scenario"),
        (["IN", "--out", "out.txt"], "unknown log format '.txt'"),
        (["IN", "--out", "no/such/out.log"], "no/such/out.log: cannot record"),
        (["IN", "--out", "OUT", "-i", "virtual", "-c", "a"], "either a LOG or two buses"),
        (["IN", "--out", "OUT", "--fault", "signal_missing"], "no frame is left"),
        (["none.log", "--out", "OUT"], "none.log: cannot read the log"),
        (["-i", "virtual", "-c", "a"], "give the other side"),
        (["-i", "virtual", "-c", "a", "--to-channel", "a"], "both sides are virtual a"),
        (["-i", "virtual", "-c", "a", "--to-channel", "b", "--out", "OUT"], "--out is for a LOG"),
        (["-i", "udp_multicast", "-c", "239.1.1.1", "--to-channel", "239.1.1.2"], "hears what it"),
        (["IN", "--out", "OUT", "--dbc", "x.dbc"], "--dbc and --map come in pairs"),
    ],
)
def test_what_cannot_be_is_refused_with_exit_code_2(
    argv: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "in.log", lambda_frames([1.0] * 3))
    paths = {"IN": str(tmp_path / "in.log"), "OUT": str(tmp_path / "out.log")}
    assert cli.main(["inject", *(paths.get(arg, arg) for arg in argv)]) == 2
    assert says in capsys.readouterr().err


# Between two buses


class Bench:
    """An ECU's bus and another with a gateway between them, in this process."""

    def __init__(self, *faults: Injection) -> None:
        channels = [f"{name}-{time.monotonic_ns()}" for name in ("ecu", "other")]
        self._buses = [
            can.Bus(interface="virtual", channel=channel) for channel in channels for _ in range(2)
        ]
        self.ecu, ecu_side, self.other, other_side = self._buses
        self.gave: list[Frame] = []
        self.gateway = Gateway(ecu_side, other_side, Injector(OWN, faults), self.gave.append)
        self._thread = threading.Thread(target=self.gateway.run)

    def __enter__(self) -> "Bench":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.gateway.stop()
        self._thread.join(5.0)
        for bus in self._buses:
            bus.shutdown()
        assert not self._thread.is_alive()


def drained(bus: can.BusABC, n: int) -> Iterator[can.Message]:
    """Give ``n`` messages, fewer if they do not come in 5 s."""
    for _ in range(n):
        message = bus.recv(5.0)
        if message is None:
            return
        yield message


def message(can_id: int, data: bytes, **others: object) -> can.Message:
    return can.Message(arbitration_id=can_id, is_extended_id=False, data=data, **others)  # type: ignore[arg-type]


def test_a_gateway_rewrites_the_ecus_frames_and_passes_the_others_untouched() -> None:
    frames = lambda_frames([1.25] * 5)
    with Bench(Injection("gain_low", 0.5)) as bench:
        for frame in frames:
            bench.ecu.send(message(LAMBDA_ID, frame.data))
        bench.ecu.send(message(0x123, b"", is_remote_frame=True, dlc=8))
        bench.ecu.send(message(0x124, bytes(range(20)), is_fd=True, bitrate_switch=True))
        got = list(drained(bench.other, 7))
        bench.other.send(message(0x7DF, b"\x02\x01\x0c"))
        bench.other.send(message(LAMBDA_ID, frames[0].data))
        back = list(drained(bench.ecu, 2))
    read = decoded([Frame(0, m.arbitration_id, False, bytes(m.data)) for m in got[:5]])
    assert read == pytest.approx([1.0 / 0.9] * 5, abs=HALF_STEP)
    kinds = {(m.arbitration_id, m.is_remote_frame, m.is_fd, m.bitrate_switch) for m in got[5:]}
    assert kinds == {(0x123, True, False, False), (0x124, False, True, True)}
    assert [(m.arbitration_id, bytes(m.data)) for m in back] == [
        (0x7DF, b"\x02\x01\x0c"), (LAMBDA_ID, frames[0].data)]  # fmt: skip
    lines = list(bench.gateway.lines())
    assert lines == [
        "6 frames from the ECU, 6 passed on; rewritten 5",
        "2 frames to the ECU; 0 not sent, 0 error frames",
    ]


def test_a_delayed_frame_and_a_flood_go_out_although_the_ecu_is_silent() -> None:
    flood = Injection("frame_flood", 100.0, end_s=0.5, can_id=0x700)
    with Bench(Injection("frame_delay", 0.2), flood) as bench:
        sent_s = time.monotonic()
        bench.ecu.send(message(LAMBDA_ID, lambda_frames([1.0])[0].data))
        came = [(m.arbitration_id, time.monotonic() - sent_s) for m in drained(bench.other, 51)]
    assert Counter(can_id for can_id, _ in came) == {LAMBDA_ID: 1, 0x700: 50}
    assert next(late_s for can_id, late_s in came if can_id == LAMBDA_ID) >= 0.19
    assert came[-1][1] >= 0.4


def test_time_passes_for_the_judge_when_the_ecu_falls_silent() -> None:
    with Bench() as bench:
        bench.ecu.send(message(LAMBDA_ID, lambda_frames([1.0])[0].data))
        deadline_s = time.monotonic() + 5.0
        while len(bench.gave) < 3 and time.monotonic() < deadline_s:
            time.sleep(0.05)
    assert [len(frame.data) for frame in bench.gave[:3]] == [8, 0, 0]  # time marks
    assert bench.gave[2].t_ns - bench.gave[0].t_ns > 0.8e9


def test_frames_that_the_interface_does_not_take_are_counted() -> None:
    class Full(can.interfaces.virtual.VirtualBus):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            raise can.CanOperationError("no buffer space")

    with (
        can.Bus(interface="virtual", channel="f-ecu") as ecu,
        can.Bus(interface="virtual", channel="f-ecu") as side,
        Full(channel="f-other") as other,
    ):
        gateway = Gateway(side, other, Injector(OWN, []))
        ecu.send(message(LAMBDA_ID, bytes(8)))
        gateway.run(duration_s=0.05)
    assert list(gateway.lines())[1] == "0 frames to the ECU; 1 not sent, 0 error frames"


def test_a_gateway_does_not_pass_on_its_own_frames_where_it_hears_them() -> None:
    # GIVEN both buses opened so that a sender hears itself
    own = {"interface": "virtual", "receive_own_messages": True}
    with (
        can.Bus(interface="virtual", channel="l-ecu") as player,
        can.Bus(channel="l-ecu", **own) as ecu,
        can.Bus(channel="l-other", **own) as other,
    ):
        gateway = Gateway(ecu, other, Injector(OWN, []))
        player.send(message(0x123, b"1"))
        gateway.run(duration_s=0.2)
        assert player.recv(0.0) is None
    assert next(gateway.lines()) == "1 frames from the ECU, 1 passed on"


def test_a_gateway_whose_interface_fails_says_so() -> None:
    class Broken(can.interfaces.virtual.VirtualBus):
        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            raise can.CanOperationError("network is down")

    with (
        Broken(channel="b-ecu") as ecu,
        can.Bus(interface="virtual", channel="b-other") as other,
        pytest.raises(BusError, match="network is down"),
    ):
        Gateway(ecu, other, Injector(OWN, [])).run(duration_s=1.0)


@pytest.mark.parametrize(("code", "exit_code"), [("P2A00", 0), ("P0133", 1)])
def test_between_two_buses_what_goes_out_is_judged_when_a_signal_ends_it(
    code: str, exit_code: int, drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # GIVEN a drive on a bus that keeps its time, so that it need not last as long
    scenario = tmp_path / "s.toml"
    fault = '[[fault]]\nname = "gain_low"\nstart_s = 20.0\n'
    scenario.write_text(f'{fault}[[expect]]\ncode = "{code}"\nwithin_s = 120.0\n')
    frames = list(read_frames(drive))
    ecu, other = f"e-{code}", f"o-{code}"
    heard = []

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
    assert cli.main(["inject", *argv, "--assert", "--duration", "60"]) == exit_code
    thread.join(5.0)
    assert len(heard) == len(frames)
    assert ("NOT MET" in capsys.readouterr().out) is bool(exit_code)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_gateway_ends_cleanly_on_a_signal(number: signal.Signals) -> None:
    argv = [sys.executable, "-m", "monitor.cli", "inject", "-i", "virtual", "-c", "a",
            "--to-channel", "b", "--fault", "gain_low"]  # fmt: skip
    with subprocess.Popen(
        argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ)
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "virtual a to virtual b: gain_low=0.5\n"
        process.send_signal(number)
        out, err = process.communicate(timeout=10)
    assert (process.returncode, err) == (0, "")
    assert out.splitlines()[0] == "0 frames from the ECU, 0 passed on"
