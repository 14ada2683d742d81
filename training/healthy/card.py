"""The healthy behaviour as a part of the model card: the workflow then needs no healthy drives.

It stands under ``reference["gap"]`` and is as good as the columns that it weighs. A card of another
schema, or with columns that this code does not make, is told.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from monitor.base.signals import OWN
from monitor.base.types import BoolArray, FloatArray
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.greybox.chain import Constants
from training.greybox.charge import ChargeError
from training.greybox.effects import LIBRARY
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.drive import ChainDrive
from training.greybox.fit.ridge import Ridge
from training.healthy.behaviour import Healthy, columns
from training.healthy.operating_points import Visited
from training.jobs.json_tree import json_tree
from training.narx.export import update_card
from training.recordings.recording import Recording

KEY: Final = "gap"
SCHEMA: Final = "o2train.gap_reference/2"
DIGITS: Final = 7


def to_card(known: Healthy, recordings: Sequence[Recording]) -> dict[str, Any]:
    """Return ``known`` as JSON can hold it.

    recordings : from which it was learned
    """
    rounded = partial(json_tree, digits=DIGITS)
    return {
        "schema": SCHEMA,
        "recordings": [recording.path.name for recording in recordings],
        "base": rounded(known.base._asdict()),
        "plain": rounded(known.plain._asdict()),
        "own": {each.name: rounded(each.values) for each in known.own},
        "columns": list(known.names),
        "weight": rounded(known.ridge.weights),
        "low": rounded(known.ridge.low),
        "high": rounded(known.ridge.high),
        "penalty": known.ridge.penalty,
        "spread": rounded(known.spread),
        **({"doubt": rounded(known.doubt)} if known.doubt.size else {}),
        "visited": {
            "cells": [_bits(row) for row in known.visited.cells],
            "coolants": _bits(known.visited.coolants),
        },
        "surplus": rounded(dict(sorted(known.surplus.items()))),
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
        if strange := [name for name in stored["columns"] if name not in _made()]:
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
    if len({(each.cells.shape, each.coolants.shape) for each in (visited, Visited.of([]))}) > 1:
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
def _made() -> frozenset[str]:
    """Return the names of all columns that this code can make, of a drive with every signal."""
    one = np.ones(2)
    signals = {signal.name: one for signal in OWN}
    drive = ChainDrive(name="", period_s=1.0, signals=signals, phi_measured=one, scored=one > 0.0)
    return frozenset(columns(drive, Constants()))
