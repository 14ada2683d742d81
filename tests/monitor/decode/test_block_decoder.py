"""Blocks of frames are decoded as frame by frame: every value, every counter, bit for bit."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import dbc
from monitor.base.errors import SignalMapError
from monitor.base.types import Frame
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap, load_pairs
from monitor.decode.checksum import payload_checksum
from monitor.decode.decoder import Decoder
from monitor.frames.blocks import block_of
from tests.helpers.examples import inputs

ECU = load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))])
OBD = load_pairs([(dbc.path("obd2.dbc"), dbc.path("obd2.toml"))])

Values = list[tuple[int, int, bytes]]  # frame, channel, bits of the value


def bits_of(value: float) -> bytes:
    return np.float64(value + 0.0).tobytes()  # the sign of a zero says nothing


def one_by_one(decoder: Decoder, frames: Sequence[Frame]) -> Values:
    found: Values = []
    for place, frame in enumerate(frames):
        update = decoder.push(frame)
        if update is not None:
            found += [(place, i, bits_of(v)) for i, v in zip(*update, strict=True)]
    return sorted(found)


def in_blocks(decoder: BlockDecoder, frames: Sequence[Frame], cuts: Sequence[int]) -> Values:
    found: Values = []
    edges = sorted({0, len(frames), *(cut for cut in cuts if cut < len(frames))})
    for begin, end in pairwise(edges):
        for part in decoder.push(block_of(list(frames[begin:end]))):
            assert (np.diff(part.rows) > 0).all()
            for channel, values in zip(part.channels, part.values, strict=True):
                for row, value in zip(part.rows.tolist(), values, strict=True):
                    found.append((begin + row, channel, bits_of(value)))
    return sorted(found)


def assert_alike(
    bus_map: BusMap, names: Sequence[str], frames: list[Frame], cuts: list[int]
) -> None:
    one, many = Decoder(bus_map, names), BlockDecoder(bus_map, names)
    assert in_blocks(many, frames, cuts) == one_by_one(one, frames)
    assert many.counters == one.counters
    assert many.unmapped == one.unmapped
    for attribute in ("names", "channels", "derived", "timeouts_ns"):
        assert getattr(many, attribute) == getattr(one, attribute)


cuts = st.lists(st.integers(0, 60), max_size=4)


# The project's own ECU


@st.composite
def ecu_frames(draw: st.DrawFn) -> list[Frame]:
    """Frames whose counters advance, stand still or jump; some with a wrong bit or length."""
    messages = sorted({c.message.frame_id for c in ECU.channels.values()})
    counts = dict.fromkeys(messages, draw(st.integers(0, 15)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    frames = []
    for _ in range(draw(st.integers(0, 60))):
        can_id = draw(st.sampled_from(messages[: draw(st.sampled_from([1, 2, 7]))]))
        counts[can_id] = (counts[can_id] + draw(st.sampled_from([1, 1, 1, 1, 0, 2, 5]))) % 16
        raw = bytearray(rng.choice([0, 1, 40, 255], 8).astype(np.uint8).tobytes())
        raw[6] = raw[6] & 0x0F | counts[can_id] << 4
        raw[7] = payload_checksum("crc8_sae_j1850_id", can_id, raw, 7)
        what = draw(st.sampled_from(["sound"] * 6 + ["bit", "length", "long", "extended", "other"]))
        if what == "bit":
            raw[draw(st.integers(0, 7))] ^= 1 << draw(st.integers(0, 7))
        data = {"length": bytes(raw[:5]), "long": bytes(raw) + bytes(4)}.get(what, bytes(raw))
        number = 0x700 if what == "other" else can_id
        frames.append(Frame(len(frames), number, what == "extended", data))
    return frames


@inputs(200)
@given(frames=ecu_frames(), cuts=cuts, names=st.sets(st.sampled_from(ECU.names), min_size=1))
def test_protected_frames_give_the_same_values_and_counters(
    frames: list[Frame], cuts: list[int], names: set[str]
) -> None:
    assert_alike(ECU, sorted(names), frames, cuts)


# Answers of a scan tool's queries, told apart by multiplexers


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


# Any layout


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


def bus_map_of(folder: Path, size: int, signals: str, own: str) -> BusMap:
    dbc_path, map_path = folder / "own.dbc", folder / "own.toml"
    dbc_path.write_text(f'VERSION ""\n\nBU_: A\n\nBO_ 100 M: {size} A\n{signals}\n')
    map_path.write_text(own)
    return load_pairs([(dbc_path, map_path)])


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


def test_a_checksum_across_bytes_is_refused(tmp_path: Path) -> None:
    signals = ' SG_ X0 : 0|1@1+ (1,0) [0|1] "" A\n SG_ Crc : 12|8@1+ (1,0) [0|0] "" A'
    own = '[integrity]\nchecksum = "Crc"\n[signals]\nx0 = { message = "M", signal = "X0" }\n'
    with pytest.raises(SignalMapError, match="unsigned byte of its own"):
        BlockDecoder(bus_map_of(tmp_path, 8, signals, own), ["x0"])


def test_a_restart_forgets_counters_and_counts() -> None:
    frame = Frame(0, 100, False, b"")
    subject = BlockDecoder(ECU, ECU.names)
    subject.push(block_of([frame]))
    subject.restart()
    assert subject.unmapped == 0
    assert all(counters.received == 0 for counters in subject.counters.values())
