"""Enable conditions: named booleans that say whether a sample may be judged, and if not, why.

A condition whose signal the recording does not provide is unavailable: listed, never blocking.
A provided signal that is not valid blocks.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.config import EnableConfig
from monitor.base.runs import since
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray
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
NEEDS: Final = {  # condition → its signal
    "closed_loop": "closed_loop",
    "fuel_cut_recovered": "fuel_cut",
    "sensor_ready": "sensor_ready",
    "coolant_warm": "coolant_temperature_degc",
    "engine_speed": "engine_speed_rpm",
    "engine_load": "manifold_pressure_kpa",
    "vehicle_speed": "vehicle_speed_km_h",
    "purge_steady": "purge_duty_percent",
}
# what a fuel cut breaks of itself: without fuel the loop is open and the engine is driven
_CUT_BREAKS: Final = ("closed_loop", "fuel_cut_recovered", "engine_load", "purge_steady")
# conditions that a time of recovery follows: they hold so many samples after they were last broken
_RECOVERING: Final = ("model_settled", "trained_range", "fuel_cut_recovered", "purge_steady")
# columns of what a sample says, as ``Enable.push`` puts them together: those of _RECOVERING after
# their recovery, then the others, at last those that follow from a range
_STEADY, _HOLDS, _VALID, _TRAINED, _OUTPUT = range(len(_RECOVERING), len(_RECOVERING) + 5)

_MASKS = np.arange(1 << len(CONDITIONS))


def _where_all(names: Iterable[str]) -> BoolArray:
    """Return for each mask of conditions whether all of ``names`` hold."""
    bits = sum(1 << CONDITIONS.index(name) for name in names)
    return np.asarray(_MASKS & bits == bits)


# by the mask of a sample's conditions
ENABLED: Final = _where_all(CONDITIONS)
INPUTS_VALID: Final = _where_all(["inputs_valid"])
# a live sensor must move while these hold and the engine runs, whatever the model's state
BURNING: Final = _where_all(["measured_valid", "fuel_cut_recovered", "sensor_ready"])
# the prediction is the mixture's while these hold, in idle, too
FOLLOWED: Final = _where_all(CONDITIONS[: CONDITIONS.index("coolant_warm")])
# nothing but a fuel cut, or the recovery from it, disables the sample, if anything does
AROUND_FUEL_CUT: Final = _where_all(set(CONDITIONS) - set(_CUT_BREAKS))
IN_FUEL_CUT: Final = AROUND_FUEL_CUT & ~_where_all(["fuel_cut_recovered"])


def masks(conditions: BoolArray) -> NDArray[np.uint16]:
    """Return the conditions of each sample as one number, (n,), the first as its lowest bit.

    conditions : (n, n_conditions)
    """
    packed = np.packbits(conditions, axis=1, bitorder="little")
    return packed.view("<u2")[:, 0]


class Range(NamedTuple):
    """The values of a signal with which a condition holds."""

    condition: str
    signal: str
    low: float
    high: float


def settings_for(config: EnableConfig, card: ModelCard) -> EnableConfig:
    """Return the settings for a model: one with a memory longer than a window settles as long."""
    remembered = card.memory_samples if card.memory_samples > card.window_samples else 0
    settle = max(config.model_settle_samples, remembered)
    return replace(config, model_settle_samples=settle)


class Enable:
    """Checks every condition on each sample; recovery times count samples.

    names : signals of a sample
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
        at = {name: i for i, name in enumerate(names)}
        self.unavailable = tuple(c for c in CONDITIONS if c in NEEDS and NEEDS[c] not in at)
        ranges = {
            "closed_loop": (1.0, math.inf),
            "fuel_cut_recovered": (-math.inf, math.nextafter(NO_CUT, 0.0)),
            "sensor_ready": (1.0, math.inf),
            "coolant_warm": (config.coolant_min_degc, math.inf),
            "engine_speed": (config.engine_speed_min_rpm, config.engine_speed_max_rpm),
            "engine_load": (config.manifold_pressure_min_kpa, config.manifold_pressure_max_kpa),
            "vehicle_speed": (config.vehicle_speed_min_km_h, math.inf),
        }
        checked = [name for name in ranges if name not in self.unavailable]
        margin = config.range_margin * (trained_high - trained_low)
        ignored = np.isin(inputs, config.range_ignored)
        # columns that are checked against a range: the model's inputs, which may have any valid
        # value, the same in the range of the training, its output, the others
        n = len(inputs)
        self._places = np.array(
            [at[name] for name in (*inputs, *inputs, output, *(NEEDS[name] for name in checked))]
        )
        low, high = np.array([ranges[name] for name in checked]).reshape(-1, 2).T
        anything = np.full(n, np.inf)
        trained = np.where(ignored, np.inf, trained_high + margin)
        self._high = np.concatenate([anything, trained, [math.inf], high])
        trained = np.where(ignored, -np.inf, trained_low - margin)
        self._low = np.concatenate([-anything, trained, [-math.inf], low])
        # a column of what a sample says for all valid, all as in training, and each of the others
        self._firsts = np.array([0, n, *range(2 * n, len(self._low))])
        own = [("trained_range", name) for name in inputs]
        own += [(name, NEEDS[name]) for name in checked]
        places = [*range(n, 2 * n), *range(2 * n + 1, len(self._low))]
        self.ranges = tuple(
            Range(condition, name, float(self._low[i]), float(self._high[i]))
            for (condition, name), i in zip(own, places, strict=True)
        )
        # columns of what a sample says: of each condition, and of what breaks each of _RECOVERING
        columns = {name: _OUTPUT + i for i, name in enumerate(("measured_valid", *checked))}
        self._n_columns = _OUTPUT + 1 + len(checked)
        cut = columns.get("fuel_cut_recovered", _HOLDS)
        self._broken = np.array([_VALID, _TRAINED, cut, _STEADY])
        columns |= {"inputs_valid": _VALID} | {name: i for i, name in enumerate(_RECOVERING)}
        self._held = np.array([columns.get(name, _HOLDS) for name in CONDITIONS])
        self._measured, self._cut = at[output], at.get("fuel_cut")
        self._purge = at.get("purge_duty_percent")
        self._open_percent, self._step_percent = (
            config.purge_open_percent,
            config.purge_step_percent,
        )
        recovery_s = config.range_recovery_s, config.fuel_cut_recovery_s, config.purge_recovery_s
        self._recovery = np.array(
            [config.model_settle_samples + 1, *(round(each / period_s) for each in recovery_s)]
        )
        self._second = max(round(1.0 / period_s), 1)  # samples
        self.reset()

    @classmethod
    def of(cls, config: EnableConfig, names: Sequence[str], card: ModelCard) -> "Enable":
        """Return the conditions for a model on samples of ``names``."""
        low = np.array([channel.minimum for channel in card.inputs])
        high = np.array([channel.maximum for channel in card.inputs])
        period_s = card.period_ns * 1e-9
        return cls(
            config=settings_for(config, card),
            names=names,
            inputs=card.input_names,
            output=card.output.name,
            trained_low=low,
            trained_high=high,
            period_s=period_s,
        )

    def reset(self) -> None:
        """Start as after switching on."""
        self._since = self._recovery.copy()  # samples since each of _RECOVERING was broken
        self._since[0] = 0
        self._duties: FloatArray | None = None  # of the purge valve in the last second

    def push(self, values: FloatArray, quality: QualityArray | None = None) -> BoolArray:
        """Return the conditions of samples, (n, n_conditions) in the order of CONDITIONS.

        values : (n, n_names); a sample is enabled if all its conditions hold
        quality : (n, n_names); a reading pinned at an end of its range was left out of the
            training, except in fuel cut, where that is the right reading
        """
        n = len(values)
        if n == 0:
            return np.ones((0, len(CONDITIONS)), dtype=np.bool_)
        x = values.take(self._places, axis=1)
        inside = self._low <= x
        inside &= x <= self._high
        said = np.ones((n, self._n_columns), dtype=np.bool_)
        np.logical_and.reduceat(inside, self._firsts, axis=1, out=said[:, _VALID:])
        if quality is not None:
            pinned = quality[:, self._measured] == Quality.PINNED
            if pinned.any():
                said[:, _TRAINED] &= ~(pinned & ~self._in_cut(values))
        if self._purge is not None:
            self._purge_stays(values[:, self._purge], said[:, _STEADY])
        count = since(~said.take(self._broken, axis=1), self._since)
        self._since = count[-1]
        np.greater_equal(count, self._recovery, out=said[:, : len(_RECOVERING)])
        return said.take(self._held, axis=1)

    def _in_cut(self, values: FloatArray) -> BoolArray:
        """Return whether fuel is known to be cut, (n,)."""
        if self._cut is None:
            return np.zeros(len(values), dtype=np.bool_)
        return np.asarray(values[:, self._cut] >= NO_CUT)

    def _purge_stays(self, duty: FloatArray, stays: BoolArray) -> None:
        """Find whether the purge valve stays open or shut, moves slowly and is known, (n,)."""
        second = self._second
        if self._duties is None:  # at the first sample it has not moved
            self._duties = np.full(second, duty[0])
        duties = np.concatenate([self._duties, duty])
        self._duties = duties[-second:]
        is_open = duties[second - 1 :] >= self._open_percent
        np.less_equal(np.abs(duty - duties[:-second]), self._step_percent, stays)
        stays &= is_open[1:] == is_open[:-1]
