"""The downstream sensor: circuit and heater, and its activity beside the front sensor."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from monitor.base import config
from monitor.base.types import FloatArray
from monitor.judge.catalyst.rear_activity import RearActivity
from monitor.judge.catalyst.rear_circuit import CIRCUIT, HEATER, RearCircuit
from tests.helpers.drives.switching_drive import switching_drive

PERIOD_S = 0.1
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


@pytest.mark.parametrize(("rest_s", "passed_s"), [(15.0, 16.0), (0.0, 32.0)])
def test_a_sound_sensor_passes_both_tests(rest_s: float, passed_s: float) -> None:
    drive = a_drive()
    drive["volts"][round(rest_s / PERIOD_S) : 150] = 0.7
    found = {(test, fault): at * PERIOD_S for at, test, fault in decided(drive)}
    assert found.keys() == {(CIRCUIT, ""), (HEATER, "")}
    assert found[HEATER, ""] < passed_s  # once it has woken, or its duty was regulated


@pytest.mark.parametrize(
    ("volts", "every", "fault"),
    [
        (0.005, 1, "downstream_low"),
        (1.4, 1, "downstream_high"),
        (0.45, 1, "downstream_inactive"),
        (0.005, 2, "downstream_low"),  # a loose contact, every other sample
        (1.4, 2, "downstream_high"),
    ],
)
@pytest.mark.parametrize("start_s", [0.0, 100.0])
def test_a_voltage_that_no_gas_explains_is_a_fault_of_the_circuit(
    volts: float, every: int, fault: str, start_s: float
) -> None:
    drive = a_drive()
    drive["volts"][round(start_s / PERIOD_S) :: every] = volts
    *before, (at, _, found) = [each for each in decided(drive) if each[1] == CIRCUIT]
    assert found == fault
    assert at * PERIOD_S < start_s + 100.0
    assert len(before) == (start_s > 0.0)  # while it was sound


def test_a_voltage_with_an_offset_of_its_ground_is_a_fault_of_the_circuit() -> None:
    drive = a_drive()
    drive["volts"] += 0.4  # 0.48 V in air, up to 1.15 V in rich gas
    drive["volts"][np.arange(3600) % 200 < 80] -= 0.15  # plausible for 8 s of each 20 s
    assert (CIRCUIT, "downstream_high") in {(test, fault) for _, test, fault in decided(drive)}


def test_a_sensor_that_reads_nothing_in_long_fuel_cuts_is_not_shorted() -> None:
    drive, cut = a_drive(), slice(1000, 1300)  # 30 s
    drive["volts"][cut], drive["x"][cut] = 0.0, 0.95
    assert "downstream_low" not in {fault for *_, fault in decided(drive)}


def test_a_voltage_near_rest_behind_a_catalyst_without_fuel_cut_is_no_open_circuit() -> None:
    # GIVEN four minutes without a fuel cut behind a catalyst that is half full, the front sensor
    # reading lean by a little, and the last air of a fuel cut
    drive = a_drive(4.5)
    late = slice(round(40.0 / PERIOD_S), None)
    drive["volts"][late], drive["x"][late] = 0.45, 0.02
    drive["volts"][late.start - 1] = 0.45
    # THEN nothing says that the sensor is dead, since nothing had to move it
    assert "downstream_inactive" not in {fault for *_, fault in decided(drive)}


@pytest.mark.parametrize(
    ("lean_at", "samples_lean", "moved_at", "faults"),
    [
        ((900,), 14, None, {"", "downstream_inactive"}),  # 3.1 g
        ((900, 950), 10, None, {""}),  # 2.2 g each
        ((410,), 14, 430, {""}),  # the rest begins anew
    ],
)
def test_only_the_oxygen_of_one_lean_stretch_at_rest_tells_an_open_circuit(
    lean_at: tuple[int, ...], samples_lean: int, moved_at: int | None, faults: set[str]
) -> None:
    drive = a_drive(4.0)
    drive["volts"][400:], drive["x"][400:], drive["air_g_s"][400:] = 0.45, -0.01, 10.0
    drive["duty_percent"][:] = 100.0  # of a sensor that woke
    for at in lean_at:
        drive["x"][at : at + samples_lean] = 0.95
    if moved_at:
        drive["volts"][moved_at : moved_at + 10] = 0.7
    assert {fault for _, test, fault in decided(drive) if test == CIRCUIT} == faults


def test_a_sensor_that_wakes_late_at_full_duty_is_not_heated() -> None:
    drive = a_drive()
    drive["volts"][: round(50.0 / PERIOD_S)] = 0.45
    drive["duty_percent"][:] = 100.0
    found = {(test, fault) for _, test, fault in decided(drive)}
    assert found == {(CIRCUIT, ""), (HEATER, "downstream_heater")}


def test_a_regulated_heater_that_stays_at_full_duty_has_failed() -> None:
    drive = a_drive()
    drive["duty_percent"][round(90.0 / PERIOD_S) :] = 100.0
    drive["volts"][round(120.0 / PERIOD_S) :] = 0.45  # the sensor cools down
    assert {fault for *_, fault in decided(drive)} == {"", "downstream_heater"}


@pytest.mark.parametrize("heard", [0, 50])
def test_an_unheated_sensor_is_no_open_circuit(heard: int) -> None:
    drive = a_drive()
    drive["volts"][:], drive["duty_percent"][:] = 0.45, 100.0
    drive["duty_percent"][:heard] = math.nan
    assert {fault for *_, fault in decided(drive)} == {"downstream_heater"}


@pytest.mark.parametrize(
    ("heard_s", "first_s", "first"),
    [
        (0.0, 0.0, 0.0),
        (40.0, 0.0, 0.0),
        (0.0, 40.0, 0.0),
        (0.0, 20.0, 20.0),
        (0.0, 360.0, math.nan),
    ],
    ids=["full", "full, heard late", "off at first", "spared in wet exhaust", "unknown"],
)
def test_a_heater_tells_nothing_of_a_hot_sensor_without_a_regulated_duty(
    heard_s: float, first_s: float, first: float
) -> None:
    drive, t_s = a_drive(), PERIOD_S * np.arange(3600)
    drive["duty_percent"] = np.where(t_s < first_s, first, 100.0)
    if not math.isnan(first):  # of a sensor that was cold, an unknown duty tells nothing either
        drive["volts"] = np.where(drive["volts"] > 0.4, 0.7, 0.08)
    drive["volts"][t_s < heard_s] = math.nan
    assert {test for _, test, _ in decided(drive)} == {CIRCUIT}


def test_a_sensor_that_wakes_late_passes_once_its_heater_is_regulated() -> None:
    drive, t_s = a_drive(), PERIOD_S * np.arange(3600)
    drive["volts"] = np.where(t_s < 30.0, 0.45, drive["volts"])
    drive["duty_percent"] = np.where(t_s < 42.0, 100.0, 50.0)
    ((at, _, fault),) = [each for each in decided(drive) if each[1] == HEATER]
    assert fault == "" and at * PERIOD_S > 42.0


@pytest.mark.parametrize("volts", [0.0, 0.45])
def test_a_cold_sensor_may_read_nothing(volts: float) -> None:
    drive = a_drive()
    drive["volts"][:250], drive["duty_percent"][:] = volts, math.nan
    drive["x"][200:220], drive["air_g_s"][200:220] = 0.95, 12.0
    assert {fault for *_, fault in decided(drive)} == {""}


@pytest.mark.parametrize(
    ("volts", "every", "since"),
    [(0.005, 1, 1030), (1.4, 1, 1030), (0.45, 1, 1180), (0.005, 2, 1060), (1.4, 2, 1060)],
)
def test_doubtful_voltages_are_kept_from_the_bank(volts: float, every: int, since: int) -> None:
    drive = a_drive(3.0)
    drive["volts"][500:600] = 0.45  # as behind a half full catalyst
    drive["volts"][1000::every] = volts  # if not every sample, by a loose contact
    circuit, doubtful = RearCircuit(config.shipped(), PERIOD_S), []
    for sample in samples(drive):
        circuit.push(**sample)  # type: ignore[arg-type]
        doubtful.append(circuit.is_doubtful)
    assert not any(doubtful[300:1000])
    assert all(doubtful[since:])


def judged(*, burning: bool = True, **drive: float | bool) -> RearActivity:
    activity = RearActivity(config.shipped())
    for t_s, front_v, rear_v in zip(*switching_drive(**drive), strict=True):  # type: ignore[arg-type]
        activity.push(t_s, front_v, rear_v, burning=burning)
    return activity


def test_a_catalyst_that_stores_lets_only_long_excursions_pass() -> None:
    activity = judged(stores=True)
    assert activity.claim().outcome == "passed"
    assert activity.followed < 0.1 * activity.trials  # the long ones are no trials


@pytest.mark.parametrize("stores", [True, False])
def test_a_fuel_cut_decides_nothing(stores: bool) -> None:
    assert judged(stores=stores, burning=False).trials == 0


def test_a_sensor_that_is_later_than_transport_and_lag_never_makes_an_empty_can_pass_soon() -> None:
    assert judged(stores=False, late_s=0.7).claim().outcome == "failed"


def test_a_missing_value_ends_all_trials() -> None:
    activity = RearActivity(config.shipped())
    for t_s, front_v, rear_v in zip(*switching_drive(stores=False), strict=True):
        activity.push(t_s, front_v, math.nan if t_s % 0.6 < 0.1 else rear_v, burning=True)
    assert activity.trials == 0
