"""Databases and maps that no bus can have: one line each, with little memory and at once."""

import time
from pathlib import Path

import pytest

from monitor.base.errors import SignalMapError
from monitor.base.files.inputs import SMALL_BYTES
from monitor.decode.block_decoder import BlockDecoder
from monitor.decode.bus_map import load_database, load_pairs

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: E\n'
SOUND = ' SG_ S : 0|8@1+ (1,0) [0|0] "" E\n'
SWITCH = ' SG_ A M : 8|8@1+ (1,0) [0|0] "" E\n SG_ S m3 : 0|8@1+ (1,0) [0|0] "" E\n'
MAP = '[signals]\nlambda_measured = {{ message = "M", signal = "S"{} }}\n'


def database(signals: str = SOUND, length: str = "8", after: str = "", name: str = "100") -> str:
    return f"{HEAD}BO_ {name} M: {length} E\n{signals}{after}"


def signal(place: str = "0|8@1+", scaling: str = "1,0") -> str:
    return f' SG_ S : {place} ({scaling}) [0|0] "" E\n'


def pair(folder: Path, dbc: str, map_text: str = MAP.format("")) -> tuple[Path, Path]:
    (folder / "x.dbc").write_text(dbc)
    (folder / "x.toml").write_text(map_text)
    return folder / "x.dbc", folder / "x.toml"


def refusal(files: tuple[Path, Path]) -> str:
    """Return the one line with which a database and its map are refused at once."""
    begun_s = time.process_time()
    with pytest.raises(SignalMapError) as caught:
        load_pairs([files])
    assert time.process_time() - begun_s < 2.0
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("dbc", "message"),
    [
        (database(length="0"), "message M has 0 bytes, 1 to 64 are wanted"),
        (database(length="100000"), "message M has 100000 bytes"),
        (database(signal("-3|8@1+")), "S starts at bit -3 with 8 bits, beyond the 8 bytes"),
        (database(signal("63|8@1+")), "S starts at bit 63 with 8 bits, beyond"),
        (database(signal("56|16@0+")), "S starts at bit 56 with 16 bits, beyond"),
        (database(signal("0|100000@1+")), "S has 100000 bits, 1 to 512 are wanted"),
        (database(signal("0|2147483648@1+")), "S has a size or place of '2147483648'"),
        (database(signal("2147483648|8@1+")), "S has a size or place of '2147483648'"),
        (database(length="99999999999"), "M has a size or place of '99999999999'"),
        (database(signal(scaling="1e400,0")), "S has the factor inf, a finite number is wanted"),
        (database(signal(scaling="1,-1e400")), "S has the offset -inf, a finite number"),
        (database(signal(scaling=f"{'9' * 400},0")), "S has the factor 9999"),
        (database(SOUND.replace("[0|0]", f"[0|{'9' * 400}]")), "S has the maximum 9999"),
        (database(signal(scaling="0,0")), "S has the factor 0, another number"),
        (
            database(signal("0|17@1-"), after="SIG_VALTYPE_ 100 S : 1;\n"),
            "S is a float of 17 bits, 16, 32 or 64 are wanted",
        ),
        (
            database(SWITCH, after="SG_MUL_VAL_ 100 S A 0-10000000;\n"),
            "signal S of message 100 comes under 10,000,001 multiplexer values or more",
        ),
        (
            database(SWITCH, after="SG_MUL_VAL_ 100 S A 0-10000000;\n").replace("\n", " "),
            "signal S of message 100 comes under 10,000,001 multiplexer values or more",
        ),
        (
            database(
                ' SG_ A M : 8|8@1+ (1,0) [0|0] "" E\n SG_ S m3M : 0|8@1+ (1,0) [0|0] "" E\n',
                after="SG_MUL_VAL_ 100 S S 3-3;\n",
            ),
            "S has the multiplexer S, which depends on it",
        ),
        ("\0" * 5000, "not a CAN database"),
        (HEAD + "time_s,lambda\n0.0,1.0\n", "not a CAN database: no message can be read"),
        (database(name="-5"), "not a CAN database"),
    ],
)
def test_a_database_that_no_bus_has_is_one_line(tmp_path: Path, dbc: str, message: str) -> None:
    said = refusal(pair(tmp_path, dbc))
    assert message in said
    assert "x.dbc" in said


def test_what_is_strange_elsewhere_in_a_database_does_no_harm(tmp_path: Path) -> None:
    strange = 'BO_ 101 N: 0 E\n SG_ T : -5|17@1+ (1e400,0) [0|0] "" E\n'
    bus_map = load_pairs([pair(tmp_path, database(after=strange))])
    assert BlockDecoder(bus_map, ["lambda_measured"]).identifiers == ((100, False),)


def test_limits_without_bounds_are_no_limits(tmp_path: Path) -> None:
    text = database(' SG_ S : 0|8@1+ (1,0) [0|1e999] "" E\n')
    map_text = '[signals]\nown_name = { message = "M", signal = "S" }\n'
    bus_map = load_pairs([pair(tmp_path, text, map_text)])
    assert BlockDecoder(bus_map, ["own_name"]).identifiers == ((100, False),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MAP.format(f", factor = {'9' * 5000}"), "not a TOML file"),
        (MAP.format(f", factor = 0x{'f' * 5000}"), "factor is a number of 20,000 bits"),
        (MAP.format(", offset = nan"), "offset is nan, a number is wanted"),
        (MAP.format(", timeout_s = 1e308"), "wants timeout_s above 0 and at most 1e+06"),
        (MAP.format(", factor = -inf"), "factor is -inf, a number is wanted"),
        ("a = " + "[" * 100_000, "nested too deeply"),
        ("a = " + "{b=" * 5000, "nested too deeply"),
        ("\xff\xfe", "not a TOML file"),
        ("#" * (SMALL_BYTES + 1), "has more than 1,048,576 bytes"),
        (MAP.format(", factor = '" + "x" * 10_000 + "'"), "a number is wanted"),
    ],
)
def test_a_map_that_no_one_writes_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    dbc, map_path = pair(tmp_path, database())
    map_path.write_bytes(text.encode("latin-1"))
    said = refusal((dbc, map_path))
    assert message in said
    assert str(map_path) in said
    assert len(said) < 500


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("dbc", database(signal().replace("S :", "S_" + "9" * 5000 + " :"))),
        (
            "kcd",
            '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/>'
            '<Bus name="B"><Message id="0x64" length="8" name="M"><Signal offset="0"/></Message>'
            "</Bus></NetworkDefinition>",
        ),
    ],
)
def test_a_name_that_is_none_or_endless_is_refused(kind: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / f"names.{kind}"
    path.write_text(text)
    with pytest.raises(SignalMapError, match=r"has no name or one of more than 1000 letters"):
        load_database(path)
