"""The chain's steps as nodes of an ONNX graph, all on (batch, 1) tensors.

Each function mirrors a step of ``chain`` or ``charge``; change both together.
"""

from collections.abc import Mapping

import numpy as np

from monitor.base.types import FloatArray
from training.greybox.chain import (
    AIR_LEAST_MG,
    MG_RPM_PER_KG_H,
    PHI_VALVE_MOST,
    SPEED_LEAST_RPM,
    SPEED_MOST_RPM,
    STOICHIOMETRIC,
    TIME_LEAST_S,
    Constants,
)
from training.greybox.charge.error import LEAST as ERROR_LEAST
from training.greybox.charge.error import MOST as ERROR_MOST
from training.greybox.charge.error import ChargeError, share_of
from training.greybox.charge.map import KELVIN, MG_K_PER_KPA, TEMPERATURE_LEAST_K, ChargeMap
from training.greybox.effects.form.place import PathNodes
from training.narx.export import Graph


def base_nodes(graph: Graph, constants: Constants, signals: Mapping[str, str]) -> PathNodes:
    """Add ``chain.base_path``; return the path, which effects may change."""
    c = constants
    rpm = graph.add(
        "Max", [signals["engine_speed_rpm"], graph.constant("speed_least", SPEED_LEAST_RPM)], "rpm"
    )
    air = signals.get("air_mass_mg")
    if air is None:
        scale = graph.constant("charge_scale", MG_RPM_PER_KG_H)
        scaled = graph.add("Mul", [signals["maf_kg_h"], scale], "air_per_time")
        air = graph.add("Div", [scaled, rpm], "charge_mg")
    turning = graph.constant("dead_time_revolutions", 60.0 * c.dead_time_revolutions)
    moving = graph.add("Div", [turning, rpm], "dead_time_moving")
    fixed = graph.constant("dead_time_fixed", c.dead_time_s)
    sensor = graph.constant("sensor_s", [[c.sensor_s]])
    return PathNodes(
        fuel_mg=signals["fuel_mass_mg"],
        air_mg=air,
        factor=graph.constant("gain", c.gain),
        dead_time_s=graph.add("Add", [moving, fixed], "dead_time_s"),
        mixing_s=graph.constant("mixing_s", [[c.mixing_s]]),
        sensor_rising_s=sensor,
        sensor_falling_s=sensor,
        gas_factor=graph.constant("gas_factor", 1.0),
        span=graph.constant("span", c.span),
    )


def speed_nodes(graph: Graph, signals: Mapping[str, str]) -> str:
    """Add ``chain.with_speed``; return the engine speed."""
    scale = graph.constant("speed_scale", MG_RPM_PER_KG_H)
    scaled = graph.add("Mul", [signals["maf_kg_h"], scale], "speed_flow")
    least = graph.constant("speed_air_least", AIR_LEAST_MG)
    air = graph.add("Max", [signals["air_mass_mg"], least], "speed_air")
    limits = [
        graph.constant("speed_low", SPEED_LEAST_RPM),
        graph.constant("speed_high", SPEED_MOST_RPM),
    ]
    return graph.add("Clip", [graph.add("Div", [scaled, air], "speed_raw"), *limits], "speed")


def charge_nodes(graph: Graph, charge_map: ChargeMap, signals: Mapping[str, str]) -> str:
    """Add ``ChargeMap.air_mass_mg``; each sum has at most two terms that are not zero."""
    by_speed = _hats(graph, signals["engine_speed_rpm"], charge_map.speeds_rpm, "speed")
    pressure = signals["manifold_pressure_kpa"]
    by_pressure = _hats(graph, pressure, charge_map.pressures_kpa, "pressure")
    inverse = _map_nodes(
        graph.part("charge_"), by_speed, by_pressure, charge_map.inverse_efficiency
    )
    zero = graph.constant("kelvin", KELVIN)
    kelvin = graph.add("Add", [signals["manifold_temperature_degc"], zero], "charge_kelvin")
    least = graph.constant("kelvin_least", TEMPERATURE_LEAST_K)
    warm = graph.add("Max", [kelvin, least], "charge_warm")
    scale = graph.constant("mg_k_per_kpa", MG_K_PER_KPA)
    dense = graph.add("Div", [graph.add("Mul", [pressure, scale], "charge_hot"), warm], "dense_mg")
    return graph.add("Div", [dense, inverse], "charge_mg")


def charge_error_nodes(
    graph: Graph,
    error: ChargeError,
    signals: Mapping[str, str],
    states: tuple[str, str],
    period_s: float,
) -> tuple[str, list[str]]:
    """Add ``ChargeError.air_mass_mg``; return it and the next states, each (batch, 1).

    states : 1 after the first step, and the lag's state, which starts settled
    """
    graph = graph.part("charge_error_")
    air, (begun, held) = signals["air_mass_mg"], states
    by_speed = _hats(graph, signals["engine_speed_rpm"], error.speeds_rpm, "speed")
    by_charge = _hats(graph, air, error.charges_mg, "charge")
    now, before = (
        _map_nodes(graph.part(f"{name}_"), by_speed, by_charge, values)
        for name, values in (("now", error.now), ("before", error.before))
    )
    is_begun = graph.add("Greater", [begun, graph.constant("half", 0.5)], "is_begun")
    last = graph.add("Where", [is_begun, held, before], "last")
    share = graph.constant("share", share_of(error.time_s, period_s))
    way = graph.add("Mul", [graph.add("Sub", [before, last], "behind"), share], "way")
    late = graph.add("Add", [last, way], "late")
    one = graph.constant("one", 1.0)
    more = graph.add("Add", [graph.add("Add", [now, late], "sum"), one], "factor_free")
    limits = [graph.constant("least", ERROR_LEAST), graph.constant("most", ERROR_MOST)]
    factor = graph.add("Clip", [more, *limits], "factor")
    ever = graph.add("Clip", [begun, one, one], "begun")
    return graph.add("Div", [air, factor], "air_mg"), [ever, late]


def _map_nodes(graph: Graph, by_row: str, by_column: str, values: FloatArray) -> str:
    """Add the value of a map (a, b) for shares (batch, a) and (batch, b) of its knots."""
    middle = graph.constant("middle", [1], np.int64)
    last = graph.constant("last", [2], np.int64)
    wide = graph.add("Unsqueeze", [by_column, middle], "wide")  # (batch, 1, b)
    shares = graph.add("Mul", [wide, graph.constant("map", values[None])], "shares")
    rows = graph.add("ReduceSum", [shares, last], "rows", keepdims=0)  # (batch, a)
    parts = graph.add("Mul", [rows, by_row], "parts")
    return graph.add("ReduceSum", [parts, middle], "value", keepdims=1)


def _hats(graph: Graph, x: str, knots: FloatArray, name: str) -> str:
    """Add the shares (batch, k) of the knots at ``x``: the lower of two ramps, at least 0."""
    inside = graph.add(
        "Min",
        [
            graph.add("Max", [x, graph.constant(f"{name}_first", knots[0])], f"{name}_raised"),
            graph.constant(f"{name}_last", knots[-1]),
        ],
        f"{name}_inside",
    )
    one, zero = graph.constant(f"{name}_one", 1.0), graph.constant(f"{name}_zero", 0.0)
    at = graph.constant(f"{name}_knots", knots[None])
    away = graph.add("Sub", [inside, at], f"{name}_away")
    gaps = np.diff(knots)
    below, above = np.append(gaps[:1], gaps), np.append(gaps, gaps[-1:])
    up = graph.add("Div", [away, graph.constant(f"{name}_below", below[None])], f"{name}_up")
    down = graph.add("Div", [away, graph.constant(f"{name}_above", above[None])], f"{name}_down")
    rising = graph.add("Add", [up, one], f"{name}_rising")
    falling = graph.add("Sub", [one, down], f"{name}_falling")
    return graph.add(
        "Max", [graph.add("Min", [rising, falling], f"{name}_hat"), zero], f"{name}_shares"
    )


def valve_nodes(graph: Graph, nodes: PathNodes) -> str:
    """Add phi at the valve."""
    air = graph.add("Max", [nodes.air_mg, graph.constant("air_least", AIR_LEAST_MG)], "air_safe")
    ratio = graph.add("Div", [nodes.fuel_mg, air], "fuel_over_air")
    scale = graph.constant("stoichiometric", STOICHIOMETRIC)
    phi = graph.add(
        "Mul", [graph.add("Mul", [ratio, scale], "phi_unscaled"), nodes.factor], "phi_free"
    )
    limits = [graph.constant("valve_low", 0.0), graph.constant("valve_high", PHI_VALVE_MOST)]
    return graph.add("Clip", [phi, *limits], "phi_valve")


def late_nodes(graph: Graph, history: str, dead_time_s: str, register: int, period_s: float) -> str:
    """Add the value one dead time ago: hat weights over the register, linear between samples."""
    samples = graph.add("Mul", [dead_time_s, graph.constant("per_period", 1.0 / period_s)], "dead")
    limits = [graph.constant("dead_low", 0.0), graph.constant("dead_high", float(register))]
    dead = graph.add("Clip", [samples, *limits], "dead_samples")
    places = graph.constant("places", np.arange(register + 1)[None])
    away = graph.add("Abs", [graph.add("Sub", [places, dead], "from_place")], "away")
    one, zero = graph.constant("one", 1.0), graph.constant("zero", 0.0)
    hat = graph.add("Max", [graph.add("Sub", [one, away], "hat_free"), zero], "hat")
    axis = graph.constant("late_axis", [1], np.int64)
    return graph.add(
        "ReduceSum", [graph.add("Mul", [history, hat], "shares"), axis], "late", keepdims=1
    )


def lag_weights(graph: Graph, time_s: str, name: str, period_s: float) -> tuple[str, str]:
    """Add the weights of a lag as in ``chain``: 1 minus the state's, and the newest input's."""
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


def lag_nodes(
    graph: Graph, name: str, *, state: str, new: str, last: str, weights: tuple[str, str]
) -> str:
    """Add state + drop · (last - state) + newest · (new - last), exact for a steady input."""
    drop, newest = weights
    behind = graph.add("Sub", [last, state], f"{name}_behind")
    change = graph.add("Sub", [new, last], f"{name}_change")
    parts = [
        graph.add("Mul", [drop, behind], f"{name}_caught"),
        graph.add("Mul", [newest, change], f"{name}_led"),
    ]
    step = graph.add("Add", parts, f"{name}_step")
    return graph.add("Add", [state, step], f"{name}_next")


def pumped_nodes(graph: Graph, nodes: PathNodes, mixed: str) -> str:
    """Add the phi that the sensor pumps of the mixed gas."""
    gas = graph.add("Mul", [mixed, nodes.gas_factor], "gas")
    one = graph.constant("pumped_one", 1.0)
    rich = graph.add("Mul", [graph.add("Sub", [gas, one], "gas_rich"), nodes.span], "rich")
    return graph.add("Add", [rich, one], "pumped")


def sensor_weights(
    graph: Graph, nodes: PathNodes, pumped: str, read: str, period_s: float
) -> tuple[str, str]:
    """Add the weights of the sensor's lag, by direction if its time constants differ."""
    rising = lag_weights(graph, nodes.sensor_rising_s, "rising", period_s)
    if nodes.sensor_falling_s == nodes.sensor_rising_s:
        return rising
    falling = lag_weights(graph, nodes.sensor_falling_s, "falling", period_s)
    up = graph.add("Greater", [pumped, read], "is_rising")
    return (
        graph.add("Where", [up, rising[0], falling[0]], "sensor_drop"),
        graph.add("Where", [up, rising[1], falling[1]], "sensor_newest"),
    )
