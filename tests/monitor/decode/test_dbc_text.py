"""Databases with the mistakes of public ones are read; the rest is left out and listed."""

from pathlib import Path

import pytest

from monitor.decode.bus_map import read_database

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
