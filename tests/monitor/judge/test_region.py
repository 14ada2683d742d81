"""The joint region of the inputs: driving that a model never learned is no evidence."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from monitor.base import config
from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.judge.decision.decisions import Decisions
from monitor.judge.findings import WindowJudged
from monitor.judge.limits import NO_LIMITS, Limits
from monitor.judge.response.bank import build
from monitor.judge.response.region import Region
from monitor.judge.window import Window
from monitor.memory.dtc_store import DtcStore
from monitor.model.step import Model
from monitor.pipeline.replay import shipped_model
from tests.helpers.models.bank import readings
from training.limits.response.region import region_of

CONFIG = config.load()
BANK = build(CONFIG.response)
PERIOD_S, N = 0.1, 50
NAMES = ("engine_speed_rpm", "air_mass_mg")


def inputs(n: int, rng: np.random.Generator) -> FloatArray:
    """Light load at high speed, full load at low speed; never both high."""
    share = rng.uniform(size=(n, 1, 1))
    centre = np.concatenate([1000.0 + 4000.0 * share, 900.0 - 700.0 * share], axis=2)
    return np.asarray(centre + rng.normal(0.0, 30.0, (n, N, 2)))


def judged(n: int, own_inputs: FloatArray, limits: Limits, gain: float) -> list[WindowJudged]:
    """Windows in which a sensor of this gain follows a mixture that moves."""
    rng = np.random.default_rng(5)
    phase = 2.0 * np.pi * 0.45 * PERIOD_S * np.arange(n * N)
    phi = 1.0 + 0.03 * np.sin(phase) + 0.01 * np.sin(0.31 * phase)
    measured = 1.0 / (1.0 + gain * (phi - 1.0) + 0.002 * rng.standard_normal(n * N))
    bank = readings(BANK, PERIOD_S, phi)
    store = DtcStore()
    store.start_driving_cycle()
    decisions = Decisions(
        limits=limits,
        config=CONFIG,
        hypotheses=BANK,
        transform="phi",
        end=math.inf,
        period_s=PERIOD_S,
        store=store,
    )
    windows = [
        Window(
            index=i,
            t_start_ns=i * N,
            t_end_ns=(i + 1) * N - 1,
            measured=measured[part],
            predicted=1.0 / phi[part],
            bank=bank[part],
            inputs=each,
        )
        for i, each in enumerate(own_inputs)
        for part in [slice(i * N, (i + 1) * N)]
    ]
    found = []
    for window, facts in zip(windows, decisions.facts(windows), strict=True):
        found += [e for e in decisions.window(window, facts) if isinstance(e, WindowJudged)]
    return found


def learned() -> Region:
    rng = np.random.default_rng(1)
    drives = [judged(60, inputs(60, rng), limits_with(None), 1.0) for _ in range(5)]
    region = region_of(drives, NAMES)
    assert region is not None
    return region


def limits_with(region: Region | None) -> Limits:
    return replace(NO_LIMITS, noise=0.004, noise_memory=0.3, region=region)


def outcomes(windows: Sequence[WindowJudged]) -> set[str]:
    return {window.outcome for window in windows}


def test_a_window_outside_the_joint_region_is_no_evidence_though_each_input_is_in_its_range() -> (
    None
):
    region = learned()
    rng = np.random.default_rng(2)
    both_high = np.array([4500.0, 800.0]) + rng.normal(0.0, 30.0, (40, N, 2))
    usual = inputs(40, rng)
    weak = judged(40, both_high, limits_with(region), gain=0.5)
    assert outcomes(weak) == {"inconclusive"}
    assert all((w.statistics.region_beyond or 0.0) > 1.0 for w in weak)
    assert "failed" in outcomes(judged(40, both_high, limits_with(None), gain=0.5))
    assert "failed" in outcomes(judged(40, usual, limits_with(region), gain=0.5))


def test_windows_of_a_drive_that_was_not_learned_lie_in_the_region() -> None:
    region = learned()
    beyond = region.beyond(inputs(300, np.random.default_rng(7)))
    assert beyond.max() <= 1.0


def test_the_controller_that_a_faulty_sensor_moves_does_not_leave_the_region() -> None:
    # GIVEN a network that also reads the lambda controller, which hardly moves in healthy drives
    rng = np.random.default_rng(11)
    names, ignored = (*NAMES, "lambda_controller"), CONFIG.enable.range_ignored

    def with_controller(n: int, mean: float) -> FloatArray:
        controller = rng.normal(mean, 0.004, (n, N, 1))
        return np.concatenate([inputs(n, rng), controller], axis=2)

    drives = [judged(60, with_controller(60, 1.0), limits_with(None), 1.0) for _ in range(5)]
    every_input = region_of(drives, names)
    region = region_of(drives, names, ignored)
    assert every_input is not None
    assert region is not None
    # WHEN an offset of the sensor moves it by 5 %
    biased = with_controller(40, 1.05)
    # THEN the windows are evidence, with a new card and with one that counts every input
    assert every_input.beyond(biased).min() > 1.0
    assert region.beyond(biased).max() <= 1.0
    card = replace(Model.load(shipped_model()).card, region=every_input.to_card())
    of_old_card = Limits.from_card(card, CONFIG, "m.onnx").region
    assert of_old_card is not None
    assert of_old_card.beyond(biased).max() <= 1.0
    # and driving that was not learned is still none
    both_high = with_controller(40, 1.0)
    both_high[:, :, :2] = np.array([4500.0, 800.0]) + rng.normal(0.0, 30.0, (40, N, 2))
    assert region.beyond(both_high).min() > 1.0


def test_few_windows_give_no_region() -> None:
    drive = judged(20, inputs(20, np.random.default_rng(3)), limits_with(None), 1.0)
    assert region_of([drive], NAMES) is None


def test_one_drive_alone_gives_a_region() -> None:
    drive = judged(80, inputs(80, np.random.default_rng(3)), limits_with(None), 1.0)
    region = region_of([drive], NAMES)
    assert region is not None
    assert region.beyond(inputs(50, np.random.default_rng(4))).max() <= 1.0


def test_an_input_that_stood_still_when_learned_does_not_divide_by_zero() -> None:
    still = inputs(80, np.random.default_rng(3))
    still[:, :, 1] = 300.0
    region = region_of([judged(80, still, limits_with(None), 1.0)], NAMES)
    assert region is not None
    assert np.isfinite(region.beyond(still)).all()


def test_a_card_keeps_the_region() -> None:
    region = learned()
    again = Region.from_card(region.to_card(), "m.onnx")
    assert again is not None
    x = inputs(20, np.random.default_rng(9))
    assert (again.beyond(x) == region.beyond(x)).all()
    assert Region.from_card({}, "m.onnx") is None


@pytest.mark.parametrize(
    "change", [{"most": 0.0}, {"points": [[1.0]]}, {"scale": "wide"}, {"points": []}]
)
def test_a_damaged_region_names_its_file(change: dict[str, object]) -> None:
    with pytest.raises(ModelError, match=r"m\.onnx"):
        Region.from_card({**learned().to_card(), **change}, "m.onnx")
