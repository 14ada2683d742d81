"""J1939: a message is known by its parameter group, whatever its source address."""

import math
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base.errors import SignalMapError
from monitor.base.types import Frame
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import BusMap, load_pairs
from monitor.frames.blocks import block_of
from tests.helpers.examples import inputs
from tests.helpers.logs.bus_maps import Decoding, Values, values_of

EEC1 = 0x0CF00400  # engine speed, from the engine at address 0
HEADER = 'VERSION ""\nNS_ :\nBS_:\nBU_: ECM\n'
MESSAGE = (
    'BO_ {number} {name}: 8 ECM\n SG_ EngSpeed : 24|16@1+ (0.125,0) [0|8031] "rpm" Vector__XXX\n'
)
ATTRIBUTES = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_ "VFrameFormat" "J1939PG";\n'
)
MAP = '[signals]\nengine_speed_rpm = { message = "EEC1", signal = "EngSpeed" }\n'


def bus(folder: Path, address: int, other: int | None = None) -> BusMap:
    """Return a map whose database states a source address, and perhaps a second sender."""
    text = HEADER + MESSAGE.format(number=EEC1 + address | 1 << 31, name="EEC1")
    if other is not None:
        text += MESSAGE.format(number=EEC1 + other | 1 << 31, name="EEC1_other")
    dbc, map_path = folder / "truck.dbc", folder / "truck.toml"
    dbc.write_text(text + ATTRIBUTES)
    map_path.write_text(MAP)
    return load_pairs([(dbc, map_path)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("j1939")


def speed(t_ns: int, source: int, rpm: float, priority: int = 3) -> Frame:
    raw = round(rpm / 0.125).to_bytes(2, "little")
    can_id = priority << 26 | 0xF00400 | source
    return Frame(t_ns, can_id, True, bytes(3) + raw + bytes(3))


def decoded(bus_map: BusMap, frames: list[Frame]) -> list[float]:
    return values_of(bus_map, "engine_speed_rpm", frames)


def test_a_wrong_source_address_in_the_database_hides_no_message(folder: Path) -> None:
    # GIVEN a database that states address 3, and an engine that sends under 0 and another priority
    frames = [speed(1, 0, 800.0), speed(2, 0, 900.0, priority=6)]
    assert decoded(bus(folder, 3), frames) == [800.0, 900.0]


def test_of_several_senders_the_first_counts_until_the_stated_one_is_heard(folder: Path) -> None:
    frames = [speed(1, 7, 700.0), speed(2, 9, 1.0), speed(3, 0, 800.0), speed(4, 7, 701.0)]
    assert decoded(bus(folder, 0), frames) == [700.0, 800.0]


def test_senders_that_the_database_parts_are_known_by_their_addresses(folder: Path) -> None:
    frames = [speed(1, 0, 800.0), speed(2, 1, 900.0), speed(3, 5, 1.0)]
    assert decoded(bus(folder, 0, other=1), frames) == [800.0]


def test_messages_of_one_group_and_address_are_parted_by_their_priorities(folder: Path) -> None:
    # GIVEN a database with the engine's group under priorities 3 and 6
    frames = [speed(1, 0, 800.0), speed(2, 0, 1.0, priority=6)]
    assert decoded(bus(folder, 0, other=0x0C000000), frames) == [800.0]


def test_a_group_may_come_from_anyone_and_other_messages_from_one_sender(folder: Path) -> None:
    any_source = BlockDecoder(bus(folder, 3), ["engine_speed_rpm"])
    assert (any_source.identifiers, any_source.groups) == ((), ((0xF00400, 0x3FFFF00),))
    stated = BlockDecoder(bus(folder, 0, other=1), ["engine_speed_rpm"])
    assert (stated.identifiers, stated.groups) == (((EEC1, True),), ())


@inputs(40)
@given(
    sources=st.lists(st.sampled_from([0, 3, 7]), min_size=1, max_size=12),
    cuts=st.lists(st.integers(1, 11), max_size=4),
)
def test_no_block_hears_another_sender(folder: Path, sources: list[int], cuts: list[int]) -> None:
    bus_map = bus(folder, 3)
    frames = [speed(k, source, 800.0 + k) for k, source in enumerate(sources)]
    subject, found = Decoding(bus_map, bus_map.names), list[Values]()
    edges = sorted({0, *(c for c in cuts if c < len(frames)), len(frames)})
    for begin, end in pairwise(edges):
        needed = subject.decoder.needed(block_of(frames[begin:end]))
        assert needed.tolist() == list(range(end - begin))
        found += subject.push(frames[begin:end])
    assert [values["engine_speed_rpm"] for values in found if values] == decoded(bus_map, frames)
    assert subject.decoder.unmapped == found.count(None)


@pytest.mark.parametrize(
    ("wanted", "line"),
    [
        ('message = "EEC1", signal = "EngSped"', "did you mean EngSpeed?"),
        ('message = "EEC", signal = "EngSpeed"', "did you mean EEC1"),
    ],
    ids=["signal", "message"],
)
def test_a_misspelt_name_is_told_with_the_nearest(folder: Path, wanted: str, line: str) -> None:
    bus(folder, 0)
    wrong = folder / "wrong.toml"
    wrong.write_text(f"[signals]\nengine_speed_rpm = {{ {wanted} }}\n")
    with pytest.raises(SignalMapError, match="wants") as raised:
        load_pairs([(folder / "truck.dbc", wrong)])
    assert line in str(raised.value)


def test_states_of_j1939_are_no_speeds(folder: Path) -> None:
    frames = [speed(i, 0, raw * 0.125) for i, raw in enumerate((0xFAFF, 0xFB00, 0xFE00, 0xFFFF))]
    values = decoded(bus(folder, 0), frames)
    assert values == pytest.approx([8031.875, math.nan, math.nan, math.nan], nan_ok=True)
