"""Circuit and heater of the downstream sensor, on voltages that are made here."""

from collections.abc import Iterator

import numpy as np
import pytest

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.catalyst.rear_circuit import CIRCUIT, HEATER, RearCircuit

PERIOD_S = 0.1
SETTINGS = config.shipped().catalyst
CUT_S = 6.0  # each 40 s


def a_drive(minutes: float = 6.0) -> dict[str, FloatArray]:
    """A sound sensor from a cold start: it wakes after 15 s and turns lean in each fuel cut."""
    n = round(minutes * 60.0 / PERIOD_S)
    t_s = PERIOD_S * np.arange(n)
    cut = t_s % 40.0 >= 40.0 - CUT_S
    volts = np.where(cut, 0.08, 0.7 + 0.05 * np.sin(t_s))
    volts = np.where(t_s < 15.0, 0.45, volts)
    volts += 0.004 * np.random.default_rng(1).standard_normal(n)
    return {
        "volts": volts,
        "x": np.where(cut, 0.95, 0.02 * np.sin(3.0 * t_s)),
        "air_g_s": np.where(cut, 5.0, 12.0),
        "running": np.arange(1.0, n + 1.0),
        "duty_percent": np.where(t_s < 22.0, 100.0, 50.0),
    }


def samples(drive: dict[str, FloatArray]) -> Iterator[dict[str, float]]:
    for sample in zip(*(values.tolist() for values in drive.values()), strict=True):
        yield dict(zip(drive, sample, strict=True))


def decided(drive: dict[str, FloatArray]) -> list[tuple[int, str, str]]:
    circuit = RearCircuit(config.shipped(), PERIOD_S)
    pushed = ((k, circuit.push(**sample)) for k, sample in enumerate(samples(drive)))  # type: ignore[arg-type]
    return [(k, test, said.fault or "") for k, found in pushed for test, said in found]


def test_a_sound_sensor_passes_both_tests() -> None:
    assert {(test, fault) for _, test, fault in decided(a_drive())} == {(CIRCUIT, ""), (HEATER, "")}


@pytest.mark.parametrize(
    ("volts", "fault"),
    [(0.005, "downstream_low"), (1.4, "downstream_high"), (0.45, "downstream_inactive")],
)
@pytest.mark.parametrize("start_s", [0.0, 100.0])
def test_a_voltage_that_no_gas_explains_is_a_fault_of_the_circuit(
    volts: float, fault: str, start_s: float
) -> None:
    drive = a_drive()
    drive["volts"][round(start_s / PERIOD_S) :] = volts
    at, _, found = [each for each in decided(drive) if each[1] == CIRCUIT][-1]
    assert found == fault
    assert at * PERIOD_S < start_s + 100.0


def test_a_voltage_with_an_offset_of_its_ground_is_a_fault_of_the_circuit() -> None:
    drive = a_drive()
    drive["volts"] += 0.4  # 0.48 V in air, up to 1.15 V in rich gas
    assert (CIRCUIT, "downstream_high") in {(test, fault) for _, test, fault in decided(drive)}


def test_a_sensor_that_reads_nothing_in_long_fuel_cuts_is_not_shorted() -> None:
    drive = a_drive()
    drive["volts"] = np.where(drive["x"] > 0.5, 0.0, drive["volts"])
    assert "downstream_low" not in {fault for *_, fault in decided(drive)}


def test_a_voltage_near_rest_behind_a_catalyst_without_fuel_cut_is_no_open_circuit() -> None:
    # GIVEN four minutes without a fuel cut behind a catalyst that is half full
    drive = a_drive(4.5)
    late = slice(round(30.0 / PERIOD_S), None)
    drive["volts"][late], drive["x"][late] = 0.45, 0.0
    # THEN nothing says that the sensor is dead, since nothing had to move it
    assert "downstream_inactive" not in {fault for *_, fault in decided(drive)}


def test_a_sensor_that_wakes_late_at_full_duty_is_not_heated() -> None:
    drive = a_drive()
    drive["volts"][: round(50.0 / PERIOD_S)] = 0.45
    drive["duty_percent"][:] = 100.0
    found = {(test, fault) for _, test, fault in decided(drive)}
    assert found == {(CIRCUIT, ""), (HEATER, "downstream_heater")}


def test_a_regulated_heater_that_stays_at_full_duty_has_failed() -> None:
    drive = a_drive()
    drive["duty_percent"][round(90.0 / PERIOD_S) :] = 100.0
    assert [fault for _, test, fault in decided(drive) if test == HEATER][-1] == "downstream_heater"


def test_an_unheated_sensor_is_no_open_circuit() -> None:
    drive = a_drive()
    drive["volts"][:], drive["duty_percent"][:] = 0.45, 100.0
    assert {fault for *_, fault in decided(drive)} == {"downstream_heater"}


def test_a_hot_sensor_with_a_heater_always_on_tells_nothing_of_it() -> None:
    drive = a_drive()
    drive["volts"] = np.where(drive["volts"] > 0.4, 0.7, 0.08)
    drive["duty_percent"][:] = 100.0
    assert {test for _, test, _ in decided(drive)} == {CIRCUIT}


def test_doubtful_voltages_are_kept_from_the_bank() -> None:
    drive = a_drive(3.0)
    drive["volts"][1000:] = 0.005
    circuit, doubtful = RearCircuit(config.shipped(), PERIOD_S), []
    for sample in samples(drive):
        circuit.push(**sample)  # type: ignore[arg-type]
        doubtful.append(circuit.is_doubtful)
    assert not any(doubtful[300:1000])
    assert all(doubtful[1200:])
