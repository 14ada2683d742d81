"""Other values in an ECU's frames: nothing changes but the signal, the counter, the checksum."""

import math
from pathlib import Path

import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import LinearConversion
from hypothesis import assume, given
from hypothesis import strategies as st

from monitor.base.types import Frame
from monitor.decode.bus_map import BusChannel, BusMap, load_pairs
from monitor.decode.checksum import payload_checksum
from monitor.decode.raw_values import bit_position, not_available_raw
from monitor.decode.signal_map import Integrity, MappedSignal
from monitor.inject.rewrite import MessageWriter, SignalWriter, writers
from tests.helpers.examples import inputs
from tests.helpers.logs.bus_maps import OBD, OWN, values_of

LAMBDA_ID, CHECKSUM = 0xC2, 7

# Lambda where it is awkward: big endian in a protected message, floating point.
AWKWARD = """
VERSION ""
NS_ :
BS_:
BU_: E
BO_ 257 Motorola: 6 E
 SG_ Lam : 5|14@0+ (0.0002,0) [0|3] "" E
 SG_ Sum : 47|8@0+ (1,0) [0|255] "" E
 SG_ Count : 27|4@0+ (1,0) [0|15] "" E
BO_ 2147484162 Real: 8 E
 SG_ Lam : 16|32@1- (1,0) [0|0] "" E
SIG_VALTYPE_ 2147484162 Lam : 1;
"""
PROTECTION = {
    "Motorola": 'checksum = "Sum"\nalgorithm = "crc8_sae_j1850"\ncounter = "Count"\n'
    'not_available = "all_ones"',
    "Real": "",
}


def awkward(folder: Path, message: str) -> BusMap:
    (folder / "x.dbc").write_text(AWKWARD)
    (folder / "x.toml").write_text(
        f"[integrity]\n{PROTECTION[message]}\n[signals]\n"
        f'lambda_measured = {{ message = "{message}", signal = "Lam" }}\n'
    )
    return load_pairs([(folder / "x.dbc", folder / "x.toml")])


def writer_of(bus_map: BusMap) -> MessageWriter:
    message = bus_map.channels["lambda_measured"].message
    return writers(bus_map.channels)[message.frame_id, message.is_extended_frame]


def sound(payload: bytes) -> bytes:
    """The payload of an ECU_Lambda frame with its right checksum."""
    crc = payload_checksum("crc8_sae_j1850_id", LAMBDA_ID, payload, CHECKSUM)
    return payload[:CHECKSUM] + bytes([crc])


payloads = st.binary(min_size=8, max_size=8).map(sound)


@given(payloads, st.integers(-40, 40))
def test_a_counter_is_shifted_round_its_end_and_nothing_else(data: bytes, shift: int) -> None:
    written = writer_of(OWN).write(data, {}, shift)
    assert written[6] >> 4 == ((data[6] >> 4) + shift) % 16
    assert (written[:6], written[6] & 0xF) == (data[:6], data[6] & 0xF)
    assert sound(written) == written


@pytest.mark.parametrize("message", sorted(PROTECTION))
@inputs(50)
@given(data=st.data())
def test_awkward_signals_are_written_as_another_encoder_writes_them(
    tmp_path_factory: pytest.TempPathFactory, message: str, data: st.DataObject
) -> None:
    # GIVEN any payload of a message with lambda in an awkward place
    bus_map = awkward(tmp_path_factory.mktemp("map"), message)
    definition = bus_map.channels["lambda_measured"].message
    payload = data.draw(st.binary(min_size=definition.length, max_size=definition.length))
    value = data.draw(st.floats(0.51, 1.99))
    writer = writer_of(bus_map)
    written = writer.write(payload, {"lambda_measured": value})
    # THEN the project's decoder and cantools read it within half a step
    half = writer.signals["lambda_measured"].step / 2 + 1e-6  # a float of 32 bits
    frame = Frame(0, definition.frame_id, definition.is_extended_frame, written)
    if writer.is_sound(written):
        assert values_of(bus_map, "lambda_measured", [frame]) == [pytest.approx(value, abs=half)]
    # AND no other signal has changed, but the checksum
    before, after = decoded(definition, payload), decoded(definition, written)
    assert after.pop("Lam") == pytest.approx(value, abs=half)
    assert before.keys() == {*after, "Lam"}
    for name in before.keys() - {"Lam", "Sum"}:
        assert before[name] == after[name]
    # AND of the bits that belong to no signal none has
    assert len(written) == len(payload)
    assert outside(definition, written) == outside(definition, payload)


@st.composite
def channels(draw: st.DrawFn) -> BusChannel:
    """A signal anywhere in a message of 1 to 64 bytes."""
    n_bytes = draw(st.sampled_from([1, 2, 3, 7, 8, 12, 64]))
    n_bits = draw(st.integers(2, min(32, 8 * n_bytes)))
    lowest = draw(st.integers(0, 8 * n_bytes - n_bits))  # bit of the payload's integer
    order = draw(st.sampled_from(["little_endian", "big_endian"]))
    highest = 8 * n_bytes - lowest - n_bits  # of big endian, counted from the first byte's top
    start = lowest if order == "little_endian" else 8 * (highest // 8) + 7 - highest % 8
    scale = draw(st.sampled_from([1, 0.001, -0.25, 3.5]))
    conversion = LinearConversion(scale=scale, offset=draw(st.integers(-9, 9)), is_float=False)
    signed = draw(st.booleans())
    signal = Signal("S", start, n_bits, order, is_signed=signed, conversion=conversion)
    message = Message(0x123, "M", n_bytes, [signal])
    factor = draw(st.sampled_from([1.0, -2.0, 0.1]))
    mapped = MappedSignal("own", "M", "S", factor=factor, offset=draw(st.floats(-2, 2)))
    availability = Integrity(not_available=draw(st.sampled_from(["", "all_ones"])))
    return BusChannel(
        mapped=mapped,
        message=message,
        signal=signal,
        integrity=availability,
        dbc=Path("x.dbc"),
        map_path=Path("x.toml"),
    )


@given(channels(), st.data())
def test_a_signal_anywhere_is_as_cantools_has_it(channel: BusChannel, data: st.DataObject) -> None:
    message, mapped, writer = channel.message, channel.mapped, SignalWriter(channel)
    payload = data.draw(st.binary(min_size=message.length, max_size=message.length))

    def by_cantools(payload: bytes) -> float:
        return float(decoded(message, payload)["S"]) * mapped.factor + mapped.offset

    # GIVEN any payload THEN it is read as another decoder reads it, or not available
    read = writer.read(payload)
    raw = message.decode(payload, scaling=False)["S"]
    is_missing = raw == not_available_raw(channel)
    assert math.isnan(read) if is_missing else read == pytest.approx(by_cantools(payload), abs=1e-6)
    # AND any reading that the signal can hold is written within half a step, around it nothing
    source = data.draw(st.binary(min_size=message.length, max_size=message.length))
    assume(not math.isnan(writer.read(source)))
    wanted = writer.read(source) + data.draw(st.floats(-0.49, 0.49)) * writer.step
    written = writer.write(payload, wanted)
    assert by_cantools(written) == pytest.approx(writer.read(source), abs=1e-6)
    assert outside(message, written) == outside(message, payload)
    assert writer.write(payload, read) == payload


def decoded(definition: object, payload: bytes) -> dict[str, float]:
    return dict(definition.decode(payload, decode_choices=False))  # type: ignore[attr-defined]


def outside(definition: object, payload: bytes) -> int:
    """The bits of a payload that belong to no signal."""
    words = {"little_endian": 0, "big_endian": 0}
    for signal in definition.signals:  # type: ignore[attr-defined]
        mask = (1 << signal.length) - 1
        words[signal.byte_order] |= mask << bit_position(definition, signal)  # type: ignore[arg-type]
    n = len(payload)
    little = words["little_endian"].to_bytes(n, "little")
    big = words["big_endian"].to_bytes(n, "big")
    return int.from_bytes(
        bytes(p & ~a & ~b & 0xFF for p, a, b in zip(payload, little, big, strict=True)), "big"
    )


@pytest.mark.parametrize(
    ("value", "raw"),
    [(math.nan, 0xFFFF), (1e9, 0xFFFE), (math.inf, 0xFFFE), (-1e9, 0), (-math.inf, 0)],
)
def test_not_available_has_its_own_value_and_what_does_not_fit_saturates_beside_it(
    value: float, raw: int
) -> None:
    written = writer_of(OWN).write(sound(bytes(8)), {"lambda_measured": value})
    assert int.from_bytes(written[:2], "little") == raw


def test_an_answer_to_another_question_is_left_alone() -> None:
    # GIVEN OBD answers: PID 0C, engine speed, and PID 34, lambda
    writer = writer_of(OBD)
    speed, reading = bytes.fromhex("04410C1AF8000000"), bytes.fromhex("0641348000800000")
    # THEN only that of lambda carries it, also without padding
    signal = writer.signals["lambda_measured"]
    assert not signal.is_in(speed)
    assert writer.write(speed, {"lambda_measured": 1.2}) == speed
    assert signal.is_in(reading)
    written = writer.write(reading[:7], {"lambda_measured": 1.2})
    assert len(written) == 7
    assert signal.read(written) == pytest.approx(1.2, abs=signal.step / 2)
    assert not signal.is_in(reading[:4])
