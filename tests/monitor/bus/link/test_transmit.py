"""The monitor's own frames, read back with cantools, say what the monitor said."""

from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest
from cantools.database import Database, load_file
from hypothesis import given
from hypothesis import strategies as st

import dbc
from monitor.base.types import Frame, Sample
from monitor.bus.transmit import Transmitter, dtc_number
from monitor.decode.checksum import payload_checksum
from monitor.judge.bias import Outcome
from monitor.memory.codes import CODES
from monitor.memory.dtc import Status
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline.events import Event, Tick
from monitor.pipeline.monitor import SensorMonitor
from tests.helpers.models.windows import judged_window

DATABASE = cast(Database, load_file(dbc.path("o2_monitor.dbc")))
STATUS = DATABASE.get_message_by_name("O2MON_Status").frame_id
WINDOW = DATABASE.get_message_by_name("O2MON_Window").frame_id
TICK_NS = 100_000_000


@dataclass
class Stand:
    store: DtcStore = field(default_factory=DtcStore)
    samples: int = 4
    enabled_samples: int = 1
    completed: bool = False

    @property
    def decisions(self) -> "Stand":
        return self

    def transmitter(self) -> Transmitter:
        return Transmitter(cast(SensorMonitor, cast(Any, self)))


def tick(t_ns: int, predicted: float = 1.0, enabled: bool = True) -> Tick:
    sample = Sample(0, t_ns, np.zeros(1), np.zeros(1, dtype=np.uint8))
    return Tick(sample, predicted, (), enabled)


def decoded(frame: Frame) -> dict[str, Any]:
    """The frame's signals, enumerations as numbers."""
    said = DATABASE.decode_message(frame.can_id, frame.data, decode_choices=False)
    return cast(dict[str, Any], said)


def sent(transmitter: Transmitter, event: Event) -> list[Frame]:
    transmitter.push(event)
    return list(transmitter.work(0.0))


def only(transmitter: Transmitter, event: Event) -> Frame:
    (frame,) = sent(transmitter, event)
    return frame


def crc(frame: Frame) -> int:
    """The checksum of a frame: over the identifier's low byte and bytes 0 to 6."""
    return payload_checksum("crc8_sae_j1850_id", frame.can_id, frame.data, 7)


def test_without_a_fault_the_status_says_so() -> None:
    frame = only(Stand().transmitter(), tick(7 * TICK_NS))
    assert (frame.t_ns, frame.can_id, frame.is_extended) == (7 * TICK_NS, STATUS, False)
    said = decoded(frame)
    assert said.pop("Checksum") == crc(frame)
    assert said == {
        "FaultFlag": 0,
        "WarningLamp": 0,
        "MonitorState": 2,
        "DtcCount": 0,
        "Dtc": 0,
        "DtcStatus": 0,
        "EnabledPercent": 25,
        "AliveCounter": 0,
    }


def test_a_lost_memory_is_told_but_sets_no_flag() -> None:
    stand = Stand(completed=True)
    stand.store.fail("memory_lost", 1)
    said = decoded(only(stand.transmitter(), tick(0)))
    assert (said["FaultFlag"], said["DtcCount"], said["MonitorState"]) == (0, 1, 3)
    assert said["Dtc"] == dtc_number("P062F")


@pytest.mark.parametrize("fault", sorted(CODES.keys() - {"memory_lost"}))
def test_a_fault_sets_the_flag_and_is_told_with_its_status(fault: str) -> None:
    stand = Stand(completed=True)
    changed = stand.store.fail(fault, 1)
    said = decoded(only(stand.transmitter(), tick(0)))
    assert said["FaultFlag"] == 1
    assert said["WarningLamp"] == 0  # pending only
    assert said["DtcCount"] == len(CODES[fault])
    assert said["Dtc"] == dtc_number(CODES[fault][0])
    assert said["DtcStatus"] == int(changed[0].status) == 0x27 & ~0x50
    assert said["MonitorState"] == 4
    # confirmed in the next driving cycle: the lamp is requested
    stand.store.start_driving_cycle()
    stand.store.fail(fault, 1)
    said = decoded(only(stand.transmitter(), tick(0)))
    assert said["WarningLamp"] == 1
    assert Status(said["DtcStatus"]) & Status.CONFIRMED


@pytest.mark.parametrize(
    ("completed", "predicted", "enabled", "state"),
    [
        (False, np.nan, False, "no signals"),
        (False, 1.0, False, "not enabled"),
        (False, 1.0, True, "monitoring"),
        (True, 1.0, True, "passed"),
        (True, np.nan, False, "passed"),
    ],
)
def test_the_state_is_told_in_the_words_of_the_database(
    completed: bool, predicted: float, enabled: bool, state: str
) -> None:
    stand = Stand(completed=completed)
    frame = only(stand.transmitter(), tick(0, predicted, enabled))
    said = cast(dict[str, Any], DATABASE.decode_message(STATUS, frame.data))
    assert str(said["MonitorState"]) == state


@given(
    st.integers(0, 200_000),
    st.floats(-3.9, 3.9),
    st.floats(0.0, 7.9),
    st.sampled_from(["passed", "failed", "inconclusive"]),
)
def test_a_window_is_told_within_half_a_step(
    index: int, mean: float, std: float, outcome: Outcome
) -> None:
    frame = only(Stand().transmitter(), judged_window(mean, std, outcome, index=index))
    assert (frame.t_ns, frame.can_id) == (4_900_000_000, WINDOW)
    said = cast(dict[str, Any], DATABASE.decode_message(WINDOW, frame.data))
    step = 2.0**-13
    assert said["WindowIndex"] == index % 65536
    assert said["ResidualMean"] == pytest.approx(mean, abs=step / 2 + 1e-12)
    assert said["ResidualStd"] == pytest.approx(std, abs=step / 2 + 1e-12)
    assert str(said["Verdict"]) == outcome
    assert said["Checksum"] == crc(frame)


@pytest.mark.parametrize(("mean", "sent"), [(15.0, 3.99987792969), (-15.0, -4.0)])
def test_a_value_beyond_its_signal_is_told_as_the_limit(mean: float, sent: float) -> None:
    said = decoded(only(Stand().transmitter(), judged_window(mean, 99.0)))
    assert said["ResidualMean"] == pytest.approx(sent, abs=1e-9)
    assert said["ResidualStd"] == pytest.approx(7.99987792969, abs=1e-9)


def test_each_message_counts_its_own_frames_modulo_sixteen() -> None:
    transmitter = Stand().transmitter()
    status = [only(transmitter, tick(i * TICK_NS)) for i in range(20)]
    windows = [only(transmitter, judged_window(index=i)) for i in range(20)]
    for frames in (status, windows):
        assert [decoded(f)["AliveCounter"] for f in frames] == [i % 16 for i in range(20)]
        assert all(f.data[7] == crc(f) for f in frames)


def test_the_status_goes_out_every_100_ms_whatever_the_grid() -> None:
    transmitter = Stand().transmitter()
    times = [f.t_ns for t in range(0, 1000, 10) for f in sent(transmitter, tick(t * 1_000_000))]
    assert times == [t * TICK_NS for t in range(10)]


def test_the_status_goes_on_after_the_clock_has_stepped_back() -> None:
    transmitter = Stand().transmitter()
    assert sent(transmitter, tick(3_600_000_000_000))
    assert sent(transmitter, tick(1_000_000_000))
    assert not sent(transmitter, tick(1_050_000_000))
    assert sent(transmitter, tick(1_100_000_000))
