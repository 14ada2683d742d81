"""Several driving cycles in one stream, as at a bench that is never switched off."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from monitor.base.types import Frame
from monitor.frames.blocks import block_of
from monitor.inject.gateway import write_log
from monitor.judge.electrical.plausibility import Plausibility
from monitor.judge.findings import Counted
from monitor.memory.dtc import Status
from monitor.memory.dtc_store import DtcStore
from monitor.memory.store import Memory
from monitor.pipeline import replay
from monitor.pipeline.events import CycleStarted, DtcChanged, Event
from monitor.pipeline.frames import FramePipeline
from tests.helpers.bus.played_bus import Pause, run_on
from tests.helpers.logs.replays import frames_of
from tests.helpers.memory.stretches import (
    CONFIG,
    DRIVE,
    HOUR,
    MINUTE,
    OFF_BUS,
    SILENCE,
    STAND,
    START,
    Stretch,
    lasting,
    samples,
)


@pytest.fixture(scope="module")
def late_sensor() -> list[Frame]:
    return frames_of("delay_rich_to_lean", 100.0)


def later(frames: list[Frame], by_s: float) -> list[Frame]:
    return [frame._replace(t_ns=frame.t_ns + round(by_s * 1e9)) for frame in frames]


def judge(frames: list[Frame], setup: replay.Setup, store: DtcStore) -> list[Event]:
    store.start_driving_cycle()
    pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, store)
    return list(pipeline.push(block_of(frames)))


def codes(events: list[Event]) -> list[tuple[str, str | None]]:
    return [(e.dtc.code, e.dtc.state) for e in events if isinstance(e, DtcChanged) if e.dtc.fault]


def test_a_code_keeps_the_signals_of_its_setting_beside_the_latest_results_of_service_06(
    setup: replay.Setup, late_sensor: list[Frame]
) -> None:
    store = DtcStore()
    events = judge(late_sensor, setup, store)
    (failed,) = [e for e in events if isinstance(e, DtcChanged) and e.dtc.state]
    frame = store.freeze_frames["P015A"]
    assert frame.t_ns == failed.t_ns
    assert frame.values["engine_speed_rpm"] > 500.0
    assert frame.values["coolant_temperature_degc"] > CONFIG.enable.coolant_min_degc
    assert {"lambda_measured", "fuel_mass_mg", "ambient_pressure_kpa"} <= frame.values.keys()
    results = {r.quantity: r for r in store.results}
    late = results["dead_time_rich_to_lean_s"]
    assert (late.test, results["offset"].test) == ("response", "bias")
    assert late.value > late.high == CONFIG.response.delay_limit_s
    for quantity in ("dead_time_lean_to_rich_s", "lag_rich_to_lean_s", "gain", "offset"):
        assert results[quantity].low <= results[quantity].value <= results[quantity].high


def test_what_was_found_before_clearing_is_forgotten_and_found_again(
    setup: replay.Setup, late_sensor: list[Frame]
) -> None:
    store = DtcStore()
    store.start_driving_cycle()
    pipeline = FramePipeline(setup.bus_map, setup.model, setup.limits, setup.config, store)
    half = len(late_sensor) // 2
    first = list(pipeline.push(block_of(late_sensor[:half])))
    assert ("P015A", "pending") in codes(first)
    # WHEN it is cleared while the drive goes on
    changed = store.clear()
    assert "P015A" in {dtc.code for dtc in changed}
    assert not store.fault_flag
    # THEN it is pending again, after as many windows
    again = list(pipeline.push(block_of(late_sensor[half:])))
    assert ("P015A", "pending") in codes(again)
    assert store.counts.ignition_cycles == 1
    assert {r.test: r.numerator for r in store.ratios}["response"] == 1  # one driving cycle


def test_a_healed_code_is_announced_where_the_next_driving_cycle_begins(
    setup: replay.Setup, late_sensor: list[Frame]
) -> None:
    # GIVEN a code pending from an earlier drive, and a stream of drives in which the test passes
    healthy = frames_of("healthy_micro_trips")
    store = DtcStore()
    store.start_driving_cycle()
    store.fail("delay_rich_to_lean", 1)
    stream = judge([*healthy, *later(healthy[:2000], HOUR)], setup, store)
    # THEN it goes with the end of the driving cycle, and says so
    at = next(i for i, event in enumerate(stream) if isinstance(event, CycleStarted))
    gone = stream[at + 1]
    assert isinstance(gone, DtcChanged)
    assert (gone.dtc.code, gone.dtc.state) == ("P015A", None)
    assert not gone.dtc.status & Status.PENDING
    assert not store.fault_flag
    counted = [event.what for event in stream if isinstance(event, Counted)]
    assert counted.count("ignition_cycle") == 2


def communication(*stretches: Stretch) -> set[str]:
    """Return what the communication test says of the last stretch."""
    names = ("lambda_measured", "engine_speed_rpm")
    tests = Plausibility(CONFIG.plausibility, names, "lambda_measured", 1.0)
    drive = samples(*stretches, names=names)
    results = tests.push(drive.values, drive.quality)
    first = len(drive.t_ns) - round(stretches[-1].seconds)
    return {
        r.fault if r.failed else "passed"
        for _, end, r in results
        if r.test == "communication" and end > first
    }


def test_an_ecu_that_falls_silent_with_the_engine_standing_is_not_missed() -> None:
    asleep = lasting(SILENCE, 600)
    assert communication(DRIVE, lasting(STAND, 2), asleep) == set()
    assert communication(DRIVE, lasting(STAND, 2), asleep, START) == {"passed"}
    # and one that does so while the engine runs is, also after it has slept
    assert communication(DRIVE, asleep) == {"signal_missing"}
    assert communication(STAND, asleep, STAND, START, asleep) == {"signal_missing"}
    # one that was never heard may be missing or asleep: it is missed
    assert communication(asleep) == {"signal_missing"}
    # the monitor's own bus off says nothing of the ECU
    assert communication(DRIVE, lasting(STAND, 2), OFF_BUS) == {"bus_off"}


def test_a_replay_of_what_was_recorded_finds_the_same_driving_cycles(
    setup: replay.Setup, late_sensor: list[Frame], tmp_path: Path
) -> None:
    # GIVEN a bench: a drive, six minutes of a silent bus, the same drive again
    drive = late_sensor[: 200 * 50]
    length_s = (drive[-1].t_ns - drive[0].t_ns) / 1e9
    script = [*drive, Pause(6 * MINUTE), *later(drive, length_s + 6 * MINUTE)]
    record, kept = tmp_path / "bench.log", []
    for run in ("live", "replay"):
        with closing(Memory(tmp_path / f"{run}.db")) as memory:
            if run == "live":
                run_on(script, setup, memory=memory, record=record)
            else:
                replay.replay(record, setup, memory)
            kept.append(memory.load())
    live, again = kept
    # THEN the fault memory of the replay is that of the run, to the last bit
    assert live == again
    assert live.counts.ignition_cycles == 2
    states = {d.code: d.state for d in live.dtcs if d.state}
    # a bus that dies while the engine runs is missed, which pauses the numerators
    assert states == {"P015A": "confirmed", "U0100": "pending"}
    assert {r.test: r.numerator for r in live.ratios}["response"] == 1


def test_the_vehicles_reference_learns_from_each_driving_cycle_of_a_stream(
    setup: replay.Setup, tmp_path: Path
) -> None:
    # GIVEN a vehicle of which a short drive tells enough
    bias = replace(CONFIG.bias, reference_windows=5)
    setup = replace(setup, config=replace(setup.config, bias=bias))
    healthy, log = frames_of("healthy_micro_trips", 72.0), tmp_path / "healthy.log"
    write_log(log, healthy)
    length_s = (healthy[-1].t_ns - healthy[0].t_ns) / 1e9
    # WHEN there are two such drives as two recordings, and as one
    with closing(Memory(tmp_path / "apart.db")) as apart:
        for _ in range(2):
            last, _ = replay.replay(log, setup, apart)
        known = apart.reference(setup.model.sha256)
    stream = [*healthy, *later(healthy, length_s + 10 * MINUTE)]
    record = tmp_path / "bench.log"
    with closing(Memory(tmp_path / "live.db")) as memory:
        live, _ = run_on(stream, setup, memory=memory, record=record)
        assert memory.reference(setup.model.sha256).drives == known.drives == 2
    with closing(Memory(tmp_path / "replay.db")) as memory:
        again, _ = replay.replay(record, setup, memory)
        # THEN the second one is judged with what the first one taught
        assert memory.reference(setup.model.sha256).drives == 2
    assert live["limits"] == again["limits"]
    assert live["limits"]["gain"] == pytest.approx(last["limits"]["gain"], abs=1e-3)
    assert live["limits"]["gain"] != setup.limits.gain
    assert live["windows"] == again["windows"]
