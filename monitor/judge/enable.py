"""Enable conditions: named booleans that say whether a sample may be judged, and if not, why.

A condition whose signal the recording does not provide is unavailable: listed, never blocking.
A provided signal that is not valid blocks. A new condition is a row of ``TABLE``.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from monitor.base.config import EnableConfig
from monitor.base.runs import since
from monitor.base.types import BoolArray, FloatArray, Quality, QualityArray
from monitor.model.card import Channel, ModelCard

NO_CUT: Final = 1e-3  # mean of a flag over a tick; a single frame of a cut is more


@dataclass(frozen=True, slots=True)
class EnableCondition:
    """One enable condition, with its words for a reader.

    low, high : values of the signal with which it holds, numbers or keys of ``[enable]``
    recovery : key of ``[enable]``: time, or samples, that the condition stays broken
    """

    name: str
    words: str  # a statement, true while it holds
    need: str = ""  # in numbers, with keys of [enable] in braces
    signal: str = ""  # canonical name; "" where the model's own signals decide
    low: float | str = -math.inf
    high: float | str = math.inf
    recovery: str = ""
    is_of_cut: bool = False  # a fuel cut breaks it: the loop is open and the engine is driven
    remedy: str = ""  # where the signal itself is good
    states: tuple[str, str] | None = None  # words while it holds and while it does not
    flag: tuple[str, str] | None = None  # words while the signal is 1 and while it is 0


TABLE: Final = (
    EnableCondition("inputs_valid", "the inputs are received and plausible"),
    EnableCondition("measured_valid", "the measured value is received and plausible"),
    EnableCondition(
        name="model_settled",
        words="the model has settled",
        need="for {model_settle_samples} samples",
        recovery="model_settle_samples",
        remedy="record drives longer than the model remembers, without pauses",
        states=("settled", "not settled yet"),
    ),
    EnableCondition(
        name="trained_range",
        words="the inputs are in the trained range",
        need="for {range_recovery_s:g} s",
        recovery="range_recovery_s",
    ),
    EnableCondition(
        name="closed_loop",
        words="the lambda control is closed",
        signal="closed_loop",
        low=1.0,
        is_of_cut=True,
        remedy="drive in closed loop, the engine warm and at part load",
        flag=("closed", "open loop"),
    ),
    EnableCondition(
        name="fuel_cut_recovered",
        words="the engine has recovered from a fuel cut",
        need="none for {fuel_cut_recovery_s:g} s",
        signal="fuel_cut",
        high=math.nextafter(NO_CUT, 0.0),
        recovery="fuel_cut_recovery_s",
        is_of_cut=True,
        remedy="drive with fewer overruns",
        flag=("fuel is cut", "fuel flows"),
    ),
    EnableCondition(
        name="sensor_ready",
        words="the sensor is ready",
        signal="sensor_ready",
        low=1.0,
        remedy="record until the sensor is heated",
        flag=("ready", "not ready"),
    ),
    EnableCondition(
        name="coolant_warm",
        words="the coolant is warm",
        need="at least {coolant_min_degc:g} °C",
        signal="coolant_temperature_degc",
        low="coolant_min_degc",
        remedy="record until the engine is warm",
    ),
    EnableCondition(
        name="engine_speed",
        words="the engine speed is in its range",
        need="{engine_speed_min_rpm:g} to {engine_speed_max_rpm:g} rpm",
        signal="engine_speed_rpm",
        low="engine_speed_min_rpm",
        high="engine_speed_max_rpm",
        remedy="drive, idle and high speed are not judged",
    ),
    EnableCondition(
        name="engine_load",
        words="the engine load is in its range",
        need="{manifold_pressure_min_kpa:g} to {manifold_pressure_max_kpa:g} kPa",
        signal="manifold_pressure_kpa",
        low="manifold_pressure_min_kpa",
        high="manifold_pressure_max_kpa",
        is_of_cut=True,
        remedy="drive at part load",
    ),
    EnableCondition(
        name="vehicle_speed",
        words="the vehicle is fast enough",
        need="at least {vehicle_speed_min_km_h:g} km/h",
        signal="vehicle_speed_km_h",
        low="vehicle_speed_min_km_h",
        remedy="drive, standstill is not judged",
    ),
    EnableCondition(
        name="purge_steady",
        words="the purge valve is steady",
        need="for {purge_recovery_s:g} s",
        signal="purge_duty_percent",
        recovery="purge_recovery_s",
        is_of_cut=True,
        remedy="record longer: the purge valve moves, its steps are not judged",
        states=("steady", "moving"),
    ),
)
BY_NAME: Final = {each.name: each for each in TABLE}
CONDITIONS: Final = tuple(BY_NAME)
SIGNALS: Final = tuple(each.signal for each in TABLE if each.signal)
_AT: Final = {name: i for i, name in enumerate(CONDITIONS)}
_VALID, _SETTLED, _TRAINED = _AT["inputs_valid"], _AT["model_settled"], _AT["trained_range"]
_PURGE: Final = _AT["purge_steady"]
_RECOVERING: Final = [_AT[each.name] for each in TABLE if each.recovery]


def statement(name: str) -> str:
    """Return a condition as a statement; of a test, its name without underscores."""
    return BY_NAME[name].words if name in BY_NAME else name.replace("_", " ")


def _mask(names: Iterable[str]) -> int:
    return sum(1 << _AT[name] for name in names)


ENABLED: Final = _mask(CONDITIONS)
INPUTS_VALID: Final = _mask(["inputs_valid"])
# a live sensor must move while these hold and the engine runs, whatever the model's state
BURNING: Final = _mask(["measured_valid", "fuel_cut_recovered", "sensor_ready"])
# nothing but a fuel cut, or the recovery from it, disables the sample, if anything does
AROUND_FUEL_CUT: Final = _mask(each.name for each in TABLE if not each.is_of_cut)
RECOVERED: Final = _mask(["fuel_cut_recovered"])


def masks(conditions: BoolArray) -> NDArray[np.uint16]:
    """Return the conditions of each sample as one number, (n,), the first as its lowest bit.

    conditions : (n, n_conditions)
    """
    packed = np.packbits(conditions, axis=1, bitorder="little")
    return packed.view("<u2")[:, 0]


def holds(masks: NDArray[np.uint16], wanted: int, broken: int = 0) -> BoolArray:
    """Return where all of the wanted conditions hold and none of the broken ones, (n,)."""
    return np.asarray(masks & (wanted | broken) == wanted)


class Range(NamedTuple):
    """The values of a signal with which a condition holds."""

    condition: str
    signal: str
    low: float
    high: float


def settings_for(config: EnableConfig, card: ModelCard) -> EnableConfig:
    """Return the settings for a model, which settles at least as long as it remembers."""
    settle = max(config.model_settle_samples, card.memory_samples)
    return replace(config, model_settle_samples=settle)


class Enable:
    """Checks every condition on each sample; recovery times count samples.

    names : signals of a sample
    inputs : of the model; output : name of the measured signal
    """

    def __init__(
        self,
        config: EnableConfig,
        names: Sequence[str],
        inputs: Sequence[Channel],
        output: str,
        period_s: float,
    ) -> None:
        at, self._config = {name: i for i, name in enumerate(names)}, config
        self.unavailable = tuple(c.name for c in TABLE if c.signal and c.signal not in at)
        self.ranges = (
            *(_trained(config, channel) for channel in inputs),
            *(
                Range(c.name, c.signal, _limit(config, c.low), _limit(config, c.high))
                for c in TABLE
                if c.signal in at and (c.low, c.high) != (-math.inf, math.inf)
            ),
        )
        checked = [Range("inputs_valid", each.name, -math.inf, math.inf) for each in inputs]
        checked += [Range("measured_valid", output, -math.inf, math.inf), *self.ranges]
        of = [each.condition for each in checked]
        self._checked = [_AT[name] for name in dict.fromkeys(of)]  # conditions
        self._first = [of.index(name) for name in dict.fromkeys(of)]  # of their ranges
        self._places = [at[each.signal] for each in checked]
        self._low, self._high = (np.array([each[i] for each in checked]) for i in (2, 3))
        self._measured, self._cut = at[output], at.get("fuel_cut")
        self._purge = at.get("purge_duty_percent")
        self._recovery = np.array(
            [_samples(config, TABLE[i].recovery, period_s) for i in _RECOVERING]
        )
        self._second = max(round(1.0 / period_s), 1)  # samples
        self._since = self._recovery.copy()  # samples since each of _RECOVERING was broken
        self._since[_RECOVERING.index(_SETTLED)] = 0
        self._duties: FloatArray | None = None  # of the purge valve in the last second

    @classmethod
    def of(cls, config: EnableConfig, names: Sequence[str], card: ModelCard) -> "Enable":
        """Return the conditions for a model on samples of ``names``."""
        own, period_s = settings_for(config, card), card.period_ns * 1e-9
        return cls(own, names, card.inputs, card.output.name, period_s)

    def push(self, values: FloatArray, quality: QualityArray | None = None) -> BoolArray:
        """Return the conditions of samples, (n, n_conditions) in the order of CONDITIONS.

        values : (n, n_names); a sample is enabled if all its conditions hold
        quality : (n, n_names); a reading pinned at an end of its range was left out of the
            training, except in fuel cut, where that is the right reading
        """
        held = np.ones((len(values), len(CONDITIONS)), dtype=np.bool_)
        if len(values) == 0:
            return held
        x = values.take(self._places, axis=1)
        inside = (self._low <= x) & (x <= self._high)
        held[:, self._checked] = np.logical_and.reduceat(inside, self._first, axis=1)
        held[:, _SETTLED] = held[:, _VALID]
        if quality is not None:
            pinned = quality[:, self._measured] == Quality.PINNED
            if pinned.any():
                if self._cut is not None:
                    pinned &= ~(values[:, self._cut] >= NO_CUT)
                held[:, _TRAINED] &= ~pinned
        if self._purge is not None:
            held[:, _PURGE] = self._purge_stays(values[:, self._purge])
        count = since(~held[:, _RECOVERING], self._since)
        self._since = count[-1]
        held[:, _RECOVERING] = count >= self._recovery
        return held

    def _purge_stays(self, duty: FloatArray) -> BoolArray:
        """Return whether the purge valve stays open or shut, moves slowly and is known, (n,)."""
        second, config = self._second, self._config
        if self._duties is None:  # at the first sample it has not moved
            self._duties = np.full(second, duty[0])
        duties = np.concatenate([self._duties, duty])
        self._duties = duties[-second:]
        is_open = duties[second - 1 :] >= config.purge_open_percent
        is_slow = np.abs(duty - duties[:-second]) <= config.purge_step_percent
        return np.asarray(is_slow & (is_open[1:] == is_open[:-1]))


def _trained(config: EnableConfig, channel: Channel) -> Range:
    """Return the range of an input in training, with its margin."""
    margin = config.range_margin * (channel.maximum - channel.minimum)
    if channel.name in config.range_ignored:
        margin = math.inf
    low, high = channel.minimum - margin, channel.maximum + margin
    return Range("trained_range", channel.name, low, high)


def _limit(config: EnableConfig, bound: float | str) -> float:
    """Return a bound of the table: a number, or the setting of that name."""
    return float(getattr(config, bound)) if isinstance(bound, str) else bound


def _samples(config: EnableConfig, recovery: str, period_s: float) -> int:
    """Return after how many samples a condition has recovered; a setting may be in samples."""
    setting = getattr(config, recovery)
    return round(setting / period_s) if recovery.endswith("_s") else int(setting) + 1
