"""Steps of fuel cuts: delay, rise and level, and the verdict on a drive's cuts."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base.config import shipped
from monitor.base.faults import lag_step
from monitor.base.types import FloatArray
from monitor.judge.fuel_cut.cuts import LEVEL, Cut, CutReading, FuelCuts, Stretch, cuts_of
from monitor.judge.fuel_cut.response import FuelCutReference, FuelCutResponse, HealthyCuts
from training.limits.response.fuel_cuts import reference_of

CONFIG, PERIOD_S = shipped(), 0.1
LEAST = 0.05  # phi
AIR = 0.62  # phi that this sensor reads in air
REFERENCE = FuelCutReference(
    {
        "delay_rich_to_lean_s": HealthyCuts(0.0, 0.02, 0.03),
        "rise_rich_to_lean_s": HealthyCuts(0.0, 0.02, 0.03),
        "delay_lean_to_rich_s": HealthyCuts(0.0, 0.02, 0.03),
        "rise_lean_to_rich_s": HealthyCuts(0.0, 0.02, 0.03),
        LEVEL: HealthyCuts(AIR, 0.005, 0.005),
    }
)


def reading(is_cut: np.ndarray, delay_s: float, lag_s: float, gain: float = 1.0) -> FloatArray:
    """Return phi of a sensor behind an exhaust with a dead time of 0.2 s and a lag of 0.1 s."""
    late = np.roll(np.where(is_cut, AIR, 1.0), round((0.2 + delay_s) / PERIOD_S))
    x, read = 1.0, []
    for u in late.tolist():
        x = lag_step(x, u, 0.1 + lag_s, 0.1 + lag_s, PERIOD_S)
        read.append(1.0 + gain * (x - 1.0))
    return np.array(read)


def stretch(delay_s: float = 0.0, lag_s: float = 0.0, gain: float = 1.0) -> Stretch:
    """Return samples with fuel cuts of 5, 0.5 and 2 s."""
    is_cut = np.zeros(200, dtype=np.bool_)
    is_cut[20:70] = is_cut[110:115] = is_cut[140:160] = True
    t_ns = np.arange(200) * 100_000_000
    measured = reading(is_cut, delay_s, lag_s, gain)
    return Stretch(t_ns, measured, reading(is_cut, 0.0, 0.0), is_cut)


def judged(*cuts: Cut, reference: FuelCutReference | None = REFERENCE) -> FuelCutResponse:
    test = FuelCutResponse(CONFIG, reference, "phi")
    for cut in cuts:
        test.add(cut)
    return test


def test_a_dead_time_is_a_delay_and_no_rise() -> None:
    first, second = cuts_of(stretch(delay_s=0.4), CONFIG.fuel_cut, PERIOD_S, LEAST)
    for edge in ("rich_to_lean", "lean_to_rich"):
        late, slow = first.seen[f"delay_{edge}_s"], first.seen[f"rise_{edge}_s"]
        assert late.measured - late.predicted == pytest.approx(0.4, abs=0.01)
        assert slow.measured == pytest.approx(slow.predicted, abs=0.01)
    assert (first.t_ns, second.t_ns) == (2_000_000_000, 14_000_000_000)


def test_a_lag_is_a_longer_rise() -> None:
    first = cuts_of(stretch(lag_s=0.5), CONFIG.fuel_cut, PERIOD_S, LEAST)[0]
    for edge in ("rich_to_lean", "lean_to_rich"):
        slow = first.seen[f"rise_{edge}_s"]
        assert 0.5 < slow.measured - slow.predicted < 0.8


def test_a_step_that_still_goes_on_at_its_end_shows_nothing() -> None:
    first, second = cuts_of(stretch(lag_s=2.0), CONFIG.fuel_cut, PERIOD_S, LEAST)
    assert "rise_rich_to_lean_s" in first.seen  # of a cut of 5 s
    assert "rise_rich_to_lean_s" not in second.seen  # of 2 s


def test_only_a_long_cut_shows_a_level_and_a_short_one_shows_nothing() -> None:
    cuts = cuts_of(stretch(), CONFIG.fuel_cut, PERIOD_S, LEAST)
    assert [LEVEL in cut.seen for cut in cuts] == [True, False]
    assert cuts[0].seen[LEVEL].measured == pytest.approx(AIR, abs=1e-3)


@pytest.mark.parametrize("size", [1, 7, 64, 200])
def test_the_cuts_do_not_depend_on_blocks(size: int) -> None:
    whole, found = stretch(delay_s=0.4), []
    cuts = FuelCuts(CONFIG.fuel_cut, PERIOD_S, LEAST, 180.0)
    usable = np.ones(200, dtype=np.bool_)
    for begin in range(0, 200, size):
        part = whole.part(begin, begin + size)
        found += [
            (begin + k, cut) for k, cut in cuts.push(part, usable[begin : begin + len(part.t_ns)])
        ]
    # the recovery of the first cut ends 3 s behind it; the second one is told by the third
    assert [k for k, _ in found] == [100, 190]
    assert [cut for _, cut in found] == cuts_of(whole, CONFIG.fuel_cut, PERIOD_S, LEAST)


def test_a_cut_with_an_invalid_sample_shows_only_what_came_before() -> None:
    usable = np.ones(200, dtype=np.bool_)
    usable[35] = False
    first, _ = FuelCuts(CONFIG.fuel_cut, PERIOD_S, LEAST, 180.0).push(stretch(), usable)
    assert first[0] == 35
    assert set(first[1].seen) == {"delay_rich_to_lean_s", "rise_rich_to_lean_s"}


@pytest.mark.parametrize(
    ("own", "faults"),
    [
        ({}, ()),
        ({"delay_s": 0.4}, ("delay_symmetric",)),
        ({"lag_s": 0.5}, ("slow_symmetric",)),
        ({"gain": 0.6}, ("gain_low",)),
    ],
)
def test_a_drive_is_judged_by_healthy_drives(
    own: dict[str, float], faults: tuple[str, ...]
) -> None:
    test = judged(*cuts_of(stretch(**own), CONFIG.fuel_cut, PERIOD_S, LEAST))
    assert test.faults == faults
    assert test.verdict == ("failed" if faults else "passed")


def test_without_healthy_drives_all_is_measured_and_nothing_judged() -> None:
    test = judged(*cuts_of(stretch(delay_s=0.4), CONFIG.fuel_cut, PERIOD_S, LEAST), reference=None)
    assert (test.verdict, test.faults, test.gain) == ("inconclusive", (), None)
    assert test.findings()["delay_rich_to_lean_s"].measured > 0.5
    assert list(test.results()) == []


def test_a_clipped_reading_shows_no_level_and_one_below_it_the_most_that_the_gain_can_be() -> None:
    clipped = replace(
        REFERENCE, healthy={**REFERENCE.healthy, LEVEL: HealthyCuts(AIR, 0.0, 0.0)}, is_clipped=True
    )
    at_end = judged(Cut(0, {LEVEL: CutReading(AIR, 0.0)}), reference=clipped)
    assert at_end.gain is None
    below = judged(Cut(0, {LEVEL: CutReading(1.0 - 0.5 * (1.0 - AIR), 0.0)}), reference=clipped)
    assert below.gain is not None
    assert below.gain[0] == pytest.approx(0.5)
    assert below.faults == ("gain_low",)
    # a sensor that reaches the end in other cuts is not weak
    cuts = [
        Cut(0, {LEVEL: CutReading(level, 0.0)})
        for level in (AIR, 1.0 - 0.5 * (1.0 - AIR), AIR, AIR)
    ]
    mixed = judged(*cuts, reference=clipped)
    assert mixed.gain is not None
    assert mixed.gain[0] == pytest.approx(0.875)
    assert mixed.faults == ()


def test_what_healthy_drives_show_is_learned_with_its_spread() -> None:
    drives = [cuts_of(stretch(delay_s=d), CONFIG.fuel_cut, PERIOD_S, LEAST) for d in (0.0, 0.1)]
    # WHEN each drive has three cuts THEN mean and spread are those of the drives
    found = reference_of([2 * cuts for cuts in drives], CONFIG, "phi", PERIOD_S)
    assert found is not None
    late = found.healthy["delay_rich_to_lean_s"]
    assert late.mean == pytest.approx(0.05, abs=0.01)
    assert late.drive_std == pytest.approx(0.1 / np.sqrt(2.0), abs=0.01)
    assert FuelCutReference.from_card(found.to_card(), "card") == found


def test_levels_that_are_alike_and_do_not_move_are_the_end_of_the_range() -> None:
    levels = 0.063, 0.063, 0.063, 0.1
    still, moving = (
        [Cut(0, {LEVEL: CutReading(each, 0.0)}, is_flat) for each in levels]
        for is_flat in (True, False)
    )
    found = reference_of([still, still], CONFIG, "phi", PERIOD_S)
    assert found is not None
    assert (found.is_clipped, found.healthy[LEVEL].mean) == (True, 0.063)
    # WHEN the reading moves there THEN it is a level that no range ends
    found = reference_of([moving, moving], CONFIG, "phi", PERIOD_S)
    assert found is not None
    assert not found.is_clipped


def levels(kpa: float, gain: float = 1.0, share: float = 1.0) -> Cut:
    """Return a cut in air of this pressure; the ECU leaves a share of its influence.

    In the form of a linear dependence, 10 % less at 75 kPa.
    """
    span = gain * (1.0 - AIR) * (1.0 + share * 0.1 * (kpa - 101.3) / 26.3)
    return Cut(0, {LEVEL: CutReading(1.0 - span, AIR)}, pressure_kpa=kpa)


def gain_of(cut: Cut, *healthy: Cut) -> tuple[float, float]:
    found = reference_of([[each] * 3 for each in healthy], CONFIG, "phi", PERIOD_S)
    assert found is not None
    assert FuelCutReference.from_card(found.to_card(), "card") == found
    gain = judged(cut, reference=found).gain
    assert gain is not None
    return gain


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_mountain_changes_no_span_where_healthy_drives_tell_how_the_reading_depends_on_pressure(
    share: float,
) -> None:
    healthy = [levels(kpa, share=share) for kpa in (76.0, 84.0, 92.0, 101.0)]
    for kpa in (75.0, 101.0):
        assert gain_of(levels(kpa, share=share), *healthy)[0] == pytest.approx(1.0, abs=0.02)


def test_a_mountain_widens_the_span_where_they_do_not_tell() -> None:
    healthy = [levels(kpa) for kpa in (100.0, 101.0, 102.0)]
    gain, std = gain_of(levels(75.0), *healthy)
    assert abs(gain - 1.0) < 2.0 * std
    # AND a lost span shows at sea level
    gain, std = gain_of(levels(101.0, gain=0.85), *healthy)
    assert 1.0 - gain > 8.0 * std


def test_without_a_signal_of_the_pressure_the_span_is_known_less_well() -> None:
    known = [levels(kpa) for kpa in (100.0, 101.0)]
    unknown = [replace(each, pressure_kpa=float("nan")) for each in known]
    least, most = (gain_of(own[0], *own)[1] for own in (known, unknown))
    assert least < 0.02
    assert most > 0.03
    reference = reference_of([unknown] * 3, CONFIG, "phi", PERIOD_S)
    assert not judged(levels(75.0), reference=reference).faults
