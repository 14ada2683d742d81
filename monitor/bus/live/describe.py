"""Enable conditions in words, with the present values of their signals."""

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import asdict
from functools import cache
from typing import Any, Final

from monitor.base import signals
from monitor.base.config import Config, EnableConfig
from monitor.base.counts import plain
from monitor.base.types import Quality, Sample
from monitor.judge.enable import TABLE, EnableCondition, settings_for
from monitor.judge.limits import Limits
from monitor.model.card import ModelCard
from monitor.pipeline.events import Tick
from monitor.pipeline.monitor import SensorMonitor

_UNITS: Final = {"degC": "°C", "1/min": "rpm", "-": "", "mg/stroke": "mg"}
_UNIT_OF_NAME: Final = re.compile("_(mg|kg_h|mpa|kpa|degc|km_h|rpm|nm|percent|v|g)$")
_QUALITY: Final = {
    Quality.STALE: "not received",
    Quality.INVALID: "sent as invalid",
    Quality.OUT_OF_RANGE: "out of range",
    Quality.OFF_BUS: "monitor is off the bus",
    Quality.PINNED: "at the end of its range",
    Quality.GAP: "not received since the log paused",
}


@cache
def words(name: str) -> str:
    """Return a canonical name in words.

    >>> words("rail_pressure_mpa")
    'rail pressure'
    """
    return _UNIT_OF_NAME.sub("", name).replace("_", " ")


def value_text(name: str, value: float) -> str:
    """Return a value with its unit."""
    signal = signals.BY_NAME.get(name)
    if signal and signal.role == "enable":
        return plain(value, 3)
    own = signals.unit_of(name)
    unit = _UNITS.get(own, own)
    digits = 3 if "lambda" in name else 0 if abs(value) >= 100.0 else 1 if abs(value) >= 10.0 else 2
    return f"{value:.{digits}f} {unit}".strip().replace("-", "−")


class ConditionWords:
    """The enable conditions of one monitor: the need of each, and its present value."""

    def __init__(self, monitor: SensorMonitor, config: EnableConfig, card: ModelCard) -> None:
        self._output = monitor.output
        self._at = {name: i for i, name in enumerate(monitor.names)}
        self._unavailable = monitor.enable.unavailable
        self._config = settings_for(config, card)
        self._trained = {
            signal: bounds
            for name, signal, *bounds in monitor.enable.ranges
            if name == "trained_range" and math.isfinite(bounds[0])
        }
        self._inputs = card.input_names

    def wanted(self) -> list[dict[str, Any]]:
        """Return name, words and need of every condition, in the order of CONDITIONS."""
        settings = asdict(self._config)
        return [
            {
                "name": each.name,
                "what": each.words,
                "need": each.need.format(**settings),
                "available": each.name not in self._unavailable,
            }
            for each in TABLE
        ]

    def seen(self, tick: Tick) -> list[str]:
        """Return the present value of every condition in words, in the order of CONDITIONS."""
        return [
            "no such signal"
            if each.name in self._unavailable
            else self._seen(each, tick, held=held)
            for each, held in zip(TABLE, tick.conditions, strict=True)
        ]

    def _seen(self, condition: EnableCondition, tick: Tick, *, held: bool) -> str:
        sample, signal = tick.sample, condition.signal
        if condition.states:
            return condition.states[not held]
        if condition.flag:
            return self._flag(signal, *condition.flag, sample, held=held)
        if condition.name == "measured_valid":
            signal = self._output
        if signal:
            return self._reading(signal, sample, bare=True)
        if condition.name == "inputs_valid":
            bad = [self._reading(n, sample) for n in self._inputs if self._is_bad(n, sample)]
            return ", ".join(bad) or "all valid"
        missing = any(self._is_bad(n, sample) for n in self._inputs)
        word = "within" if held else "inputs missing" if missing else "just came back"
        return ", ".join(self._outside(sample)) or word

    def _outside(self, sample: Sample) -> list[str]:
        parts = []
        for name, (low, high) in self._trained.items():
            value = sample.values.item(self._at[name])
            if value > high or value < low:
                side = f"above {_number(high)}" if value > high else f"below {_number(low)}"
                parts.append(f"{self._reading(name, sample)}, {side}")
        return parts

    def _flag(self, signal: str, on: str, off: str, sample: Sample, *, held: bool) -> str:
        value = sample.values.item(self._at[signal])
        if math.isnan(value):
            return self._reading(signal, sample, bare=True)
        if signal == "fuel_cut" and value <= 0.0 and not held:
            return "just ended"
        return on if value >= 1.0 else off if value <= 0.0 else "changing"

    def _is_bad(self, name: str, sample: Sample) -> bool:
        return sample.quality.item(self._at[name]) != Quality.GOOD

    def _reading(self, name: str, sample: Sample, *, bare: bool = False) -> str:
        """Return a signal's value in words, or the reason why it has none."""
        i = self._at[name]
        value, quality = sample.values.item(i), sample.quality.item(i)
        text = value_text(name, value) if quality == Quality.GOOD else _QUALITY[Quality(quality)]
        return text if bare else f"{words(name)} {text}"


def signal_rows(
    names: Sequence[str], sample: Sample, absent: Collection[str] = ()
) -> list[list[str]]:
    """Return name, value and quality in words for every signal of a sample.

    absent : signals that not every vehicle sends and this one never sent
    """
    rows = []
    for name, value, quality in zip(names, sample.values, sample.quality.tolist(), strict=True):
        good = quality == Quality.GOOD
        shown = value_text(name, float(value)) if good else "–"
        if name not in absent:
            rows.append([words(name), shown, "" if good else _QUALITY[Quality(quality)]])
    return rows


def response_limits(config: Config, limits: Limits) -> dict[str, float]:
    """Return the limits of the response and bias rules and of the paper's rule."""
    response = config.response
    return {
        "lag_s": response.lag_limit_s,
        "dead_time_s": response.delay_limit_s,
        "gain_sound": response.gain_sound_min * limits.gain_expected,
        "gain_most": response.gain_max * limits.gain_expected,
        "offset_low": limits.offset_low,
        "offset_high": limits.offset_high,
        "j_mu": limits.j_mu,
        "j_sigma": limits.j_sigma,
    }


def _number(value: float) -> str:
    return plain(value).replace("-", "−")
