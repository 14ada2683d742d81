"""Frames are decoded as cantools decodes them; where blocks begin and end changes nothing."""

import math
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.utils import create_encode_decode_formats, decode_data
from hypothesis import example, given
from hypothesis import strategies as st

from monitor.base.errors import SignalMapError
from monitor.base.signals import BY_NAME
from monitor.base.types import Frame
from monitor.decode.block_decoder import BlockDecoder, MessageCounters
from monitor.decode.bus_map import BusChannel, BusMap, load_pairs
from monitor.decode.checksum import payload_checksum
from tests.helpers.examples import inputs
from tests.helpers.logs.bus_maps import OBD, OWN, Decoding, Values
from tests.helpers.logs.injected_frames import lambda_frames


def bus_map_of(folder: Path, size: int, signals: str, own: str) -> BusMap:
    dbc_path, map_path = folder / "own.dbc", folder / "own.toml"
    dbc_path.write_text(f'VERSION ""\n\nBU_: A\n\nBO_ 100 M: {size} A\n{signals}\n')
    map_path.write_text(own)
    return load_pairs([(dbc_path, map_path)])


def test_a_restart_forgets_counters_and_counts() -> None:
    (frame,), subject = lambda_frames([1.0]), Decoding(OWN, OWN.names)
    subject.push([frame, Frame(0, 0x123, False, b"")])
    subject.decoder.restart()
    assert subject.decoder.unmapped == 0
    assert all(counters.received == 0 for counters in subject.decoder.counters.values())
    assert subject.one(frame) is not None


def test_an_alive_counter_goes_on_from_block_to_block() -> None:
    frames, subject = lambda_frames([1.0] * 4), Decoding(OWN, OWN.names)
    assert subject.one(frames[0]) is not None
    assert subject.one(frames[0]) is None  # it stands still
    subject.one(frames[3])
    assert subject.decoder.counters["ECU_Lambda"].lost == 2


@pytest.mark.parametrize("start", [1, 12, 47])
def test_a_checksum_across_bytes_is_refused(tmp_path: Path, start: int) -> None:
    signals = f' SG_ X0 : 0|1@1+ (1,0) [0|1] "" A\n SG_ Crc : {start}|8@1+ (1,0) [0|0] "" A'
    own = '[integrity]\nchecksum = "Crc"\n[signals]\nx0 = { message = "M", signal = "X0" }\n'
    with pytest.raises(SignalMapError, match=r"checksum M\.Crc .* unsigned byte of its own"):
        BlockDecoder(bus_map_of(tmp_path, 8, signals, own), ["x0"])


@pytest.mark.parametrize("cut", range(1, 7))
def test_an_answer_to_pid_4f_sets_the_range_of_what_follows(cut: int) -> None:
    # GIVEN lambda and pressure before, between and after ranges of 4 and 510 kPa, and of 0
    ranges = ["06414F0400003300", "06414F0000000000"]
    lambdas, pressure = "0641344000800000", "03410B6400000000"
    frames = [
        Frame(0, 0x7E8, False, bytes.fromhex(text))
        for text in (lambdas, ranges[0], lambdas, pressure, ranges[1], lambdas, pressure)
    ]
    subject = Decoding(OBD, ["lambda_measured", "manifold_pressure_kpa"])
    values = [v for v in in_blocks(subject, frames, [cut]) if v]
    # THEN each value has the range that was told last, none being the standard one
    assert [next(iter(v.values())) for v in values] == pytest.approx([0.5, 1.0, 200.0, 0.5, 100.0])
    assert subject.decoder.counters["OBD_Response"].other == 0


def raw_of(message: Message, signal: Signal, data: bytes) -> int | float:
    raw = decode_data(
        data,
        message.length,
        [signal],
        create_encode_decode_formats([signal], message.length),
        decode_choices=False,
        scaling=False,
        allow_truncated=False,
        allow_excess=False,
    )[signal.name]
    assert isinstance(raw, int | float)
    return raw


def limits_of(channel: BusChannel) -> tuple[float, float]:
    """Return the least and largest value that are plausible, of the signal or its database."""
    mapped, known = channel.mapped, BY_NAME.get(channel.mapped.name)
    stated = channel.signal.minimum, channel.signal.maximum
    if known is not None:
        low, high = known.minimum, known.maximum
    else:
        low, high = sorted(float(each or 0) * mapped.factor + mapped.offset for each in stated)
    margin = 1e-9 * (high - low)  # of rounding
    return (low - margin, high + margin) if margin else (-math.inf, math.inf)


def value_of(channel: BusChannel, raw: float) -> float:
    """Return the value in the map's unit; NaN is not available, infinity out of range."""
    signal, mapped = channel.signal, channel.mapped
    ones = -(1 << signal.length - 1) if signal.is_signed else (1 << signal.length) - 1
    has_ones = channel.integrity.not_available and signal.length > 1 and not signal.is_float
    if has_ones and raw == ones:
        return math.nan
    value = (raw * signal.scale + signal.offset) * mapped.factor + mapped.offset
    low, high = limits_of(channel)
    return float(value) if math.isfinite(value) and low <= value <= high else math.inf


class Reference:
    """The rules frame by frame: length, checksum, counter, multiplexer, value."""

    def __init__(self, bus_map: BusMap, names: Sequence[str]) -> None:
        channels = bus_map.sources(names)
        self._channels = [bus_map.channels[name] for name in channels]
        self._due: dict[str, int] = {}
        self.counts = {each.message.name: Counter[str]() for each in self._channels}
        self.unmapped = 0

    def push(self, frame: Frame) -> Values:
        mine = [c for c in self._channels if frame[1:3] == _place(c.message)]
        if not mine:
            self.unmapped += 1
            return None
        message, counts = mine[0].message, self.counts[mine[0].message.name]
        counts["received"] += 1
        reason, values = self._read(message, mine, frame.data)
        if reason:
            counts[reason] += 1
        for value in values.values():
            counts["not_available"] += math.isnan(value)
            counts["out_of_range"] += math.isinf(value)
        return (values or None) if not reason else None

    @property
    def counters(self) -> dict[str, MessageCounters]:
        needed = {c.message.name for c in self._channels if not c.mapped.is_optional}
        return {
            name: MessageCounters(**counts)
            for name, counts in self.counts.items()
            if counts["received"] or name in needed
        }

    def _read(
        self, message: Message, mine: list[BusChannel], sent: bytes
    ) -> tuple[str, dict[str, float]]:
        integrity, size = mine[0].integrity, message.length
        if len(sent) > size or (len(sent) < size and not message.is_multiplexed()):
            return "length", {}
        data = sent.ljust(size, b"\0")
        if integrity.checksum:
            place = message.get_signal_by_name(integrity.checksum).start // 8
            wanted = payload_checksum(integrity.algorithm, message.frame_id, data, place)
            if data[place] != wanted:
                return "checksum", {}
        if integrity.counter and not self._counts_on(message, integrity.counter, data):
            return "stuck", {}
        carried = [c for c in mine if self._is_carried(message, c.signal, data)]
        tells = any(c.range and self._is_carried(message, c.range, data) for c in mine)
        if any(len(sent) <= last_byte(message, c.signal) for c in carried):
            return "length", {}
        values = {c.mapped.name: value_of(c, raw_of(message, c.signal, data)) for c in carried}
        return ("" if carried or tells else "other"), values

    def _counts_on(self, message: Message, name: str, data: bytes) -> bool:
        signal = message.get_signal_by_name(name)
        mask = (1 << signal.length) - 1
        count, due = int(raw_of(message, signal, data)) & mask, self._due.get(message.name)
        if due is not None and count == (due - 1) & mask:
            return False
        self.counts[message.name]["lost"] += 0 if due is None else (count - due) & mask
        self._due[message.name] = (count + 1) & mask
        return True

    def _is_carried(self, message: Message, signal: Signal, data: bytes) -> bool:
        while signal.multiplexer_signal is not None:
            switch = message.get_signal_by_name(signal.multiplexer_signal)
            if raw_of(message, switch, data) not in (signal.multiplexer_ids or ()):
                return False
            signal = switch
        return True


def _place(message: Message) -> tuple[int, bool]:
    return message.frame_id, message.is_extended_frame


def last_byte(message: Message, signal: Signal) -> int:
    """Return the last byte that the signal's value depends on."""
    only = [bytes(k * [0] + [255] + (message.length - k - 1) * [0]) for k in range(message.length)]
    nothing = str(raw_of(message, signal, bytes(message.length)))
    return max(k for k, data in enumerate(only) if str(raw_of(message, signal, data)) != nothing)


def in_blocks(subject: Decoding, frames: list[Frame], cuts: Sequence[int]) -> list[Values]:
    edges = sorted({0, len(frames), *(cut for cut in cuts if cut < len(frames))})
    return [each for a, b in pairwise(edges) for each in subject.push(frames[a:b])]


def bits_of(found: list[Values]) -> list[dict[str, bytes] | None]:
    return [
        values and {name: np.float64(value).tobytes() for name, value in values.items()}
        for values in found
    ]


def assert_alike(
    bus_map: BusMap, names: Sequence[str], frames: list[Frame], cuts: list[int]
) -> None:
    reference, whole, cut = (
        Reference(bus_map, names),
        Decoding(bus_map, names),
        Decoding(bus_map, names),
    )
    expected, found = [reference.push(frame) for frame in frames], whole.push(frames)
    for a, b in zip(expected, found, strict=True):
        assert (a is None) == (b is None)
        assert (a or {}) == pytest.approx(b or {}, rel=1e-12, abs=1e-9, nan_ok=True)
    counters = reference.counters
    assert whole.decoder.counters == counters
    assert whole.decoder.unmapped == reference.unmapped
    # AND where blocks begin and end changes no bit
    assert bits_of(in_blocks(cut, frames, cuts)) == bits_of(found)
    assert cut.decoder.counters == counters
    assert cut.decoder.unmapped == reference.unmapped


cuts = st.lists(st.integers(0, 60), max_size=4)


@inputs(200)
@given(
    answers=st.lists(
        st.tuples(
            st.sampled_from([0x04, 0x03, 0x10, 0x24]),
            st.sampled_from([0x41, 0x41, 0x42]),
            st.sampled_from([0x0C, 0x0D, 0x10, 0x34, 0x5E, 0x03, 0x99]),
            st.binary(max_size=9),
        ),
        max_size=40,
    ),
    cuts=cuts,
    names=st.sets(st.sampled_from(OBD.names), min_size=1),
)
def test_multiplexed_answers_give_the_same_values_and_counters(
    answers: list[tuple[int, int, int, bytes]], cuts: list[int], names: set[str]
) -> None:
    frames = [
        Frame(i, 0x7E8, False, bytes((first, service, pid))[: 3 - len(rest) % 2] + rest)
        for i, (first, service, pid, rest) in enumerate(answers)
    ]
    assert_alike(OBD, sorted(names), frames, cuts)


@st.composite
def layouts(draw: st.DrawFn) -> tuple[int, str, str, list[str]]:
    """Message length, DBC text of its signals, text of the map, names of the signals wanted."""
    size = draw(st.sampled_from([1, 2, 3, 8, 8, 8, 12, 64]))
    bits, kinds, lines, entries = 8 * size, [], [], []
    multiplexed = size > 1 and draw(st.booleans())
    if multiplexed:
        lines.append(' SG_ Mux M : 0|2@1+ (1,0) [0|0] "" A')
    for number in range(draw(st.integers(1, 4))):
        is_float = draw(st.sampled_from([False, False, True])) and bits >= 32
        length = draw(st.sampled_from([32, 64])) if is_float else draw(st.integers(1, 64))
        length = min(length, bits) if not is_float or bits >= 64 else 32
        first = draw(st.integers(0, bits - length))
        is_big = draw(st.booleans())
        start = 8 * (first // 8) + 7 - first % 8 if is_big else first
        sign = "-" if is_float else draw(st.sampled_from("+-")) if length > 1 else "+"
        scale, offset = draw(st.sampled_from([(1, 0), (0.25, -7), (-3, 2), (0.001, 0), (1, 5)]))
        low, high = draw(st.sampled_from([(0, 0), (-10, 100), (5, 2**31)]))
        place = draw(st.sampled_from(["", " m0", " m1", " m3"])) if multiplexed else ""
        lines.append(
            f" SG_ X{number}{place} : {start}|{length}@{0 if is_big else 1}{sign} "
            f'({scale},{offset}) [{low}|{high}] "" A'
        )
        if is_float:
            kinds.append(f"SIG_VALTYPE_ 100 X{number} : {length // 32};")
        factor, shift = draw(st.sampled_from([(1.0, 0.0), (0.1, 0.0), (-2.0, 0.3)]))
        entries.append(
            f'x{number} = {{ message = "M", signal = "X{number}", '
            f"factor = {factor}, offset = {shift} }}"
        )
    integrity = [draw(st.sampled_from(['not_available = "all_ones"', ""]))]
    if draw(st.booleans()):
        length = draw(st.integers(1, min(bits, 9)))
        sign = draw(st.sampled_from("+-")) if length > 1 else "+"
        lines.append(f' SG_ Count : {bits - length}|{length}@1{sign} (1,0) [0|0] "" A')
        integrity.append('counter = "Count"')
    if draw(st.booleans()):
        lines.append(f' SG_ Crc : {8 * draw(st.integers(0, size - 1))}|8@1+ (1,0) [0|0] "" A')
        algorithm = draw(st.sampled_from(["crc8_sae_j1850", "crc8_sae_j1850_id"]))
        integrity.append(f'checksum = "Crc"\nalgorithm = "{algorithm}"')
    text = "\n".join(lines) + "\n\n" + "\n".join(kinds)
    own = "[integrity]\n" + "\n".join(integrity) + "\n[signals]\n" + "\n".join(entries)
    return size, text, own, [entry.split()[0] for entry in entries]


SHORT_FOR_ONE_GROUP = (  # whose other group marks its value as not available
    2,
    ' SG_ Mux M : 0|2@1+ (1,0) [0|0] "" A\n SG_ X0 : 0|2@1+ (1,0) [0|0] "" A\n'
    ' SG_ X1 m3 : 7|2@1+ (1,0) [0|0] "" A\n\n',
    '[integrity]\nnot_available = "all_ones"\n[signals]\n'
    'x0 = { message = "M", signal = "X0", factor = 1.0, offset = 0.0 }\n'
    'x1 = { message = "M", signal = "X1", factor = 1.0, offset = 0.0 }',
    ["x0", "x1"],
)


@inputs(120)
@given(layout=layouts(), seed=st.integers(0, 2**32 - 1), cuts=cuts)
@example(layout=SHORT_FOR_ONE_GROUP, seed=0, cuts=[])
def test_any_layout_gives_the_same_values_and_counters(
    tmp_path_factory: pytest.TempPathFactory,
    layout: tuple[int, str, str, list[str]],
    seed: int,
    cuts: list[int],
) -> None:
    size, signals, own, names = layout
    bus_map = bus_map_of(tmp_path_factory.mktemp("layout"), size, signals, own)
    message = bus_map.channels[names[0]].message
    integrity = bus_map.channels[names[0]].integrity
    rng = np.random.default_rng(seed)
    frames = []
    for number in range(rng.integers(0, 60)):
        data = bytearray(
            rng.bytes(size) if rng.random() < 0.7 else bytes([rng.choice([0, 255])]) * size
        )
        if integrity.checksum and rng.random() < 0.9:
            place = message.get_signal_by_name(integrity.checksum).start // 8
            data[place] = payload_checksum(integrity.algorithm, 100, data, place)
        if rng.random() < 0.1:
            data = data[: rng.integers(0, size)] + bytes(rng.integers(0, 2))
        frames.append(Frame(number, 100, False, bytes(data)))
    assert_alike(bus_map, names, frames, cuts)


def test_signals_of_more_than_64_bits_are_decoded(tmp_path: Path) -> None:
    bus_map = bus_map_of(
        tmp_path,
        12,
        ' SG_ X0 : 5|70@1- (0.5,1) [0|0] "" A\n SG_ X1 : 7|90@0+ (1,0) [0|0] "" A',
        '[signals]\nx0 = { message = "M", signal = "X0" }\nx1 = { message = "M", signal = "X1" }\n',
    )
    rng = np.random.default_rng(1)
    frames = [Frame(i, 100, False, rng.bytes(12)) for i in range(20)]
    assert_alike(bus_map, ["x0", "x1"], frames, [7])


@pytest.mark.parametrize(
    ("signal", "choices", "raw", "is_value"),
    [
        ("0|8@1+ (32,0)", '255 "SNA" 254 "Fehler"', [253, 254, 255], [True, False, False]),
        ("7|16@0+ (0.25,0)", '65535 "Signal ungültig"', [65534, 65535], [True, False]),
        (
            "0|8@1- (32,0)",
            '127 "error" -128 "not available"',
            [126, 127, 128],
            [True, False, False],
        ),
        ("0|2@1+ (1,0)", '0 "off" 1 "on" 3 "SNA"', [0, 1, 2, 3], [True, True, True, False]),
        ("0|2@1+ (1,0)", '0 "a" 1 "b" 2 "c" 3 "d"', [0, 3], [True, True]),  # states alone
        ("0|2@1+ (1,0)", '1 "on" 2 "error" 3 "SNA"', [0, 1], [True, True]),
        ("0|8@1+ (1,0)", '0 "stands" 9 "default"', [0, 9, 255], [True, True, True]),
        ("0|8@1+ (1,0)", '0 "Signal_invalid" 99 "Error"', [0, 1, 99], [False, True, False]),
        ("0|8@1+ (1,0)", '0 "No error" 1 "No_fault" 2 "Fault"', [0, 1, 2], [True, True, False]),
    ],
)
def test_what_a_database_names_at_the_end_of_a_range_or_invalid_is_no_value(
    tmp_path: Path, signal: str, choices: str, raw: list[int], is_value: list[bool]
) -> None:
    text = f' SG_ X0 : {signal} [0|0] "" A\n\nVAL_ 100 X0 {choices} ;'
    own = '[signals]\nx0 = { message = "M", signal = "X0" }\n'
    subject = Decoding(bus_map_of(tmp_path, 2, text, own), ["x0"])
    frames = [Frame(0, 100, False, each.to_bytes(2, "little")) for each in raw]
    if "@0" in signal:
        frames = [Frame(0, 100, False, each.to_bytes(2, "big")) for each in raw]
    found = [not math.isnan(values["x0"]) for values in subject.push(frames) if values]
    assert found == is_value
