import math
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import dbc
from monitor.base.errors import SignalMapError
from monitor.base.types import Frame
from monitor.decode.bus_map import BusMap, load_database, load_pairs
from monitor.decode.checksum import payload_checksum
from monitor.decode.decoder import Decoder
from tests.helpers.examples import inputs

ECU = load_pairs([(dbc.path("o2_ecu.dbc"), dbc.path("o2_ecu.toml"))])
AIR = ECU.channels["air_mass_mg"].message
OBD = load_pairs([(dbc.path("obd2.dbc"), dbc.path("obd2.toml"))])


def air(count: int, **values: float) -> Frame:
    sent = {"AirMass": 300.0, "AirMassFlow": 40.0, "ManifoldPressure": 50.0} | values
    payload = bytearray(AIR.encode({**sent, "AliveCounter": count, "Checksum": 0}, strict=False))
    payload[7] = payload_checksum("crc8_sae_j1850_id", AIR.frame_id, payload, 7)
    return Frame(0, AIR.frame_id, False, bytes(payload))


def decoder(*names: str) -> Decoder:
    return Decoder(ECU, names or ECU.names)


def bus_map_of(tmp_path: Path, database: str, signals: Sequence[str], extra: str = "") -> BusMap:
    dbc_path, map_path = tmp_path / "own.dbc", tmp_path / "own.toml"
    dbc_path.write_text(f'VERSION ""\n\nBU_: A\n\nBO_ 100 M: 8 A\n{database}\n')
    lines = [f'{name.lower()} = {{ message = "M", signal = "{name}" }}\n' for name in signals]
    map_path.write_text(f"{extra}[signals]\n{''.join(lines)}")
    return load_pairs([(dbc_path, map_path)])


def test_a_sound_frame_gives_its_values_in_canonical_units() -> None:
    subject = decoder("manifold_pressure_kpa", "air_mass_mg")
    assert subject.push(air(0)) == ((0, 1), (50.0, 300.0))
    counters = subject.counters["ECU_Air"]
    assert (counters.received, counters.used) == (1, 1)


def test_frames_nobody_asked_for_are_skipped_and_counted() -> None:
    subject = decoder("air_mass_mg")
    assert subject.push(Frame(0, 0x123, False, bytes(8))) is None
    assert subject.push(air(0)._replace(is_extended=True)) is None
    assert subject.unmapped == 2
    assert subject.identifiers == ((AIR.frame_id, False),)


@pytest.mark.parametrize("size", [0, 7, 9, 64])
def test_a_frame_of_another_length_is_dropped(size: int) -> None:
    subject = decoder()
    assert subject.push(Frame(0, AIR.frame_id, False, bytes(size))) is None
    assert subject.counters["ECU_Air"].length == 1


@pytest.mark.parametrize("bit", range(64))
def test_any_flipped_bit_breaks_the_checksum(bit: int) -> None:
    subject = decoder()
    payload = bytearray(air(3).data)
    payload[bit // 8] ^= 1 << bit % 8
    assert subject.push(Frame(0, AIR.frame_id, False, bytes(payload))) is None
    assert subject.counters["ECU_Air"].checksum == 1
    assert subject.counters["ECU_Air"].used == 0


def test_a_frame_under_a_neighbours_identifier_breaks_the_checksum() -> None:
    subject = decoder()
    assert subject.push(air(0)._replace(can_id=0x0C1)) is None
    assert subject.counters["ECU_Fuel"].checksum == 1


def test_a_stuck_counter_is_dropped_and_a_jump_is_used_and_counted() -> None:
    subject = decoder()
    used = [subject.push(air(count)) is not None for count in (14, 14, 15, 0, 3, 3)]
    assert used == [True, False, True, True, True, False]
    counters = subject.counters["ECU_Air"]
    assert (counters.stuck, counters.lost, counters.used) == (2, 2, 4)


def test_after_a_reset_any_counter_is_taken() -> None:
    subject = decoder()
    subject.push(air(5))
    subject.reset()
    assert subject.push(air(5)) is not None
    assert subject.counters["ECU_Air"].lost == 0


def test_all_bits_set_means_not_available() -> None:
    subject = decoder("air_mass_mg", "maf_kg_h")
    update = subject.push(air(0, AirMass=131071 * 0.02))
    assert update is not None
    assert math.isnan(update[1][0])
    assert update[1][1] == 40.0
    assert subject.counters["ECU_Air"].not_available == 1


@pytest.mark.parametrize(
    ("pressure", "expected"), [(4.99, math.inf), (5.0, 5.0), (350.0, 350.0), (350.01, math.inf)]
)
def test_an_implausible_value_is_marked(pressure: float, expected: float) -> None:
    subject = decoder("manifold_pressure_kpa")
    update = subject.push(air(0, ManifoldPressure=pressure))
    assert update == ((0,), (expected,))
    assert subject.counters["ECU_Air"].out_of_range == (expected == math.inf)


def test_single_bits_have_no_not_available_value(tmp_path: Path) -> None:
    bus_map = bus_map_of(
        tmp_path,
        ' SG_ One : 3|1@1+ (1,0) [0|1] "" A',
        ["One"],
        '[integrity]\nnot_available = "all_ones"\n',
    )
    assert Decoder(bus_map, ["one"]).push(Frame(0, 100, False, b"\x08" * 8)) == ((0,), (1.0,))


@pytest.mark.parametrize("start", [1, 12, 47])
def test_a_checksum_across_bytes_is_refused(tmp_path: Path, start: int) -> None:
    signals = f' SG_ One : 0|1@1+ (1,0) [0|1] "" A\n SG_ Crc : {start}|8@1+ (1,0) [0|0] "" A'
    bus_map = bus_map_of(tmp_path, signals, ["One"], '[integrity]\nchecksum = "Crc"\n')
    with pytest.raises(SignalMapError, match=r"checksum M\.Crc .* a byte of its own|unsigned byte"):
        Decoder(bus_map, ["one"])


@inputs(200)
@given(payload=st.binary(min_size=8, max_size=8), count=st.integers(0, 15), data=st.data())
def test_the_generated_decoder_agrees_with_cantools(
    payload: bytes, count: int, data: st.DataObject
) -> None:
    name = data.draw(st.sampled_from(ECU.names))
    message = ECU.channels[name].message
    raw = bytearray(payload)
    raw[6] = raw[6] & 0x0F | count << 4
    raw[7] = payload_checksum("crc8_sae_j1850_id", message.frame_id, raw, 7)
    update = Decoder(ECU, [name]).push(Frame(0, message.frame_id, False, bytes(raw)))
    signal = ECU.channels[name].signal
    decoded = message.decode(bytes(raw), decode_choices=False)
    unscaled = message.decode(bytes(raw), decode_choices=False, scaling=False)
    assert isinstance(decoded, dict)
    assert isinstance(unscaled, dict)
    assert update is not None
    if unscaled[signal.name] == (1 << signal.length) - 1:
        assert math.isnan(update[1][0])
    elif update[1][0] != math.inf:
        assert update[1][0] == decoded[signal.name]


@st.composite
def layouts(draw: st.DrawFn) -> str:
    """One signal of any length, place, byte order and sign."""
    length = draw(st.integers(1, 64))
    first = draw(st.integers(0, 64 - length))
    is_big = draw(st.booleans())
    start = 8 * (first // 8) + 7 - first % 8 if is_big else first
    sign = draw(st.sampled_from("+-")) if length > 1 else "+"
    scale, offset = draw(st.sampled_from([(1, 0), (0.25, -7), (3, 2), (0.001, 0)]))
    return f' SG_ X : {start}|{length}@{0 if is_big else 1}{sign} ({scale},{offset}) [0|0] "" A'


@inputs(150)
@given(layout=layouts(), payload=st.binary(min_size=8, max_size=8))
def test_any_layout_agrees_with_cantools(
    tmp_path_factory: pytest.TempPathFactory, layout: str, payload: bytes
) -> None:
    bus_map = bus_map_of(tmp_path_factory.mktemp("layout"), layout, ["X"])
    decoded = bus_map.channels["x"].message.decode(payload)
    assert isinstance(decoded, dict)
    update = Decoder(bus_map, ["x"]).push(Frame(0, 100, False, payload))
    # cantools keeps integers beyond 2^53 exact, values here are floats
    assert update is not None
    assert update[1][0] == pytest.approx(decoded["X"], rel=1e-15, abs=1e-12)


@pytest.mark.parametrize("bits", [32, 64])
def test_floats_are_decoded(tmp_path: Path, bits: int) -> None:
    layout = (
        f' SG_ X : 0|{bits}@1- (2,1) [0|0] "" A\n\nSIG_VALTYPE_ 100 X : {1 if bits == 32 else 2};'
    )
    bus_map = bus_map_of(tmp_path, layout, ["X"])
    payload = bus_map.channels["x"].message.encode({"X": 4.0})
    assert Decoder(bus_map, ["x"]).push(Frame(0, 100, False, payload)) == ((0,), (4.0,))


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        ("04410C1AF8", ((0,), (1726.0,))),
        ("04410C1AF8AAAAAA", ((0,), (1726.0,))),
        ("0341030200000000", ((1,), (1.0,))),
        ("0341030400000000", ((1,), (0.0,))),
        ("0341050000000000", None),  # a parameter nobody asked for
        ("04420C1AF8000000", None),  # another service
        ("04410C1A", None),  # cut short
        ("", None),
    ],
)
def test_obd_responses_are_told_apart_by_parameter(
    payload: str, expected: tuple[tuple[int], tuple[float]] | None
) -> None:
    subject = Decoder(OBD, ["engine_speed_rpm", "closed_loop"])
    assert subject.push(Frame(0, 0x7E8, False, bytes.fromhex(payload))) == expected


def test_every_mapped_obd_parameter_agrees_with_cantools() -> None:
    message = load_database(dbc.path("obd2.dbc")).get_message_by_name("OBD_Response")
    for name in OBD.channels:
        channel = OBD.channels[name]
        ids = channel.signal.multiplexer_ids
        assert ids is not None
        if name not in OBD.names:
            continue
        payload = bytes([4, 0x41, ids[0], 0x4E, 0x20, 0, 0, 0])
        decoded = message.decode(payload, decode_choices=False)
        assert isinstance(decoded, dict)
        update = Decoder(OBD, [name]).push(Frame(0, 0x7E8, False, payload))
        wanted = decoded[channel.signal.name]
        assert isinstance(wanted, int | float)
        value = wanted * channel.mapped.factor + channel.mapped.offset
        assert update is not None
        assert update[1][0] == math.inf or math.isclose(update[1][0], value, rel_tol=1e-12)
