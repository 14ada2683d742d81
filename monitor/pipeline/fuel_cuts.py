"""Fuel cuts among the samples of a recording's parts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from monitor.base.config import Config
from monitor.base.types import BoolArray
from monitor.judge.enable import AROUND_FUEL_CUT, NO_CUT, masks
from monitor.judge.fuel_cut import air_pressure
from monitor.judge.fuel_cut.cuts import Cut, FuelCuts, Stretch
from monitor.judge.residual import oriented
from monitor.model.card import ModelCard
from monitor.pipeline.segments import Part


class CutWatch:
    """Watches for fuel cuts, and costs a live sample little while there is none.

    names : signals of a sample, the fuel cut among them
    """

    def __init__(self, config: Config, card: ModelCard, names: Sequence[str]) -> None:
        settings, most_s = config.fuel_cut, config.plausibility.fuel_cut_most_s
        least = settings.step_residual * card.residual_std
        self._cuts = FuelCuts(settings, card.period_ns * 1e-9, least, most_s)
        self._flag, self._transform = names.index("fuel_cut"), card.transform
        self._pressure = names.index(air_pressure.SIGNAL) if air_pressure.SIGNAL in names else None
        self._before: Part | None = None  # its last sample may come before a cut

    def over(self, part: Part) -> list[tuple[int, Cut]]:
        """Return the cuts that are over, each with the number of the sample after it.

        part : behind the model
        """
        is_cut = part.block.values[:, self._flag] >= NO_CUT
        if self._cuts.is_idle and not is_cut.any():
            self._before = part
            return []
        if self._before is not None:
            self._cuts.push(*self._samples(self._before, len(self._before.measured) - 1))
            self._before = None
        found = self._cuts.push(*self._samples(part, 0))
        if self._pressure is None:
            return found
        kpa = part.block.values[:, self._pressure]
        return [(k, replace(cut, pressure_kpa=kpa.item(k))) for k, cut in found]

    def _samples(self, part: Part, begin: int) -> tuple[Stretch, BoolArray]:
        """Return samples from the number ``begin`` on, and which of them may show a cut."""
        inside = slice(begin, None)
        flag = part.block.values[inside, self._flag]
        measured = oriented(part.measured[inside], self._transform)
        predicted = oriented(part.predicted[inside], self._transform)
        usable = AROUND_FUEL_CUT[masks(part.conditions[inside])]
        usable &= np.isfinite(measured) & np.isfinite(predicted) & np.isfinite(flag)
        return Stretch(part.block.t_ns[inside], measured, predicted, flag >= NO_CUT), usable
