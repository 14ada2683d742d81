"""The grey-box chain as the ONNX graph ``step``.

State: the reading (phi, so that the monitor can force it), the shift register of phi at the valve,
newest first, then what each lag remembers, and last the states of added effects. Every node works
element by element, and the one sum has at most two terms that are not zero: single and batched
runs give the same bits. Constants and names follow ``chain``; a change there is a change here.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from onnx import ModelProto, helper

from monitor.errors import ModelError
from monitor.model import LAMBDA_MAX, PHI_MAX
from monitor.model_card import METADATA_KEY, ModelCard, StateLayout
from monitor.types import FloatArray
from training.chain import (
    AIR_LEAST_MG,
    CYLINDERS,
    PHI_VALVE_MOST,
    SPEED_LEAST_RPM,
    STOICHIOMETRIC,
    TIME_LEAST_S,
    Constants,
)
from training.export import Graph, finished
from training.greybox_charge import KELVIN, MG_K_PER_KPA, TEMPERATURE_LEAST_K, ChargeMap

FORGOTTEN = 12.0  # time constants after which a lag's start no longer matters


@dataclass(frozen=True, slots=True)
class Nodes:
    """``chain.Path`` in the graph: the name of a (batch, 1) or scalar tensor for each field."""

    fuel_mg: str
    air_mg: str
    factor: str
    dead_time_s: str
    mixing_s: str
    sensor_rising_s: str
    sensor_falling_s: str
    gas_factor: str
    gas_offset: str
    span: str


@dataclass(frozen=True, slots=True)
class GraphEffect:
    """An effect as nodes: it changes what happens on the way, from inputs and its own states.

    add : (graph, path, signals, states) to the changed path and the next states; ``signals`` are
        the clipped inputs by name, ``states`` the names of ``n_states`` tensors, each (batch, 1).
        Names of nodes must be the effect's own.
    """

    name: str
    n_states: int
    add: Callable[
        [Graph, Nodes, Mapping[str, str], Sequence[str]], tuple[Nodes, Sequence[str]]
    ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Greybox:
    """Everything that the graph contains."""

    constants: Constants
    inputs: tuple[str, ...]  # more than the chain's are for effects
    u_low: FloatArray  # (n_inputs,), inputs are clipped to this range first
    u_high: FloatArray
    period_s: float
    register: int  # samples of phi at the valve that the state remembers
    charge_map: ChargeMap | None = None  # without, the charge is an input
    effects: tuple[GraphEffect, ...] = ()

    @classmethod
    def of(cls, card: ModelCard) -> "Greybox":
        """Return what the graph of a model was built from, without its added effects.

        Raises ModelError if the card is not a grey-box model's.
        """
        if card.kind != "greybox":
            raise ModelError(f"a {card.kind} model, a greybox is wanted")
        try:
            given = card.structure
            constants = Constants(**{n: c["value"] for n, c in given["constants"].items()})
            low, high = (np.array(given[name]) for name in ("inputs_low", "inputs_high"))
            register = int(given["register_samples"])
            own = given["charge_map"]
            charge_map = None if own is None else ChargeMap.from_card(own)
        except (KeyError, TypeError) as error:
            raise ModelError(
                f"the card of a greybox lacks part of its structure: {error}"
            ) from None
        return cls(
            constants, card.input_names, low, high, card.period_ns / 1e9, register, charge_map
        )

    def structure(self) -> dict[str, Any]:
        """Return what the card's structure needs beside the constants."""
        return {
            "register_samples": self.register,
            "charge_map": None if self.charge_map is None else self.charge_map.to_card(),
            "inputs_low": self.u_low.tolist(),
            "inputs_high": self.u_high.tolist(),
        }

    @property
    def state_layout(self) -> StateLayout:
        """Size of the state; the reading lies first."""
        return StateLayout(4 + self.register + sum(e.n_states for e in self.effects), 0, 1, 1)

    @property
    def memory(self) -> int:
        """Samples after which a steady input has filled the register and both lags."""
        lags_s = self.constants.mixing_s + self.constants.sensor_s
        return self.register + math.ceil(FORGOTTEN * lags_s / self.period_s)

    def signals(self, u: FloatArray) -> dict[str, FloatArray]:
        """Return the signals (n,) of ``u`` (n, n_inputs) as the graph sees them, with the charge.

        The inputs are clipped; a charge map makes ``air_mass_mg``, whatever was measured.
        """
        limited = np.clip(u, self.u_low, self.u_high)
        signals = {name: limited[:, i] for i, name in enumerate(self.inputs)}
        if self.charge_map is not None:
            signals["air_mass_mg"] = self.charge_map.air_mass_mg(signals)
        return signals


def register_for(longest_s: float, period_s: float) -> int:
    """Return the samples of register that a dead time of ``longest_s`` needs.

    >>> register_for(0.25, 0.1)
    3
    """
    return max(math.ceil(longest_s / period_s), 1)


def build(greybox: Greybox) -> ModelProto:
    """Return the graph ``step``, float32, without a card."""
    graph, register = Graph(), greybox.register
    names = [graph.constant("u_low", greybox.u_low[None]),
             graph.constant("u_high", greybox.u_high[None])]  # fmt: skip
    graph.add("Min", [graph.add("Max", ["u", names[0]], "u_raised"), names[1]], "u_clipped")
    signals = {
        name: graph.take("u_clipped", i, i + 1, f"signal_{name}")
        for i, name in enumerate(greybox.inputs)
    }
    if greybox.charge_map is not None:
        signals["air_mass_mg"] = _charge(graph, greybox.charge_map, signals)
    nodes, at, kept = base_nodes(graph, greybox.constants, signals), 4 + register, []
    for effect in greybox.effects:
        states = [graph.take("state", at + i, at + i + 1, f"{effect.name}_state{i}")
                  for i in range(effect.n_states)]  # fmt: skip
        nodes, after = effect.add(graph, nodes, signals, states)
        kept += list(after)
        at += effect.n_states
    valve = _valve(graph, nodes)
    places = {"read": 0, "late": 1 + register, "mixed": 2 + register, "pumped": 3 + register}
    old = {name: graph.take("state", i, i + 1, f"old_{name}") for name, i in places.items()}
    history = graph.add("Concat", [valve, graph.take("state", 1, 1 + register, "past")],
                        "history", axis=1)  # fmt: skip
    late = _late(graph, history, nodes.dead_time_s, greybox)
    weights = _lag_weights(graph, nodes.mixing_s, "mixing", greybox.period_s)
    mixed = _lag(graph, old["mixed"], late, old["late"], weights, "mixed")
    pumped = _pumped(graph, nodes, mixed)
    weights = _sensor_weights(graph, nodes, pumped, old["read"], greybox.period_s)
    read = _lag(graph, old["read"], pumped, old["pumped"], weights, "read")
    limits = [graph.constant("phi_low", 0.0), graph.constant("phi_high", PHI_MAX)]
    phi = graph.add("Clip", [read, *limits], "phi")
    least = graph.constant("phi_least", 1.0 / LAMBDA_MAX)
    graph.add("Reciprocal", [graph.add("Max", [phi, least], "phi_readable")], "lambda_hat")
    rest = graph.take("history", 0, register, "next_register")
    graph.add("Concat", [phi, rest, late, mixed, pumped, *kept], "next_state", axis=1)
    return finished(graph, len(greybox.inputs), greybox.state_layout.size)


def save(path: Path | str, greybox: Greybox, card: ModelCard) -> None:
    """Write graph and card to one file."""
    model = build(greybox)
    helper.set_model_props(model, {METADATA_KEY: card.to_json()})
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_bytes(model.SerializeToString())


def base_nodes(graph: Graph, constants: Constants, signals: Mapping[str, str]) -> Nodes:
    """Add what ``chain.base_path`` computes; effects change what it returns."""
    c = constants
    rpm = graph.add(
        "Max", [signals["engine_speed_rpm"], graph.constant("speed_least", SPEED_LEAST_RPM)], "rpm"
    )
    air = signals.get("air_mass_mg")
    if air is None:
        scale = graph.constant("charge_scale", 1e6 / 3600.0 * 120.0 / CYLINDERS)
        scaled = graph.add("Mul", [signals["maf_kg_h"], scale], "air_per_time")
        air = graph.add("Div", [scaled, rpm], "charge_mg")
    turning = graph.constant("dead_time_revolutions", 60.0 * c.dead_time_revolutions)
    moving = graph.add("Div", [turning, rpm], "dead_time_moving")
    fixed = graph.constant("dead_time_fixed", c.dead_time_s)
    sensor = graph.constant("sensor_s", [[c.sensor_s]])
    return Nodes(
        fuel_mg=signals["fuel_mass_mg"],
        air_mg=air,
        factor=graph.constant("gain", c.gain),
        dead_time_s=graph.add("Add", [moving, fixed], "dead_time_s"),
        mixing_s=graph.constant("mixing_s", [[c.mixing_s]]),
        sensor_rising_s=sensor,
        sensor_falling_s=sensor,
        gas_factor=graph.constant("gas_factor", 1.0),
        gas_offset=graph.constant("gas_offset", 0.0),
        span=graph.constant("span", c.span),
    )


def with_fields(nodes: Nodes, **changed: str) -> Nodes:
    """Return the nodes with some of them replaced; what an effect returns.

    >>> nodes = Nodes(*("fuel air gain dead mix up down one zero span".split()))
    >>> with_fields(nodes, fuel_mg="film").fuel_mg
    'film'
    """
    return replace(nodes, **changed)


def _charge(graph: Graph, charge_map: ChargeMap, signals: Mapping[str, str]) -> str:
    """Add ``ChargeMap.air_mass_mg``; no sum has more than two terms that are not zero."""
    by_speed = _hats(graph, signals["engine_speed_rpm"], charge_map.speeds_rpm, "speed")
    pressure = signals["manifold_pressure_kpa"]
    by_pressure = _hats(graph, pressure, charge_map.pressures_kpa, "pressure")
    middle = graph.constant("charge_middle", [1], np.int64)
    last = graph.constant("charge_last", [2], np.int64)
    wide = graph.add("Unsqueeze", [by_pressure, middle], "pressure_wide")  # (batch, 1, b)
    map_values = graph.constant("inverse_efficiency", charge_map.inverse_efficiency[None])
    shares = graph.add("Mul", [wide, map_values], "charge_shares")  # (batch, a, b)
    rows = graph.add("ReduceSum", [shares, last], "charge_rows", keepdims=0)
    parts = graph.add("Mul", [rows, by_speed], "charge_parts")
    inverse = graph.add("ReduceSum", [parts, middle], "charge_inverse", keepdims=1)
    zero = graph.constant("kelvin", KELVIN)
    kelvin = graph.add("Add", [signals["manifold_temperature_degc"], zero], "charge_kelvin")
    least = graph.constant("kelvin_least", TEMPERATURE_LEAST_K)
    warm = graph.add("Max", [kelvin, least], "charge_warm")
    scale = graph.constant("mg_k_per_kpa", MG_K_PER_KPA)
    dense = graph.add("Div", [graph.add("Mul", [pressure, scale], "charge_hot"), warm], "dense_mg")
    return graph.add("Div", [dense, inverse], "charge_mg")


def _hats(graph: Graph, x: str, knots: FloatArray, name: str) -> str:
    """Add the shares (batch, k) of the knots at ``x``: the lower of two ramps, within 0 .. 1."""
    inside = graph.add(
        "Min",
        [graph.add("Max", [x, graph.constant(f"{name}_first", knots[0])], f"{name}_raised"),
         graph.constant(f"{name}_last", knots[-1])],
        f"{name}_inside",
    )  # fmt: skip
    one, zero = graph.constant(f"{name}_one", 1.0), graph.constant(f"{name}_zero", 0.0)
    at = graph.constant(f"{name}_knots", knots[None])
    away = graph.add("Sub", [inside, at], f"{name}_away")
    gaps = np.diff(knots)
    below, above = np.append(gaps[:1], gaps), np.append(gaps, gaps[-1:])
    up = graph.add("Div", [away, graph.constant(f"{name}_below", below[None])], f"{name}_up")
    down = graph.add("Div", [away, graph.constant(f"{name}_above", above[None])], f"{name}_down")
    rising = graph.add("Add", [up, one], f"{name}_rising")
    falling = graph.add("Sub", [one, down], f"{name}_falling")
    return graph.add("Max", [graph.add("Min", [rising, falling], f"{name}_hat"), zero],
                     f"{name}_shares")  # fmt: skip


def _valve(graph: Graph, nodes: Nodes) -> str:
    air = graph.add("Max", [nodes.air_mg, graph.constant("air_least", AIR_LEAST_MG)], "air_safe")
    ratio = graph.add("Div", [nodes.fuel_mg, air], "fuel_over_air")
    scale = graph.constant("stoichiometric", STOICHIOMETRIC)
    phi = graph.add("Mul", [graph.add("Mul", [ratio, scale], "phi_unscaled"), nodes.factor],
                    "phi_free")  # fmt: skip
    limits = [graph.constant("valve_low", 0.0), graph.constant("valve_high", PHI_VALVE_MOST)]
    return graph.add("Clip", [phi, *limits], "phi_valve")


def _late(graph: Graph, history: str, dead_time_s: str, greybox: Greybox) -> str:
    """Add the value one dead time ago: hat weights over the register, linear between samples."""
    period, most = greybox.period_s, float(greybox.register)
    samples = graph.add("Mul", [dead_time_s, graph.constant("per_period", 1.0 / period)], "dead")
    limits = [graph.constant("dead_low", 0.0), graph.constant("dead_high", most)]
    dead = graph.add("Clip", [samples, *limits], "dead_samples")
    places = graph.constant("places", np.arange(greybox.register + 1)[None])
    away = graph.add("Abs", [graph.add("Sub", [places, dead], "from_place")], "away")
    one, zero = graph.constant("one", 1.0), graph.constant("zero", 0.0)
    hat = graph.add("Max", [graph.add("Sub", [one, away], "hat_free"), zero], "hat")
    axis = graph.constant("late_axis", [1], np.int64)
    return graph.add("ReduceSum", [graph.add("Mul", [history, hat], "shares"), axis], "late",
                     keepdims=1)  # fmt: skip


def _lag_weights(graph: Graph, time_s: str, name: str, period_s: float) -> tuple[str, str]:
    """Add 1 - keep and the newest input's weight of a lag, as in ``chain``."""
    scale = graph.constant(f"{name}_per_period", 1.0 / period_s)
    least = graph.constant(f"{name}_least", TIME_LEAST_S)
    one = graph.constant(f"{name}_one", 1.0)
    scaled = graph.add("Mul", [time_s, scale], f"{name}_scaled")
    time = graph.add("Max", [scaled, least], f"{name}_samples")
    decay = graph.add("Neg", [graph.add("Reciprocal", [time], f"{name}_rate")], f"{name}_decay")
    keep = graph.add("Exp", [decay], f"{name}_keep")
    drop = graph.add("Sub", [one, keep], f"{name}_drop")
    lost = graph.add("Mul", [time, drop], f"{name}_lost")
    return drop, graph.add("Sub", [one, lost], f"{name}_newest")


def _lag(graph: Graph, state: str, new: str, last: str, weights: tuple[str, str], name: str) -> str:
    """Add state + drop · (last - state) + newest · (new - last): a steady input is met exactly."""
    drop, newest = weights
    behind = graph.add("Sub", [last, state], f"{name}_behind")
    change = graph.add("Sub", [new, last], f"{name}_change")
    parts = [graph.add("Mul", [drop, behind], f"{name}_caught"),
             graph.add("Mul", [newest, change], f"{name}_led")]  # fmt: skip
    step = graph.add("Add", parts, f"{name}_step")
    return graph.add("Add", [state, step], f"{name}_next")


def _pumped(graph: Graph, nodes: Nodes, mixed: str) -> str:
    scaled = graph.add("Mul", [mixed, nodes.gas_factor], "gas_scaled")
    gas = graph.add("Add", [scaled, nodes.gas_offset], "gas")
    one = graph.constant("pumped_one", 1.0)
    rich = graph.add("Mul", [graph.add("Sub", [gas, one], "gas_rich"), nodes.span], "rich")
    return graph.add("Add", [rich, one], "pumped")


def _sensor_weights(
    graph: Graph, nodes: Nodes, pumped: str, read: str, period_s: float
) -> tuple[str, str]:
    rising = _lag_weights(graph, nodes.sensor_rising_s, "rising", period_s)
    if nodes.sensor_falling_s == nodes.sensor_rising_s:
        return rising
    falling = _lag_weights(graph, nodes.sensor_falling_s, "falling", period_s)
    up = graph.add("Greater", [pumped, read], "is_rising")
    return (
        graph.add("Where", [up, rising[0], falling[0]], "sensor_drop"),
        graph.add("Where", [up, rising[1], falling[1]], "sensor_newest"),
    )
