"""An effect of the library with its values, as a part of a model and its card."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from monitor.base.counts import plain
from monitor.base.errors import ModelError
from monitor.base.types import FloatArray
from monitor.model.card import TrainingRecording
from training.greybox.chain import Path
from training.greybox.effects import LIBRARY, Effect
from training.greybox.effects.empirical import effect_of, is_empirical
from training.greybox.quantity.value import Quantity

FUEL: Final = "fuel_mass_mg"  # every effect reads it
AS_EXPECTED: Final = 0.8  # of the expected spread: a larger standard error tells nothing new


@dataclass(frozen=True, slots=True)
class ModelEffect:
    """One effect of a model; raises ModelError if the library has none of its parameters."""

    name: str
    parameters: Mapping[str, float]
    standard_errors: Mapping[str, float]
    reads: tuple[str, ...] | None = field(default=None, compare=False)  # beside fuel; None: all

    def __post_init__(self) -> None:
        wanted = [p.name for p in _entry(self.name).parameters]
        if sorted(self.parameters) != sorted(wanted):
            raise ModelError(
                f"effect {self.name} has parameters {', '.join(self.parameters) or 'none'}, "
                f"wanted {', '.join(wanted)}"
            )

    @classmethod
    def with_values(
        cls, name: str, values: Sequence[float], standard_errors: Sequence[float] | None = None
    ) -> "ModelEffect":
        """Return an effect from its values in the library's order, with errors of 0 by default.

        >>> ModelEffect.with_values("mix_flow", [1.5]).parameters
        {'volume': 1.5}
        """
        names = [p.name for p in _entry(name).parameters]
        both = values, standard_errors or [0.0] * len(names)
        own, errors = (dict(zip(names, map(float, each), strict=True)) for each in both)
        return cls(name, own, errors)

    @property
    def effect(self) -> Effect:
        """The library's entry."""
        return _entry(self.name)

    @property
    def values(self) -> FloatArray:
        """Return the parameters (k,) in the library's order."""
        return np.array([self.parameters[p.name] for p in self.effect.parameters])

    @property
    def in_words(self) -> str:
        """Return name and parameters with their units.

        >>> ModelEffect.with_values("mix_flow", [1.5]).in_words
        'mix_flow: volume 1.5 l'
        """
        of = zip(self.effect.parameters, self.values, strict=True)
        sizes = (f"{p.name} {plain(value, 3)} {p.unit}".removesuffix(" -") for p, value in of)
        return f"{self.name}: {', '.join(sizes)}"

    def to_card(self, recordings: Sequence[TrainingRecording]) -> dict[str, Any]:
        """Return the entry for a card, with the recordings of its fit and the library's words."""
        effect = self.effect
        return asdict(self) | {
            "reads": list(self.reads or ()),
            "recordings": [asdict(recording) for recording in recordings],
            "says": effect.says,
            "tag": effect.tag,
            "like": list(effect.like),
            "units": {p.name: p.unit for p in effect.parameters},
        }

    @classmethod
    def from_card(cls, given: Mapping[str, Any]) -> "ModelEffect":
        """Return the effect of a card's entry; raises ModelError if a field is missing."""
        try:
            kept = {name: given[name] for name in ("name", "parameters", "standard_errors")}
            return cls(**kept, reads=tuple(given["reads"]))
        except (KeyError, TypeError) as error:
            raise ModelError(f"an added effect of the card lacks {error}") from None


def _entry(name: str) -> Effect:
    """Return the effect of a name, of the library or empirical; raises ModelError."""
    if is_empirical(name):
        return effect_of(name)
    if name not in LIBRARY:
        raise ModelError(f"effect {name!r} is not in the library: {', '.join(LIBRARY)}")
    return LIBRARY[name]


Effects = tuple[ModelEffect, ...]


def along(path: Path, effects: Effects, signals: Mapping[str, Quantity], period_s: float) -> Path:
    """Return the path with the effects applied one after the other, by the signals they read."""
    for each in effects:
        seen = signals if each.reads is None else {n: signals[n] for n in (FUEL, *each.reads)}
        path = each.effect.apply(path, each.values, seen, period_s)
    return path


def uncertain(added: Sequence[ModelEffect]) -> list[str]:
    """Return warnings about parameters that the recordings determine poorly or not at all.

    The standard error is then 0 (nothing moved), above the value, or hardly below its spread.
    """
    warnings = []
    for each in added:
        name = each.effect.says if is_empirical(each.name) else each.name
        for p, value in zip(each.effect.parameters, each.values, strict=True):
            error, spread = each.standard_errors[p.name], p.spread
            most = abs(value) if spread is None else AS_EXPECTED * spread
            says = f"{name}: {p.name} is {plain(value, 2)} {p.unit}".removesuffix(" -")
            more = "record driving in which the effect is stronger"
            if error == 0.0 or (spread is not None and error > most):
                warnings.append(f"{says}, which the recordings of the fit do not determine: {more}")
            elif error > most:
                warnings.append(
                    f"{says} with a standard error of {plain(error, 2)}, larger than it: {more}"
                )
    return warnings
