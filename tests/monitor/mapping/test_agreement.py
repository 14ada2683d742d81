"""Lines of a map that stand only where name, unit and range agree."""

import pytest

from tests.helpers.logs.databases import database_of, proposed


def stands(*signals: str, message: str = "Engine_1") -> dict[str, str]:
    _, proposals = proposed(database_of(*signals, message=message))
    return {c.name: c.entry["signal"] for c in proposals.found}


@pytest.mark.parametrize(
    "signal",
    [
        'TrailerPressure (0.1,0) [0|300] "bar"',  # holds "rail"
        'CVT_RPM (1,0) [0|8000] "rpm"',  # a bare quantity of another machine
        'Inlet_Coolant_Temp (1,-40) [-40|215] ""',  # of a battery or a cooler
        'MAP (0.01,0) [0|400] "mpa"',  # a unit a thousand times too large for its range
    ],
)
def test_an_abbreviation_inside_of_a_word_or_a_foreign_unit_is_no_agreement(signal: str) -> None:
    assert stands(signal) == {}


def test_a_device_that_all_names_of_a_message_begin_with_is_no_part_of_the_engine() -> None:
    got = stands(
        'Charger_Ambient_Temp (1,-64) [-64|191] "C"',
        'Charger_Cold_Plate_Temp (1,-64) [-64|191] "C"',
        'Charger_Output_Current (0.1,0) [0|1000] "A"',
        'Charger_Output_Voltage (0.1,0) [0|1000] "V"',
        'Charger_Ready_Flag (1,0) [0|1] ""',
        'Charger_Error_Flag (1,0) [0|1] ""',
        'Charger_Error_Code (1,0) [0|255] ""',
        message="Status_A1",
    )
    assert got == {}


def test_a_torque_of_the_engine_s_message_is_the_engine_s() -> None:
    signals = 'EstimatedTorque (0.5,-100) [-100|800] "Nm"', 'RPM (1,0) [0|8000] ""'
    assert {*stands(*signals, message="Status_1")} == {"engine_speed_rpm"}
    assert {*stands(*signals)} == {"engine_speed_rpm", "engine_torque_nm"}
