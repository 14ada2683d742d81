"""``o2mon map``: signal maps proposed from databases."""

import re
from pathlib import Path

import pytest
from cantools.database.can import Database, Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st

import dbc
from monitor.base.errors import SignalMapError
from monitor.base.signals import OWN as OWN_SIGNALS
from monitor.cli import main
from monitor.decode.bus_map import load_database, load_pairs
from monitor.decode.signal_map import load_signal_map
from monitor.mapping.vocabulary import FUEL_FLOW_NAME
from tests.conftest import ROOT
from tests.helpers.examples import inputs
from tests.helpers.logs.databases import database_of, proposed

OWN = ["o2_ecu", "rusefi", "obd2"]


@pytest.mark.parametrize("name", OWN)
def test_the_shipped_maps_are_found_again(name: str, tmp_path: Path) -> None:
    path = dbc.path(f"{name}.dbc")
    text, proposals = proposed(load_database(path))
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    mine, shipped = (
        load_pairs([(path, tmp_path / "m.toml")]),
        load_signal_map(dbc.path(f"{name}.toml")),
    )
    doubtful = {"fuel_cut"} if name == "obd2" else set()  # its name says "or enrichment", too
    assert set(mine.names) == (shipped.signals.keys() | shipped.derived.keys()) - doubtful
    for canonical, wanted in shipped.signals.items():
        if canonical in doubtful:
            continue
        got = mine.channels[canonical].mapped
        assert (got.message, got.signal) == (wanted.message, wanted.signal)
        assert got.factor == pytest.approx(wanted.factor, rel=1e-9)
        assert got.offset == pytest.approx(wanted.offset, rel=1e-9)
    for canonical, recipe in shipped.derived.items():
        own = mine.derived[canonical]
        sources = (own.numerator, own.denominator), (recipe.numerator, recipe.denominator)
        assert [len(x) for x in sources[0]] == [len(x) for x in sources[1]]
        if canonical == "fuel_mass_mg":  # from a flow: it is worth the same
            theirs = load_pairs([(path, dbc.path(f"{name}.toml"))]).channels[recipe.numerator[0]]
            flow = mine.channels[FUEL_FLOW_NAME].mapped.factor * own.factor
            assert flow == pytest.approx(theirs.mapped.factor * recipe.factor, rel=1e-9)
    assert len(proposals.names) == len(mine.names)


def test_every_proposal_says_why_and_what_else_it_could_be() -> None:
    text, proposals = proposed(
        database_of('EngineSpeed (0.25,0) [0|8000] "rpm"', 'CrankSpeed (1,0) [0|8000] ""')
    )
    lines = text.splitlines()
    at = lines.index(next(line for line in lines if line.startswith("engine_speed_rpm")))
    assert re.match(
        r"# 1\.00: Engine_1\.EngineSpeed; its name says EngineSpeed; its unit is rpm", lines[at - 1]
    )
    assert lines[at + 1].startswith("#   or ")
    assert "CrankSpeed" in lines[at + 1]
    assert proposals.names == ("engine_speed_rpm",)


def test_a_recording_bears_out_counters_checksums_and_signals() -> None:
    (log,) = ROOT.glob("replay_logs/healthy_micro*.blf")
    text, proposals = proposed(load_database(dbc.path("o2_ecu.dbc")), log=log)
    silent = {"sensor_heater_percent"}  # the log was made before the ECU sent it
    assert set(proposals.names) == {signal.name for signal in OWN_SIGNALS} - silent
    assert text.count('algorithm = "crc8_sae_j1850_id"') == 7
    assert "{ counter" in text


def test_a_recording_decides_between_two_controllers(tmp_path: Path) -> None:
    log = tmp_path / "wideband.log"
    lam = [round(1e4 * (1.0 + 0.02 * ((k % 20) - 10) / 10)) for k in range(400)]
    log.write_text(
        "".join(
            f"({k / 100:.6f}) can0 190#A001{x.to_bytes(2, 'little').hex().upper()}0C030000\n"
            for k, x in enumerate(lam)
        )
    )
    text, proposals = proposed(load_database(dbc.path("wideband.dbc")), log=log)
    assert proposals.names == ("lambda_measured", "sensor_ready")
    assert {c.entry["message"] for c in proposals.found} == {"WidebandData"}
    assert "in the recording: no value" in text


@pytest.mark.parametrize(
    ("signal", "first", "period_s", "before", "after"),
    [  # sent once a second, and a database that states no cycle; sent in hPa, not in kPa
        ('MAP (1,0) [0|250] "kPa"', 40, 1.0, "timeout_s = 0.5 ", "timeout_s = 3.0 "),
        ('MAP (1,0) [0|2500] "kPa"', 900, 0.1, "\nmanifold_", "implausible in the recording"),
    ],
)
def test_a_recording_tells_how_old_a_value_may_be_and_a_unit_that_is_wrong(
    tmp_path: Path, signal: str, first: int, period_s: float, before: str, after: str
) -> None:
    database, log = database_of(signal, length=8), tmp_path / "d.log"
    payloads = [(first + k).to_bytes(8, "little").hex().upper() for k in range(60)]
    log.write_text("".join(f"({k * period_s:.6f}) can0 100#{x}\n" for k, x in enumerate(payloads)))
    assert before in proposed(database)[0]
    text, proposals = proposed(database, log=log)
    assert after in text
    assert bool(proposals.names) == (first == 40)


def test_the_command_writes_a_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rusefi.toml"
    assert main(["map", str(dbc.path("rusefi.dbc")), "--out", str(out)]) == 0
    assert load_signal_map(out).signals["engine_speed_rpm"].signal == "RPM"
    assert "o2mon check LOG" in capsys.readouterr().out
    assert main(["map", str(dbc.path("rusefi.dbc")), "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["map", str(dbc.path("wideband.dbc"))]) == 3
    printed = capsys.readouterr()
    assert printed.out.startswith("# Signal map for wideband.dbc")
    assert "lambda_measured stands as a comment, perhaps " in printed.err
    # THEN a check of a log points to what a model needs, too
    log, wideband = next(ROOT.glob("replay_logs/healthy_micro*.blf")), dbc.path("wideband.dbc")
    assert main(["map", str(wideband), "--out", str(out), "--force"]) == 3
    assert main(["check", str(log), "--dbc", str(wideband), "--map", str(out)]) == 3
    assert "comments of the map, to be confirmed: lambda_measured" in capsys.readouterr().out
    # but for one that stands beside comments
    text = out.read_text().replace("#   lambda_m", "lambda_m", 1)
    out.write_text(f"{text}# lambda_measured = {{}}\n")
    assert main(["check", str(log), "--dbc", str(wideband), "--map", str(out)]) == 3
    assert "to be confirmed" not in capsys.readouterr().out


def test_a_signal_beyond_the_end_of_its_message_is_not_proposed() -> None:
    others = [f'X{n} (1,0) [0|1] ""' for n in range(3)]
    rpm, ect = 'RPM (1,0) [0|8000] "rpm"', 'ECT (1,-40) [-40|200] "degC"'
    text, proposals = proposed(database_of(*others, rpm, ect, length=8))
    assert proposals.names == ("engine_speed_rpm",)  # bits 48 to 63
    assert "ECT" not in text  # no map with it could be loaded


@pytest.mark.parametrize("cycle", ["-" + 400 * "9", 400 * "9", "86400000"])
def test_a_cycle_time_that_no_message_has_upsets_nothing(tmp_path: Path, cycle: str) -> None:
    path, out = tmp_path / "strange.dbc", tmp_path / "map.toml"
    text = dbc.path("rusefi.dbc").read_text()
    path.write_text(re.sub(r'("GenMsgCycleTime" BO_ \d+) \d+;', rf"\1 {cycle};", text))
    assert main(["map", str(path), "--out", str(out)]) in (0, 3)
    load_pairs([(path, out)])


def test_a_range_without_an_end_upsets_nothing(tmp_path: Path) -> None:
    text = dbc.path("rusefi.dbc").read_text()
    path = tmp_path / "endless.dbc"
    path.write_text(re.sub(r"\[(-?[\d.]+)\|[\d.]+\]", r"[\1|1e999]", text))
    assert main(["map", str(path)]) in (0, 3)


@pytest.mark.parametrize("name", ["missing.dbc", "bad.dbc"])
def test_a_database_that_cannot_be_read_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.dbc").write_text("BO_ nonsense")
    assert main(["map", str(tmp_path / name)]) == 2
    assert name in capsys.readouterr().err


VOCABULARY = (
    "Lambda O2 AFR B1S2 Bank2 Engine Motor Speed Drehzahl Temp Coolant Air Luft Mass Flow Fuel "
    "Rail Pressure Druck MAP TPS Trim Target Soll Valid _ 2 1 x w λ Ö Purge Closed Loop Cut CRC"
)
WORDS = st.sampled_from(VOCABULARY.split())
NAMES = st.one_of(
    st.lists(WORDS, min_size=1, max_size=5).map("".join), st.text(min_size=1, max_size=12)
)
UNITS = st.one_of(
    st.none(),
    st.sampled_from(["", "rpm", "°C", "%", "bar", "kg/h", "mg", "AFR", "lambda", "V", "???"]),
    st.text(max_size=6),
)
NUMBERS = st.floats(-1e6, 1e6, allow_nan=False).filter(lambda x: abs(x) > 1e-6)


@st.composite
def signals(draw: st.DrawFn, index: int) -> Signal:
    low, high = draw(st.one_of(st.none(), NUMBERS)), draw(st.one_of(st.none(), NUMBERS))
    is_float = draw(st.booleans()) and draw(st.booleans())
    return Signal(
        name=draw(NAMES),
        start=(draw(st.integers(0, 3)) * 16),
        length=16 if is_float else draw(st.integers(1, 16)),
        byte_order="little_endian",
        is_signed=draw(st.booleans()),
        conversion=BaseConversion.factory(
            scale=draw(NUMBERS), offset=draw(st.floats(-1e3, 1e3)), is_float=is_float
        ),
        minimum=low,
        maximum=high,
        unit=draw(UNITS),
        comment=draw(st.one_of(st.none(), st.text(max_size=20))),
    )


@st.composite
def databases(draw: st.DrawFn) -> Database:
    messages = [
        Message(
            frame_id=draw(st.integers(0, 0x7FF)),
            name=draw(NAMES),
            length=8,
            signals=[draw(signals(k)) for k in range(draw(st.integers(0, 6)))],
            cycle_time=draw(st.one_of(st.none(), st.integers(0, 5000))),
            strict=False,
        )
        for _ in range(draw(st.integers(0, 4)))
    ]
    return Database(messages=messages, strict=False)


def taken_for_another(message: str, signal: str) -> Database:
    """Return a database whose only signal is the best for lambda and for the engine's speed."""
    conversion = BaseConversion.factory(scale=0.0625, offset=0.0, is_float=False)
    only = Signal(signal, 0, 16, byte_order="little_endian", conversion=conversion)
    return Database([Message(0x100, message, 8, [only])])


@inputs(100, suppress_health_check=list(HealthCheck))
@example(database=taken_for_another("Motor\x1fSpeed", "lambda"))
@example(database=taken_for_another("Motor\x7f_Speed", "lambda\r\nsig"))
@given(database=databases())
def test_no_database_upsets_it_and_what_it_writes_is_a_map(
    database: Database, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text, proposals = proposed(database)
    path = tmp_path_factory.mktemp("map") / "m.toml"
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    if proposals.names:
        loaded = load_signal_map(path)
        assert set(loaded.signals) | set(loaded.derived) == set(proposals.names)
        places = {(m.message, m.signal) for m in loaded.signals.values()}
        assert len(places) == len(loaded.signals)
        for mapped in loaded.signals.values():
            message = database.get_message_by_name(mapped.message)
            assert message.get_signal_by_name(mapped.signal)
    else:
        with pytest.raises(SignalMapError, match="is empty"):
            load_signal_map(path)


@inputs(60, suppress_health_check=list(HealthCheck))
@given(database=databases(), data=st.data())
def test_no_recording_upsets_it(
    database: Database, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    ids = sorted({message.frame_id for message in database.messages}) or [1]
    payloads = data.draw(st.lists(st.binary(min_size=0, max_size=8), min_size=1, max_size=30))
    path, log = (tmp_path_factory.mktemp("map") / name for name in ("m.toml", "d.log"))
    log.write_text(
        "".join(
            f"({k / 10:.1f}) can0 {ids[k % len(ids)]:03X}#{payload.hex().upper()}\n"
            for k, payload in enumerate(payloads * 5)
        )
    )
    text, proposals = proposed(database, log=log)
    if proposals.names:
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        assert set(load_signal_map(path).signals) <= set(proposals.names)
