"""The healthy behaviour as a part of the model card: the workflow then needs no healthy drives.

It stands under ``reference["gap"]`` and is as good as the columns that it weighs. They are compared
by name and by their size on a drive made of formulas, so that a card written by code with other
columns is told.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from monitor.base.files.outputs import write_text
from monitor.base.types import BoolArray, FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.greybox.chain import STOICHIOMETRIC, Constants
from training.greybox.charge import ChargeError
from training.greybox.effects import LIBRARY
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive, make
from training.greybox.fit.ridge import Ridge
from training.healthy.behaviour import Healthy, columns
from training.healthy.config import CONFIG
from training.healthy.operating_points import Visited
from training.narx.export import update_card
from training.recordings.recording import Recording

KEY: Final = "gap"
SCHEMA: Final = "o2train.gap_reference/2"
DIGITS: Final = 7
EXACT: Final = 17
PROBE_DIGITS: Final = 4
PROBE_SAMPLES, PROBE_PERIOD_S = 1200, 0.1


def kept(path: Path | None, learn: Callable[[], Healthy]) -> Healthy:
    """Return the behaviour in a file, every digit of it; else learn it and keep it there."""
    if path is None:
        return learn()
    with suppress(OSError, AttributeError, KeyError, TypeError, ValueError):  # none, or damaged
        return _known(json.loads(path.read_text()))
    known = learn()
    write_text(path, json.dumps(to_card(known, (), digits=EXACT)))
    return known


def to_card(
    known: Healthy, recordings: Sequence[Recording], *, digits: int = DIGITS
) -> dict[str, Any]:
    """Return ``known`` as JSON can hold it.

    recordings : from which it was learned
    digits : of a number, that count
    """

    def rounded(value: float) -> float:
        return _rounded(value, digits)

    def listed(values: FloatArray) -> list[float]:
        return [rounded(value) for value in values]

    def constants(values: Constants) -> dict[str, float]:
        return {name: rounded(value) for name, value in values._asdict().items()}

    sizes = _sizes()
    return {
        "schema": SCHEMA,
        "recordings": [recording.path.name for recording in recordings],
        "base": constants(known.base),
        "plain": constants(known.plain),
        "own": {each.name: listed(each.values) for each in known.own},
        "columns": list(known.names),
        "size": [_rounded(sizes[name], PROBE_DIGITS) for name in known.names],
        "weight": listed(known.ridge.weights),
        "low": listed(known.ridge.low),
        "high": listed(known.ridge.high),
        "penalty": known.ridge.penalty,
        "spread": listed(known.spread),
        **({"doubt": [*map(listed, known.doubt)]} if known.doubt.size else {}),
        "visited": {
            "cells": [_bits(row) for row in known.visited.cells],
            "coolants": _bits(known.visited.coolants),
        },
        "surplus": {name: rounded(value) for name, value in sorted(known.surplus.items())},
        "charge": None if known.charge is None else known.charge.to_card(),
        "rmse_usual": known.rmse_usual,
    }


def store(path: Path, known: Healthy, recordings: Sequence[Recording]) -> ModelCard:
    """Put ``known``, learned from ``recordings``, into the card of the model in ``path``."""
    card = Model.load(path).card
    card = replace(card, reference=dict(card.reference) | {KEY: to_card(known, recordings)})
    update_card(path, card)
    return card


def from_card(card: ModelCard) -> tuple[Healthy | None, str | None]:
    """Return the healthy behaviour in a card, or None and the reason why it cannot be used."""
    stored = card.reference.get(KEY)
    if stored is None:
        return None, None
    schema = stored.get("schema") if isinstance(stored, Mapping) else None
    if schema != SCHEMA:
        return None, _unused(f"it has schema {schema!r}, wanted {SCHEMA!r}")
    try:
        strange = _strange(stored)
        if strange:
            return None, _unused(f"it weighs columns of other code: {', '.join(strange[:3])}")
        return _known(stored), None
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        return None, _unused(f"it cannot be read: {error!r}")


def known_of(card: ModelCard) -> tuple[Healthy | None, list[str]]:
    """Return the healthy behaviour in a card and the doubts that come with it."""
    known, why = from_card(card)
    if known is None:
        return None, [why] if why else []
    n = len(card.reference[KEY]["recordings"])
    doubts = [
        f"no healthy recordings were given: the reference in the model's card serves, of {n} "
        "recordings; where the gap lies, and whether the new model raises false alarms on a "
        "vehicle as it was, is told without healthy drives to compare"
    ]
    if card.kind == "narx":
        doubts.append(
            "the reference is of the chain charge, fuel, transport, mixing, sensor, and names what "
            "the vehicle has now and had not then: what the network alone makes wrong is not "
            "looked at"
        )
    return known, doubts


def _unused(why: str) -> str:
    return f"the healthy reference in the model's card is not used, {why}: fit the model anew"


def _strange(stored: Mapping[str, Any]) -> list[str]:
    """Return the columns that this code does not make, or makes otherwise."""
    sizes = _sizes()
    pairs = zip(stored["columns"], stored["size"], strict=True)
    return [
        n
        for n, size in pairs
        if not np.isclose(sizes.get(n, np.nan), size, rtol=CONFIG.column_size_tolerance)
    ]


def _known(stored: Mapping[str, Any]) -> Healthy:
    names = tuple(str(name) for name in stored["columns"])
    weight, low, high, spread = (
        _array(stored[key], len(names)) for key in ("weight", "low", "high", "spread")
    )
    penalty, doubt = float(stored["penalty"]), np.reshape(stored.get("doubt", []), (len(names), -1))
    visited = Visited(
        np.stack([_bools(row) for row in stored["visited"]["cells"]]),
        _bools(stored["visited"]["coolants"]),
    )
    if [visited.cells.shape, visited.coolants.shape] != [each.shape for each in _nowhere()]:
        raise ValueError("its operating points are others")
    return Healthy(
        base=_constants(stored["base"]),
        plain=_constants(stored["plain"]),
        own=tuple(
            ModelEffect.with_values(name, _array(values, len(LIBRARY[name].parameters)).tolist())
            for name, values in stored["own"].items()
        ),
        names=names,
        ridge=Ridge(weight, low, high, held_out=np.empty(0), penalty=penalty, doubt=doubt),
        spread=spread,
        visited=visited,
        doubt=doubt,
        surplus={str(name): float(value) for name, value in stored["surplus"].items()},
        charge=None if stored.get("charge") is None else ChargeError.from_card(stored["charge"]),
        rmse_usual=None if stored.get("rmse_usual") is None else float(stored["rmse_usual"]),
    )


def _constants(stored: Mapping[str, float]) -> Constants:
    return Constants(*(float(stored[name]) for name in Constants._fields))


def _nowhere() -> tuple[BoolArray, BoolArray]:
    nowhere = Visited.of([])
    return nowhere.cells, nowhere.coolants


def _rounded(value: float, digits: int) -> float:
    return float(f"{float(value):.{digits}g}")


def _array(values: Sequence[float], n: int) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise ValueError(f"{array.shape} numbers, wanted {n} finite ones")
    return array


def _bits(values: BoolArray) -> str:
    return "".join("1" if value else "0" for value in values)


def _bools(bits: str) -> BoolArray:
    return np.array([bit == "1" for bit in bits], dtype=bool)


@cache
def _sizes() -> Mapping[str, float]:
    """Return the RMS on the probe of every column that this code can make."""
    made = columns(_probe(), Constants())
    return {name: float(np.sqrt(np.mean(values**2))) for name, values in made.items()}


def _probe() -> ChainDrive:
    """Return a drive made of formulas that has every signal and moves every column."""
    t_s = np.arange(PROBE_SAMPLES) * PROBE_PERIOD_S
    rpm = 2000.0 + 1200.0 * np.sin(t_s / 7.0)
    load = 0.5 + 0.4 * np.sin(t_s / 2.3)
    air = 90.0 + 550.0 * load
    phi = 1.0 + 0.05 * np.sin(2.1 * t_s) + 0.03 * np.sin(0.9 * t_s)
    signals = {
        "air_mass_mg": air,
        "fuel_mass_mg": np.where(np.sin(t_s / 6.0) > 0.95, 0.0, air / STOICHIOMETRIC * phi),
        "engine_speed_rpm": rpm,
        "maf_kg_h": air * rpm * 1.2e-4,
        "rail_pressure_mpa": 6.0 + 8.0 * load,
        "manifold_pressure_kpa": 25.0 + 110.0 * load,
        "manifold_temperature_degc": 30.0 + 15.0 * np.sin(t_s / 30.0),
        "coolant_temperature_degc": np.minimum(-5.0 + 0.9 * t_s, 92.0),
        "ambient_pressure_kpa": 97.0 + np.sin(t_s / 40.0),
        "purge_duty_percent": np.where(np.sin(t_s / 5.0) > 0.0, 50.0, 0.0),
        "lambda_controller": 1.0 + 0.02 * np.sin(1.3 * t_s),
    }
    return make("probe", PROBE_PERIOD_S, signals, 1.0 / phi)
