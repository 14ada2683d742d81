"""Localising: which driver, point, band and time hold the excess of a made residual."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from monitor.base.errors import RecordingError
from tests.helpers.gap_residuals import (
    NOISE,
    Effect,
    Made,
    at_sensor,
    drive,
    late_edges,
    onset,
    own_error,
    purge,
    wall_film,
)
from training.gap.pages.gap_page import where_section
from training.gap.where.findings import Findings, localise

FLOW = {"maf_kg_h", "inverse_flow_h_kg", "load_times_speed"}


@cache
def found(effect: Effect) -> Findings:
    return localise([drive(seed, effect, n=4000) for seed in (1, 2, 3)])


@pytest.mark.parametrize(
    ("effect", "drivers", "point"),
    [
        (at_sensor, FLOW, "at the sensor"),
        (purge, {"purge_per_flow"}, "before the transport"),
        (late_edges, FLOW, "timing"),
        (wall_film, {"fuel_rate_mg_s", "load_rate_mg_s"}, "before the transport"),
    ],
)
def test_the_driver_and_where_it_enters_are_found(
    effect: Effect, drivers: set[str], point: str
) -> None:
    best = found(effect).regimes[0]
    assert best.significant
    assert best.driver in drivers
    assert best.point == point


def test_what_is_not_told_from_the_best_driver_is_named() -> None:
    result = found(at_sensor)
    names = {result.regimes[0].driver} | {r.driver for r in result.rivals}
    assert names == FLOW  # air flow is load times speed in these drives
    assert "do not tell it from" in result.significant[0]


def test_the_share_of_a_known_effect_lies_within_its_bounds() -> None:
    # GIVEN the same drives with and without purge, in which the excess is the effect alone
    result = found(purge)
    with_effect = [drive(seed, purge, n=4000) for seed in (1, 2, 3)]
    without = [drive(seed, n=4000) for seed in (1, 2, 3)]
    effect = np.concatenate(
        [(a.residual - b.residual)[a.scored] for a, b in zip(with_effect, without, strict=True)]
    )
    # THEN what the best driver explains is the effect beyond its mean, within the bounds
    truth = float(effect.var()) / result.excess.value
    share = result.regimes[0].share
    assert share.low - 0.05 <= truth <= share.high + 0.05
    assert share.high - share.low > 0.01


def test_the_curve_gives_the_size_of_the_effect() -> None:
    curve = next(r.curve for r in found(at_sensor).regimes if r.driver == "maf_kg_h")
    assert curve is not None
    middle = (curve.x > 50) & (curve.x < 150)
    np.testing.assert_allclose(curve.y[middle], 0.006 * (curve.x[middle] / 100 - 1), atol=0.0015)


def test_the_band_and_the_input_it_moves_with_are_found() -> None:
    bands = found(at_sensor).bands
    assert bands is not None
    assert bands.strongest is not None
    assert bands.strongest.coherent_with == "maf_kg_h"
    assert bands.strongest.high_hz < 1.0  # load moves within seconds


def test_a_narrow_disturbance_lies_in_its_band_and_moves_with_no_input() -> None:
    result = localise(
        [drive(s, lambda m: 0.006 * np.sin(2 * np.pi * 1.8 * m.t_s + m.t_s**0.5)) for s in (5, 6)],
        [drive(s) for s in (7, 8)],
    )
    assert result.bands is not None
    best = result.bands.strongest
    assert best is not None
    assert best.low_hz < 1.8 < best.high_hz
    assert best.share.low > 0.8
    assert "no input" in best.sentence


def test_an_onset_is_found_at_its_time_though_the_coolant_warms_meanwhile() -> None:
    result = found(onset)
    clear = [c for c in result.changes if c.significant]
    assert {c.recording for c in clear if c.quantity == "level"} == {
        "drive 1",
        "drive 2",
        "drive 3",
    }
    for change in clear:
        assert change.kind == "onset"
        assert change.t_s == pytest.approx(200.0, abs=30.0)


def test_what_follows_the_coolant_is_no_onset() -> None:
    def cold(made: object) -> np.ndarray:
        return 0.0003 * (90 - made.signals["coolant_temperature_degc"])  # type: ignore[attr-defined]

    result = localise([drive(seed, cold, n=4000) for seed in (1, 2, 3)])
    assert result.regimes[0].driver == "coolant_temperature_degc"
    assert not any(c.significant for c in result.changes)


def test_the_map_shows_where_it_is_largest() -> None:
    result = found(at_sensor)
    assert result.map is not None
    excess = np.where(np.isfinite(result.map.excess), result.map.excess, -1.0)
    row, column = np.unravel_index(np.argmax(excess), excess.shape)
    assert row >= 6  # high load
    assert column >= 6  # high speed


def test_errors_that_the_model_makes_on_healthy_drives_are_no_finding() -> None:
    new = [drive(seed, own_error, n=4000) for seed in (1, 2, 3)]
    alone = localise(new)
    beside = localise(new, [drive(seed, own_error, n=4000) for seed in (4, 5, 6)])
    assert alone.regimes[0].significant
    assert beside.significant == ()


def test_an_effect_is_found_beside_errors_that_healthy_drives_show_too() -> None:
    new = [drive(seed, own_error, purge, n=4000) for seed in (1, 2, 3)]
    result = localise(new, [drive(seed, own_error, n=4000) for seed in (4, 5)])
    assert result.regimes[0].driver == "purge_per_flow"
    assert result.regimes[0].point == "before the transport"


def test_the_noise_floor_holds_the_noise_between_its_two_estimates() -> None:
    for memory, how in ((0.0, "third differences"), (0.7, "pairs of samples")):
        floor = localise([drive(s, memory=memory) for s in (1, 2, 3)]).floor
        assert floor.white_rms == pytest.approx(NOISE * _white_part(memory), rel=0.05)
        assert floor.rms == pytest.approx(NOISE, rel=0.1)
        assert floor.low < floor.rms < floor.high
        assert how in floor.sentence


def _white_part(memory: float) -> float:
    """What third differences see of noise with this memory, from its autocovariance."""
    weights = np.array([1.0, -3.0, 3.0, -1.0])
    lags = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    return float(np.sqrt(weights @ memory**lags @ weights / (weights @ weights)))


@pytest.mark.parametrize("beside_healthy", [False, True])
def test_without_a_gap_at_most_one_case_in_ten_has_a_finding(beside_healthy: bool) -> None:
    hits = []
    for case in range(10):
        memory = (0.0, 0.7, 0.9, 0.97)[case % 4]
        effects = (own_error,) if beside_healthy else ()
        seeds = [1000 + 10 * case + i for i in range(1 + (case // 4) % 2)]
        new = [drive(s, *effects, n=3600, memory=memory) for s in seeds]
        healthy = [drive(s + 5, *effects, n=3600, memory=memory) for s in seeds]
        result = localise(new, healthy if beside_healthy else ())
        hits.append(bool(result.significant))
    assert sum(hits) <= 1


@pytest.mark.parametrize(
    ("slope_1_s", "few", "many", "samples"), [(1.5, 3, 5, 3000), (0.001, 6, 12, 1500)]
)
def test_a_driver_that_tells_few_drives_apart_is_left_out_and_the_notes_say_so(
    slope_1_s: float, few: int, many: int, samples: int
) -> None:
    # GIVEN what differs more between drives than within them, or is constant as the weather is
    def hot(made: Made) -> np.ndarray:
        made.signals["ambient_temperature_degc"] = (  # type: ignore[index]
            made.t_s * slope_1_s + float(made.signals["engine_speed_rpm"][0])
        )
        return np.zeros(len(made.t_s))

    # WHEN there are few and many drives
    left_out, looked_at = (
        localise([drive(seed, hot, n=samples) for seed in range(1, 1 + n)]) for n in (few, many)
    )
    # THEN only many are asked for it
    assert "ambient_temperature_degc" not in {r.driver for r in left_out.regimes}
    assert any("ambient temperature" in note for note in left_out.notes)
    assert "ambient_temperature_degc" in {r.driver for r in looked_at.regimes}


def test_signals_of_another_length_are_refused() -> None:
    one = drive(1)
    with pytest.raises(RecordingError, match=r"short: predicted phi has shape \(5999,\)"):
        replace(one, name="short", phi_predicted=one.phi_predicted[1:])


def test_too_little_to_resample_is_refused() -> None:
    with pytest.raises(RecordingError, match="drive 1: scored samples in 4 blocks"):
        localise([drive(1, n=1200)])


def test_recordings_of_different_periods_are_refused() -> None:
    other = drive(2)
    object.__setattr__(other, "period_s", 0.05)
    with pytest.raises(RecordingError, match="periods of"):
        localise([drive(1), other])


def test_the_page_says_what_was_found_and_the_same_findings_give_the_same_page() -> None:
    result = found(purge)
    text = where_section(result)
    for sentence in result.significant:
        assert sentence.split(":")[0] in text
    assert text.count("<figure>") == 6
    again = localise([drive(seed, purge, n=4000) for seed in (1, 2, 3)])
    assert where_section(again) == text


def test_the_entries_of_the_report_are_shares_between_0_and_1() -> None:
    entries = found(purge).where()
    assert entries[0]["driver"] == "purge_per_flow"
    assert {e["kind"] for e in entries} >= {"regime", "band"}
    for entry in entries:
        assert 0.0 <= entry["share_low"] <= entry["share_of_excess"] <= entry["share_high"] <= 1.0
