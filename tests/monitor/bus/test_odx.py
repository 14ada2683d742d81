"""The ODX description of the server, read back by odxtools."""

import random
from pathlib import Path
from typing import Any

import pytest

from monitor import cli
from monitor.bus.diagnostics import identifiers, obd, reports, results, uds
from monitor.bus.diagnostics.answer import answer
from monitor.bus.diagnostics.parameters import PARAMETERS
from monitor.bus.odx import layout
from monitor.bus.odx.description import pdx
from tests.helpers.diagnostics_state import Vehicle
from tests.helpers.odx_reader import SIGNALS, drawn_vehicle, read, requests, single


@pytest.fixture(scope="module")
def layer() -> Any:
    return read()


def asked(layer: Any, request: str, vehicle: Vehicle) -> Any:
    """Return what odxtools reads in the answer to a request in hexadecimal."""
    sent = bytes.fromhex(request)
    answered = answer(sent, False, vehicle.state)
    assert answered is not None
    (message,) = layer.decode_response(answered, sent)
    return message.param_dict


def test_all_that_the_server_answers_is_described(layer: Any) -> None:
    described = {bytes(s.request.coded_const_prefix()) for s in layer.services}
    assert {prefix[0] for prefix in described} == {*uds.SERVICES, *obd.SERVICES}
    assert {p[1] for p in described if p[0] == 0x19} == set(reports.REPORTS)
    assert set(layout.IDENTIFIERS) == set(identifiers.IDENTIFIERS)
    state = Vehicle().state
    assert {n for n in obd.current_parameters(state) if n % 0x20} == set(layout.CURRENT)
    assert set(obd.information(state)) == set(layout.INFORMATION)
    monitors = {p[1:] for p in described if p[0] == 0x06}
    assert {bytes((n,)) for n in results.TESTS} < monitors


def test_every_answer_is_read_by_the_description(layer: Any) -> None:
    draw = random.Random(1)
    read_back = refused = 0
    for _ in range(3):
        vehicle = drawn_vehicle(draw)
        for request in requests(layer, draw):
            answered = answer(request, False, vehicle.state)
            assert answered is not None
            (message,) = layer.decode_response(answered, request)
            is_refused = answered[0] == 0x7F
            assert (message.coding_object.short_name == "negative") == is_refused
            read_back, refused = read_back + 1, refused + is_refused
    assert read_back == 3 * len(layer.services)
    assert refused < 0.6 * read_back


def test_values_are_those_of_the_signals_in_their_units(layer: Any) -> None:
    vehicle = drawn_vehicle(random.Random(2))
    values = vehicle.state.values
    assert len(values) > 8
    for number, parameter in PARAMETERS.items():
        if parameter.signal in values:
            found = asked(layer, f"22 F4 {number:02X}", vehicle)[parameter.signal]
            assert found == pytest.approx(values[parameter.signal], abs=0.51 / parameter.scale)
    tick = vehicle.state.tick
    assert tick is not None
    assert asked(layer, "22 FD 03", vehicle)["predicted"] == single(tick.predicted)


def test_codes_snapshots_and_counters_are_named(layer: Any) -> None:
    vehicle = Vehicle()
    (confirmed,) = asked(layer, "19 02 08", vehicle)["codes"]
    assert confirmed["dtc"].display_trouble_code == "P0133"
    assert confirmed["dtc"].text.text == "slow_symmetric, transient"
    first, latest = asked(layer, "19 04 01 33 00 FF", vehicle)["snapshots"]
    assert (first["number"], latest["number"]) == (0x00, 0xF0)
    named = dict(item["snapshot_value"] for item in first["snapshot_values"])
    assert named["snapshot_value_F40C"] == {"engine_speed_rpm": 2000.0}
    records = asked(layer, "19 06 01 33 00 FE", vehicle)["extended_records"]
    assert records == [{"extended": ("extended_91", {"numerator": 3, "denominator": 5})}]


def test_the_command_writes_the_same_bytes_in_every_run(tmp_path: Path) -> None:
    out = tmp_path / "monitor.pdx"
    assert cli.main(["odx", str(out)]) == 0
    assert out.read_bytes() == pdx()
    assert len(SIGNALS) == len(PARAMETERS)
