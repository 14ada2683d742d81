"""The vehicle's reference: what healthy drives teach, and that no fault is learned away."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.judge.bias import BiasRule
from monitor.judge.limits import Limits
from monitor.memory.reference import Reference, Seen

BIAS = config.load().bias
SPAN = BIAS.fuel_span_lambda


def learned(offsets: list[float], gain: float = 1.0) -> Reference:
    reference = Reference()
    for offset in offsets:
        reference = reference.learn(Seen(offset, gain), BIAS)
    return reference


def is_found(offset: float, reference: Reference) -> bool:
    """Whether a drive with this offset raises the bias fault within 40 windows."""
    limits = Limits(offset_std=BIAS.window_std_lambda).of_vehicle(reference, BIAS)
    rule = BiasRule(BIAS, limits)
    return any(rule.judge(offset).outcome == "failed" for _ in range(40))


@given(st.floats(-0.04, 0.04), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40))
def test_no_fuel_makes_a_known_vehicle_faulty(piece: float, fuels: list[float]) -> None:
    # GIVEN a vehicle known from drives with any fuels from E0 to E10
    reference = learned([piece + SPAN * fuel for fuel in fuels])
    assert not any(is_found(piece + SPAN * fuel, reference) for fuel in (0.0, 0.5, 1.0))


@given(st.floats(-0.04, 0.04), st.floats(0.0, 1.0), st.sampled_from([-1.0, 1.0]))
def test_an_offset_is_found_once_the_fuels_are_known(
    piece: float, fuel: float, sign: float
) -> None:
    # GIVEN a vehicle that was seen with pure petrol and with E10
    reference = learned([piece, piece + SPAN])
    assert is_found(piece + SPAN * fuel + sign * 0.05, reference)


@given(st.floats(-0.03, 0.03), st.floats(1e-4, 0.004), st.sampled_from([-1.0, 1.0]))
def test_a_creeping_offset_is_not_learned_away(piece: float, step: float, sign: float) -> None:
    # GIVEN a sensor that drifts a little in every drive, and each drive is learned if it passes
    reference, offset = learned([piece]), piece
    for _ in range(2000):
        offset += sign * step
        if is_found(offset, reference):
            break
        reference = reference.learn(Seen(offset, 1.0), BIAS)
    # THEN it is found as soon as no fuel explains the whole of the drift
    assert abs(offset - piece) <= SPAN + BIAS.certainty * BIAS.window_std_lambda + step


@given(st.lists(st.floats(-0.08, 0.08), min_size=1, max_size=60))
def test_the_offsets_learned_never_span_more_than_the_fuel(offsets: list[float]) -> None:
    reference = learned(offsets)
    assert reference.offset_high - reference.offset_low <= SPAN + 1e-12
    assert reference.drives == len(offsets)


@given(st.lists(st.floats(0.3, 1.5), min_size=1, max_size=60))
def test_the_gain_stays_within_the_spread_of_vehicles(gains: list[float]) -> None:
    reference = Reference()
    for gain in gains:
        reference = reference.learn(Seen(0.0, gain), BIAS)
    assert abs(reference.gain - 1.0) <= BIAS.gain_spread + 1e-12


def test_the_gain_is_held_after_the_first_drives() -> None:
    known = learned([0.0] * BIAS.gain_drives, gain=0.95)
    assert known.gain == pytest.approx(0.95)
    assert known.learn(Seen(0.0, 0.7), BIAS).gain == known.gain
