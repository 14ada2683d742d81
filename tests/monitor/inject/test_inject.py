"""Faults put into an ECU's frames: of the sensor in frame time, and of the frames."""

import random
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.errors import SignalMapError, UsageError
from monitor.base.fault_streams import DropOuts, NoiseFault, TimedSensorFault
from monitor.base.faults import DEFAULT_SEVERITY, resolve
from monitor.base.types import Frame
from monitor.frames.loop_frames import log_gap, time_mark
from monitor.inject.injection import FRAME_FAULTS, NAMES, Injection
from monitor.inject.injector import Injector
from tests.helpers.examples import inputs
from tests.helpers.logs.bus_maps import AEM, OBD, OWN, RUSEFI, Decoding, values_of
from tests.helpers.logs.injected_frames import (
    AIR_ID,
    HALF_STEP,
    LAMBDA_ID,
    MS,
    WRITER,
    counted,
    decoded,
    injected,
    lambda_frames,
)
from training.recordings.sensor_fault import faulty_readings

readings = st.lists(st.floats(0.7, 1.4), min_size=2, max_size=60)


BY_TIME = {"drift_lean", "drift_rich", "intermittent", "no_activity"}
SILENT = {"heater", "not_ready", "signal_missing"}


@pytest.mark.parametrize("name", sorted({*DEFAULT_SEVERITY} - BY_TIME - SILENT))
@inputs(20)
@given(values=readings)
def test_at_even_times_a_fault_reads_as_defined(name: str, values: list[float]) -> None:
    fault = resolve(name)
    timed = TimedSensorFault(fault)
    got = [timed.push(n * 20 * MS, value) for n, value in enumerate(values)]
    np.testing.assert_allclose(got, faulty_readings(fault, values, 0.02), rtol=1e-12)


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


@pytest.mark.parametrize("name", sorted(BY_TIME))
def test_what_grows_holds_or_ripples_does_so_whenever_a_log_begins(name: str) -> None:
    seen = []
    for begin_ns in (0, 7 * MS):
        timed = TimedSensorFault(resolve(name))
        seen.append([timed.push(begin_ns + n * 100 * MS, 1 + n % 7 / 99) for n in range(600)])
    assert seen[0] == pytest.approx(seen[1])


def test_noise_has_its_standard_deviation_and_drop_outs_their_share() -> None:
    noise, loose = NoiseFault(0.02, "1"), DropOuts(0.2, "1")
    noisy = np.array([noise.push(n * 20 * MS, 1.0) for n in range(20_000)])
    assert noisy.std() == pytest.approx(0.02, rel=0.03)
    assert abs(noisy.mean() - 1.0) < 0.001
    lost = np.isnan([loose.push(n * 20 * MS, 1.0) for n in range(100_000)])
    assert lost.mean() == pytest.approx(0.2, abs=0.03)


# bits of ECU_Lambda: readiness, heater, and all others but lambda and the checksum
READY, HEATER = 0b11 << 36, 0xFFF << 38
OTHERS = (1 << 56) - (1 << 16) & ~(READY | HEATER)


@given(
    readings, st.sampled_from([n for n in NAMES if n not in FRAME_FAULTS and n != "signal_missing"])
)
def test_a_sensor_fault_changes_signals_and_checksum_only(values: list[float], name: str) -> None:
    frames = lambda_frames(values)
    out = injected(frames, Injection.of(name))
    assert len(out) == len(frames)
    for before, after in zip(frames, out, strict=True):
        assert after._replace(data=b"") == before._replace(data=b"")
        assert after.data[2:4] == before.data[2:4]
        changed = int.from_bytes(after.data, "little") ^ int.from_bytes(before.data, "little")
        assert changed & OTHERS == 0
        assert (changed & READY == 0) is (name not in {"not_ready", "heater"})
        assert (changed & HEATER == 0) is (name != "heater")
        assert WRITER.is_sound(after.data)


@given(readings)
def test_a_fault_that_does_nothing_leaves_every_bit(values: list[float]) -> None:
    # GIVEN a lag much faster than the frames, noise below half a step
    frames = lambda_frames(values)
    for nothing in (Injection("slow_symmetric", 1e-9), Injection("noise", 1e-9)):
        assert injected(frames, nothing) == frames
    # AND one that begins with the last frame; a later one is a mistake
    last_s = (frames[-1].t_ns - frames[0].t_ns) / 1e9
    assert injected(frames, Injection("gain_low", 0.5, start_s=last_s))[:-1] == frames[:-1]
    with pytest.raises(UsageError, match="begins after the drive's end"):
        injected(frames, Injection("gain_low", 0.5, start_s=last_s + 0.001))


@pytest.mark.parametrize("name", ["biased_lean", "gain_low", "delay_symmetric"])
def test_lambda_is_changed_in_the_range_that_pid_4f_told(name: str) -> None:
    # GIVEN the same lambda of PID 34 in the range of 2, and in that of 4 behind an answer to PID 4F
    told, n_per_lambda = bytes.fromhex("06414F0400000000"), {2: 32768, 4: 16384}
    readings = [0.9 + 0.05 * (n % 7) for n in range(40)]
    asked: dict[int, list[Frame]] = {
        most: [
            Frame(n * 100 * MS, 0x7E8, False, b"\x06\x41\x34" + raw.to_bytes(2, "big") + bytes(3))
            for n, raw in enumerate(round(reading * per) for reading in readings)
        ]
        for most, per in n_per_lambda.items()
    }
    asked[4].insert(0, Frame(0, 0x7E8, False, told))
    faulty = {m: list(Injector(OBD, [Injection.of(name)]).stream(f)) for m, f in asked.items()}
    # THEN the decoder takes the same readings from both, which are not those of the ECU
    seen, wide = (values_of(OBD, "lambda_measured", faulty[most]) for most in (2, 4))
    assert faulty[4][0].data == told
    assert wide == pytest.approx(seen, abs=2.5 / 16384)
    assert np.abs(np.array(wide) - readings).max() > 0.04


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


def test_a_map_that_cannot_say_not_available_refuses_such_faults_and_holds_in_drop_outs() -> None:
    for name in ("not_ready", "signal_invalid"):
        with pytest.raises(SignalMapError, match="rusefi"):
            Injector(RUSEFI, [Injection.of(name)])
    message = RUSEFI.channels["lambda_measured"].message
    data = [(10_000 + n).to_bytes(2, "little") + bytes(6) for n in range(2000)]
    ramp = [Frame(n * 20 * MS, message.frame_id, False, each) for n, each in enumerate(data)]
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
    assert injector.counts.kept["unsound, left as it is"] == 2


def test_only_the_message_that_carries_lambda_is_touched() -> None:
    other = [Frame(n * 10 * MS, 0x100 + n, bool(n % 2), bytes([n] * (n % 9))) for n in range(50)]
    for name in NAMES:
        if name != "frame_flood":
            assert injected(other, Injection.of(name)) == other
    # AND of an ECU that answers all questions under one identifier, only the answers with lambda
    speed, reading = bytes.fromhex("03410C0FA0"), bytes.fromhex("0641347000800000")
    answers = [Frame(0, 0x7E8, False, data) for data in (speed, reading, speed)]
    silent = Injector(OBD, [Injection.of("signal_missing")])
    assert list(silent.stream(answers)) == [answers[0], answers[2]]
    # AND no mark of a recording of the loop, which the bus has not carried
    marks = [time_mark(0), log_gap(0)]
    assert injected(marks, Injection("frame_loss", 1.0, messages=("all",))) == marks


def test_a_message_known_by_its_group_is_changed_whoever_sends_it() -> None:
    by_group = {name: replace(each, any_source=True) for name, each in AEM.channels.items()}
    bus_map = replace(AEM, channels=by_group)
    frames = [Frame(n * MS, 0x181, True, b"\x27\x10" + bytes(6)) for n in range(5)]
    faulty = list(Injector(bus_map, [Injection.of("biased_lean")]).stream(frames))
    assert values_of(bus_map, "lambda_measured", frames) == pytest.approx([1.0] * 5)
    assert values_of(bus_map, "lambda_measured", faulty) == pytest.approx([1.1] * 5)


def test_lost_frames_leave_gaps_in_the_counter_or_none_if_it_is_kept() -> None:
    frames = lambda_frames([1.0] * 2000)
    gaps = injected(frames, Injection("frame_loss", 0.3))
    kept = injected(frames, Injection("frame_loss", 0.3), keep=True)
    assert len(gaps) == len(kept) == pytest.approx(1400, abs=80)
    assert set(gaps) < set(frames)
    assert counted(kept) == [n % 16 for n in range(len(kept))]
    assert all(WRITER.is_sound(frame.data) for frame in kept)
    subject = Decoding(OWN, ["lambda_measured"])
    subject.push(gaps)
    assert subject.decoder.counters["ECU_Lambda"].lost > 300


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
def test_any_frame_and_fault_is_survived(frames: list[Frame], names: list[str], keep: bool) -> None:
    injector = Injector(OWN, [Injection.of(name) for name in names], keep_counters=keep)
    out = list(injector.stream(frames))
    counts = injector.counts
    assert counts.taken == len(frames)
    assert counts.given == len(out)
    done = counts.changed
    assert len(out) == len(frames) - done["lost"] - done["left out"] + done["duplicated"]
