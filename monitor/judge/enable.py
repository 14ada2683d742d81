"""Enable conditions: named booleans that say whether a sample may be judged, and if not, why.

A condition whose signal the recording does not provide is unavailable: listed, never blocking.
A provided signal that is not valid blocks.

``step`` takes one sample, ``block`` a whole recording; a property test holds the two together.
"""

import math
from collections import deque
from collections.abc import Sequence
from operator import itemgetter
from typing import Final

import numpy as np

from monitor.base.config import EnableConfig
from monitor.base.runs import since
from monitor.base.types import BoolArray, FloatArray, Sample
from monitor.model.card import ModelCard

SIGNALS: Final = (
    "closed_loop",
    "fuel_cut",
    "sensor_ready",
    "coolant_temperature_degc",
    "engine_speed_rpm",
    "manifold_pressure_kpa",
    "vehicle_speed_km_h",
    "purge_duty_percent",
)
NO_CUT: Final = 1e-3  # mean of a flag over a tick; a single frame of a cut is more
CONDITIONS: Final = (
    "inputs_valid",
    "measured_valid",
    "model_settled",
    "trained_range",
    "closed_loop",
    "fuel_cut_recovered",
    "sensor_ready",
    "coolant_warm",
    "engine_speed",
    "engine_load",
    "vehicle_speed",
    "purge_steady",
)
_NEEDS: Final = {
    "closed_loop": "closed_loop",
    "fuel_cut_recovered": "fuel_cut",
    "sensor_ready": "sensor_ready",
    "coolant_warm": "coolant_temperature_degc",
    "engine_speed": "engine_speed_rpm",
    "engine_load": "manifold_pressure_kpa",
    "vehicle_speed": "vehicle_speed_km_h",
    "purge_steady": "purge_duty_percent",
}


class Enable:
    """Checks every condition on each sample; recovery times count samples.

    names : what a sample holds
    inputs, output : names of the model's signals among them
    trained_low, trained_high : (n_inputs,) range of each input in training
    """

    def __init__(
        self,
        config: EnableConfig,
        names: Sequence[str],
        inputs: Sequence[str],
        output: str,
        trained_low: FloatArray,
        trained_high: FloatArray,
        period_s: float,
    ) -> None:
        self._config = config
        at = {name: i for i, name in enumerate(names)}
        # what an unavailable signal reads is put behind the sample's values
        self._harmless = [
            1.0,
            0.0,
            1.0,
            config.coolant_min_degc,
            config.engine_speed_min_rpm,
            config.manifold_pressure_min_kpa,
            config.vehicle_speed_min_km_h,
            0.0,
        ]
        n = len(at)
        self._places = [at.get(name, n + i) for i, name in enumerate(SIGNALS)]
        self._read = itemgetter(*self._places)
        self.unavailable = tuple(c for c in CONDITIONS if c in _NEEDS and _NEEDS[c] not in at)
        self._output = at[output]
        margin = config.range_margin * (trained_high - trained_low)
        ignored = np.isin(inputs, config.range_ignored)
        low = np.where(ignored, -np.inf, trained_low - margin).tolist()
        high = np.where(ignored, np.inf, trained_high + margin).tolist()
        self._ranges = tuple(zip((at[name] for name in inputs), low, high, strict=True))
        self._settle = config.model_settle_samples
        self._recovery = round(config.fuel_cut_recovery_s / period_s)
        self._range_recovery = round(config.range_recovery_s / period_s)
        self._purge_recovery = round(config.purge_recovery_s / period_s)
        self._second = max(round(1.0 / period_s), 1)  # samples
        self._since_start = self._since_cut = self._since_range = self._since_purge = 0
        self._duties = deque[float](maxlen=self._second)  # of the purge valve, oldest first
        self._open = False
        self.reset()

    @classmethod
    def of(cls, config: EnableConfig, names: Sequence[str], card: ModelCard) -> "Enable":
        """Return the conditions for a model on samples of ``names``."""
        low = np.array([channel.minimum for channel in card.inputs])
        high = np.array([channel.maximum for channel in card.inputs])
        period_s = card.period_ns * 1e-9
        return cls(config, names, card.input_names, card.output.name, low, high, period_s)

    def reset(self) -> None:
        """Start as after switching on."""
        self._since_start = 0
        self._since_cut = self._recovery
        self._since_range = self._range_recovery
        self._since_purge = self._purge_recovery
        self._duties.clear()

    def step(self, sample: Sample) -> tuple[bool, ...]:
        """Return the conditions in the order of CONDITIONS; the sample is enabled if all hold."""
        config = self._config
        values = sample.values.tolist() + self._harmless
        closed_loop, cut, ready, coolant_degc, speed_rpm, load_kpa, speed_km_h, purge = self._read(
            values
        )
        inputs_valid = inside = True
        for i, low, high in self._ranges:
            if not low <= values[i] <= high:
                inside = False
                inputs_valid = inputs_valid and not math.isnan(values[i])
        self._since_start = self._since_start + 1 if inputs_valid else 0
        self._since_range = self._since_range + 1 if inside else 0
        self._since_cut = self._since_cut + 1 if cut < NO_CUT else 0
        self._since_purge = 0 if self._purge_steps(purge) else self._since_purge + 1
        return (
            inputs_valid,
            not math.isnan(values[self._output]),
            self._since_start > self._settle,
            self._since_range >= self._range_recovery,
            closed_loop >= 1.0,
            self._since_cut >= self._recovery,
            ready >= 1.0,
            coolant_degc >= config.coolant_min_degc,
            config.engine_speed_min_rpm <= speed_rpm <= config.engine_speed_max_rpm,
            config.manifold_pressure_min_kpa <= load_kpa <= config.manifold_pressure_max_kpa,
            speed_km_h >= config.vehicle_speed_min_km_h,
            self._since_purge >= self._purge_recovery,
        )

    def _purge_steps(self, duty: float) -> bool:
        """Return whether the purge valve opens, closes or moves fast, or is not known."""
        was_open, self._open = self._open, duty >= self._config.purge_open_percent
        duties = self._duties
        if not duties:
            duties.extend([duty] * self._second)
            was_open = self._open
        before = duties[0]
        duties.append(duty)
        return (
            was_open is not self._open
            or not -self._config.purge_step_percent
            <= duty - before
            <= self._config.purge_step_percent
        )

    def block(self, values: FloatArray) -> BoolArray:
        """Return the conditions of a recording from switching on, (n, n_conditions).

        values : (n, n_names); each row is what ``step`` returns for it
        """
        config, n = self._config, len(values)
        padded = np.hstack([values, np.broadcast_to(self._harmless, (n, len(self._harmless)))])
        closed_loop, cut, ready, coolant_degc, speed_rpm, load_kpa, speed_km_h, purge = padded.T[
            self._places
        ]
        inside, inputs_valid = np.ones(n, dtype=np.bool_), np.ones(n, dtype=np.bool_)
        for i, low, high in self._ranges:
            inside &= (low <= values[:, i]) & (values[:, i] <= high)
            inputs_valid &= ~np.isnan(values[:, i])
        moved = self._purge_moves(purge)
        held = (
            inputs_valid,
            ~np.isnan(values[:, self._output]),
            since(~inputs_valid, 0) > self._settle,
            since(~inside, self._range_recovery) >= self._range_recovery,
            closed_loop >= 1.0,
            since(~(cut < NO_CUT), self._recovery) >= self._recovery,
            ready >= 1.0,
            coolant_degc >= config.coolant_min_degc,
            (config.engine_speed_min_rpm <= speed_rpm) & (speed_rpm <= config.engine_speed_max_rpm),
            (config.manifold_pressure_min_kpa <= load_kpa)
            & (load_kpa <= config.manifold_pressure_max_kpa),
            speed_km_h >= config.vehicle_speed_min_km_h,
            since(moved, self._purge_recovery) >= self._purge_recovery,
        )
        return np.stack(held, axis=1)

    def _purge_moves(self, duty: FloatArray) -> BoolArray:
        """Return ``_purge_steps`` of a recording, (n,)."""
        before = duty[np.maximum(np.arange(len(duty)) - self._second, 0)]
        moved = ~(np.abs(duty - before) <= self._config.purge_step_percent)
        is_open = duty >= self._config.purge_open_percent
        moved[1:] |= is_open[1:] != is_open[:-1]
        return moved
