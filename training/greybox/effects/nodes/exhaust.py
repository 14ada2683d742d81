"""Effects on the exhaust's way from the valves to the sensor, as ``effects.exhaust`` has them."""

from training.greybox.effects.effect import FLOW_MIN_KG_H, GAS_KG_PER_M3
from training.greybox.effects.exhaust import (
    DEAD_TIME_MAX_S,
    MIXING_MAX_S,
    TAIL_FACTOR_MIN,
    TAIL_FLOW_KG_H,
)
from training.greybox.effects.nodes.form import Form, Parameters
from training.greybox.effects.nodes.place import Place
from training.greybox.effects.nodes.value import Value, clip, exp, maximum, where
from training.greybox.graph.nodes import Nodes

KG_PER_H_AND_LITRE_PER_S = 3.6 * GAS_KG_PER_M3


def _passage_s(at: Place, litres: float) -> Value:
    return litres * KG_PER_H_AND_LITRE_PER_S / at.flow_kg_h()


def _longest_s(litres: float) -> float:
    """Return the passage at the least flow."""
    return max(litres, 0.0) * KG_PER_H_AND_LITRE_PER_S / FLOW_MIN_KG_H


def _delay_flow(at: Place, p: Parameters) -> Nodes:
    dead_time_s = at.of("dead_time_s") + _passage_s(at, p[0])
    return at.changed(dead_time_s=clip(dead_time_s, 0.0, DEAD_TIME_MAX_S))


def _mix_flow(at: Place, p: Parameters) -> Nodes:
    mixing_s = at.of("mixing_s") + _passage_s(at, p[0])
    return at.changed(mixing_s=clip(mixing_s, 0.0, MIXING_MAX_S))


def _exhaust_leak(at: Place, p: Parameters) -> Nodes:
    fraction, fading_kg_h, place = p
    drawn = fraction * exp(-at.flow_kg_h() / fading_kg_h)
    kept = 1.0 - clip(drawn, -0.5, 0.5)
    return at.changed(
        factor=at.of("factor") * kept ** (1.0 - place),
        gas_factor=at.of("gas_factor") * kept**place,
    )


def _fuel_cut_tail(at: Place, p: Parameters) -> Nodes:
    depth, time_s, exponent = p
    runs = at.injecting()
    tail = at.lag(where(runs, 0.0, 1.0), time_s * (TAIL_FLOW_KG_H / at.flow_kg_h()) ** exponent)
    kept = maximum(1.0 - depth * where(runs, tail, 0.0), TAIL_FACTOR_MIN)
    return at.changed(gas_factor=at.of("gas_factor") * kept)


def _longest_tail_s(p: Parameters) -> float:
    """Return the time in which a tail ends at the least flow."""
    return p[1] * (TAIL_FLOW_KG_H / FLOW_MIN_KG_H) ** p[2]


FORMS = {
    "delay_flow": Form(_delay_flow, dead_time_s=lambda p: min(_longest_s(p[0]), DEAD_TIME_MAX_S)),
    "mix_flow": Form(_mix_flow, lag_s=lambda p: min(_longest_s(p[0]), MIXING_MAX_S)),
    "exhaust_leak": Form(_exhaust_leak),
    "fuel_cut_tail": Form(_fuel_cut_tail, 2, lag_s=_longest_tail_s),
}
