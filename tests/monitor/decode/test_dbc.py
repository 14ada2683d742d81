import math
from pathlib import Path

import pytest
from cantools.database import load_file

import dbc
from monitor.base.errors import SignalMapError
from monitor.base.signals import BY_NAME, OWN
from monitor.decode.bus_map import load_database, load_pairs, read_database
from monitor.decode.checksum import payload_checksum

DATABASES = [name for name in dbc.names() if name.endswith(".dbc")]
PAIRS = [
    ("o2_ecu.dbc", "o2_ecu.toml"),
    ("rusefi.dbc", "rusefi.toml"),
    ("wideband.dbc", "wideband.toml"),
    ("wideband.dbc", "aem_x.toml"),
    ("obd2.dbc", "obd2.toml"),
]


def pair(database: str, signal_map: str) -> tuple[Path, Path]:
    return dbc.path(database), dbc.path(signal_map)


@pytest.mark.parametrize("name", DATABASES)
def test_no_two_signals_share_a_bit_and_all_lie_within_their_message(name: str) -> None:
    assert load_file(dbc.path(name), strict=True).messages


@pytest.mark.parametrize(("database", "signal_map"), PAIRS)
def test_every_map_fits_its_database(database: str, signal_map: str) -> None:
    names = load_pairs([pair(database, signal_map)]).names
    assert set(names) <= BY_NAME.keys()
    assert "lambda_measured" in names


def test_the_own_ecu_gives_all_its_canonical_signals_fine_and_wide_enough() -> None:
    bus_map = load_pairs([pair("o2_ecu.dbc", "o2_ecu.toml")])
    assert set(bus_map.names) == {signal.name for signal in OWN}
    for known in OWN:
        signal = bus_map.channels[known.name].signal
        top = (2**signal.length - 2) * float(signal.scale) + float(signal.offset)
        assert float(signal.offset) <= known.minimum, known.name
        assert top >= known.maximum - 2 * float(signal.scale), known.name
        if known.role != "enable":
            assert float(signal.scale) <= (known.maximum - known.minimum) / 4000, known.name


def test_the_own_ecu_stays_below_300_frames_a_second() -> None:
    messages = load_database(dbc.path("o2_ecu.dbc")).messages
    rate = sum(1000 / message.cycle_time for message in messages if message.cycle_time)
    assert 150 < rate < 300


def test_a_later_pair_provides_lambda_instead_of_the_engine() -> None:
    merged = load_pairs([pair("rusefi.dbc", "rusefi.toml"), pair("wideband.dbc", "wideband.toml")])
    assert merged.channels["lambda_measured"].message.name == "WidebandData"
    assert merged.names.count("lambda_measured") == 1
    assert "sensor_ready" in merged.names


def test_the_checksum_is_the_published_one() -> None:
    def crc(data: bytes) -> int:
        return payload_checksum("crc8_sae_j1850", 0x123, data, len(data))

    assert (crc(b"123456789"), crc(bytes(4))) == (0x4B, 0x59)
    payload = bytes(range(8))
    assert payload_checksum("crc8_sae_j1850", 0x123, payload, 7) == crc(payload[:7])
    assert payload_checksum("crc8_sae_j1850_id", 0x123, payload, 0) == crc(b"\x23" + payload[1:])


def test_an_unknown_file_of_the_package_is_named() -> None:
    with pytest.raises(FileNotFoundError, match=r"no other\.dbc among aem_x\.toml"):
        dbc.path("other.dbc")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[signals]\nx = 3\n", "a table is wanted"),
        ("[signal]\n", "unknown key 'signal'"),
        ("[signals]\n", "is empty"),
        ('[signals.x]\nmessage = "ECU_Air"\n', "signal is missing"),
        ('[signals.x]\nmessage = "ECU_Air"\nsignal = "AirMass"\ngain = 2\n', "unknown key 'gain'"),
        ('[signals.x]\nmessage = "M"\nsignal = "AirMass"\n', r"x wants message M, which .*o2_ecu"),
        ('[signals.x]\nmessage = "ECU_Air"\nsignal = "S"\n', r"ECU_Air\.S, which .*o2_ecu\.dbc"),
        ('[signals.x]\nmessage = "ECU_Air"\nsignal = "AirMass"\ntimeout_s = 0\n', "above 0"),
        ('[signals."x y"]\nmessage = "ECU_Air"\nsignal = "AirMass"\n', "is no name"),
        ('[integrity]\nalgorithm = "crc9"\n', "known are"),
        ('[integrity]\nnot_available = "never"\n', "known are all_ones"),
        ("[integrity]\ncounter = 4\n", "a text is wanted"),
        ('[messages.M]\nchecksums = ""\n', "unknown key 'checksums'"),
        ('[derived.y]\nnumerator = ["z"]\n', "neither"),
        ('[derived.y]\nnumerator = "z"\n', "texts are wanted"),
        ("[derived.y]\n", "names no signal"),
        (
            '[integrity]\ncounter = "C"\n[signals.x]\nmessage = "ECU_Air"\nsignal = "AirMass"\n',
            r"ECU_Air\.C, which",
        ),
    ],
)
def test_a_map_that_cannot_be_is_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(SignalMapError, match=message) as caught:
        load_pairs([(dbc.path("o2_ecu.dbc"), path)])
    assert str(path) in str(caught.value)


def test_two_messages_with_one_identifier_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.dbc"
    other.write_text(dbc.path("rusefi.dbc").read_text())
    own = tmp_path / "own.toml"
    own.write_text('[signals.speed]\nmessage = "BASE1"\nsignal = "RPM"\n')
    with pytest.raises(SignalMapError, match="has identifier 0x201, as BASE1"):
        load_pairs([pair("rusefi.dbc", "rusefi.toml"), (other, own)])
    other.write_text(other.read_text() + 'BO_ 513 TWIN: 4 A\n SG_ Y : 7|16@0+ (1,0) [0|0] "" A\n')
    own.write_text(own.read_text() + '[signals.y]\nmessage = "TWIN"\nsignal = "Y"\n')
    with pytest.raises(SignalMapError, match="TWIN has identifier 0x201, as BASE1"):
        load_pairs([(other, own)])


@pytest.mark.parametrize("content", [None, "", "BO_ nonsense"])
def test_a_database_that_is_none_is_refused(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "broken.dbc"
    if content is not None:
        path.write_text(content)
    with pytest.raises(SignalMapError, match=r"broken\.dbc|lacks"):
        load_pairs([(path, dbc.path("o2_ecu.toml"))])


def test_a_signal_no_map_provides_is_named() -> None:
    bus_map = load_pairs([pair("wideband.dbc", "wideband.toml")])
    with pytest.raises(SignalMapError, match=r"wideband\.toml: does not provide maf_kg_h"):
        bus_map.sources(["maf_kg_h"])


def test_derived_signals_bring_what_they_are_made_of() -> None:
    bus_map = load_pairs([pair("rusefi.dbc", "rusefi.toml")])
    assert bus_map.sources(["fuel_mass_mg"]) == ("fuel_flow_g_s", "engine_speed_rpm")
    assert math.isclose(bus_map.derived["fuel_mass_mg"].factor, 120000 / 4)


HEAD = 'VERSION ""\n\nNS_ :\n\tCM_\n\tVAL_\n\nBS_:\n\nBU_: ECU\n\n'
GOOD = 'BO_ 256 Engine: 8 ECU\n SG_ Speed : 0|16@1+ (0.25,0) [0|16383] "rpm" ECU\n\n'


def read(folder: Path, text: str) -> tuple[dict[str, list[str]], tuple[str, ...]]:
    """Return the signals of each message, and the notes."""
    path = folder / "car.dbc"
    path.write_text(HEAD + text, encoding="cp1252")
    database, notes = read_database(path)
    return {m.name: [s.name for s in m.signals] for m in database.messages}, notes


def test_a_sound_database_is_read_as_it_stands(tmp_path: Path) -> None:
    assert read(tmp_path, GOOD) == ({"Engine": ["Speed"]}, ())
    # AND so is one with an editor's mark of UTF-8 before it
    (tmp_path / "car.dbc").write_text(HEAD + GOOD, encoding="utf-8-sig")
    assert [m.name for m in read_database(tmp_path / "car.dbc")[0].messages] == ["Engine"]


def test_a_long_identifier_without_its_mark_is_one_of_29_bits(tmp_path: Path) -> None:
    text = GOOD.replace("256 Engine", f"{0x10210000} Engine")
    text += f'CM_ SG_ {0x10210000} Speed "of the engine";\n'
    messages, notes = read(tmp_path, text)
    assert messages == {"Engine": ["Speed"]}
    assert notes == ("message Engine: identifier 0x10210000 read as one of 29 bits",)
    database, _ = read_database(tmp_path / "car.dbc")
    (message,) = database.messages
    assert (message.frame_id, message.is_extended_frame) == (0x10210000, True)
    assert message.get_signal_by_name("Speed").comment == "of the engine"


def test_messages_of_one_name_are_told_apart_by_their_identifiers(tmp_path: Path) -> None:
    # GIVEN a controller that calls the messages of both its sensors alike
    text = GOOD.replace("Engine", "Wideband") + GOOD.replace("256 Engine", "257 Wideband") + GOOD
    messages, notes = read(tmp_path, text.replace("256 Engine", "258 Engine"))
    # THEN both are read, and no name is changed that only one message has
    assert messages == {n: ["Speed"] for n in ("Wideband_100", "Wideband_101", "Engine")}
    assert notes == ("several messages of one name, their identifiers now behind it: Wideband",)
    database, _ = read_database(tmp_path / "car.dbc")
    assert database.get_message_by_name("Wideband_100").frame_id == 0x100


@pytest.mark.parametrize(
    ("text", "note"),
    [
        (GOOD + 'VAL_ 352 Nothing 0 "off" ;\n', "values of the unknown signal Nothing"),
        (GOOD + 'BO_ 257 2017_5: 8 ECU\n SG_ X : 0|8@1+ (1,0) [0|1] "" ECU\n', "BO_ 257 2017_5"),
        (GOOD + ' SG_ 0_SUM : 24|8@1+ (1,0) [0|1] "" ECU\n', "SG_ 0_SUM"),
        (GOOD + 'CM_ BO_ 256 "a quote too "many";\n', "CM_ BO_ 256"),
        (f'BO_ {0x60000000} Far: 8 ECU\n SG_ X : 0|8@1+ (1,0) [0|1] "" ECU\n\n{GOOD}', "Far"),
    ],
    ids=[
        "values of no signal",
        "a name that begins with a digit",
        "a signal's name that begins with a digit",
        "a quote too many",
        "an impossible identifier",
    ],
)
def test_one_mistake_costs_one_statement(tmp_path: Path, text: str, note: str) -> None:
    messages, notes = read(tmp_path, text)
    assert messages == {"Engine": ["Speed"]}
    assert len(notes) == 1
    assert note in notes[0]


def test_messages_behind_a_comment_without_its_end_are_read(tmp_path: Path) -> None:
    more = GOOD.replace("256 Engine", "257 Gearbox")
    messages, _ = read(tmp_path, GOOD + 'CM_ "front"\n' + more)
    assert list(messages) == ["Engine", "Gearbox"]
