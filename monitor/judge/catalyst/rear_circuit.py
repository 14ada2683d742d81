"""Circuit and heater of the downstream sensor, from its voltage and the duty of its heater.

- Low: shorted to ground, the voltage stays below what a switching sensor shows in gas that is not
  lean.
- High: shorted to the supply, or with an offset, it is above what any switching sensor shows, and
  shows no lean gas between.
- Inactive: an open circuit rests at the ECU's own voltage. A live sensor behind any catalyst turns
  lean once more oxygen has entered than the catalyst can store.
- Heater: the ECU heats at full duty and the sensor wakes late, or the duty that was regulated
  before is full for long.

An unheated sensor rests as an open circuit does, so one that may be cold is not called open.
"""

import math
from collections.abc import Iterator
from typing import Final

from monitor.base.config import Config
from monitor.judge.catalyst.bank import MID_V, OXYGEN_IN_AIR
from monitor.judge.window import Opinion

CIRCUIT: Final = "downstream_circuit"
HEATER: Final = "downstream_heater"
LOW, HIGH, INACTIVE = "downstream_low", "downstream_high", "downstream_inactive"


class RearCircuit:
    """Judges circuit and heater sample by sample."""

    def __init__(self, settings: Config, period_s: float) -> None:
        self._config, self._heater = settings.catalyst, settings.plausibility
        self._period_s = period_s
        self._lean_phi = max(self._config.offsets_phi)  # leaner than any offset of the reading
        # for how long, in s, something has held; "low" and "high" last until the circuit passes, so
        # a loose contact adds up, and "high" until a lean reading, too
        self._for_s = dict.fromkeys(("low", "high", "rest", "lively", "full", "regulated"), 0.0)
        self._lean_g = self._most_lean_g = 0.0  # oxygen of one lean stretch, while at rest
        self._has_rested = self._was_regulated = self._heater_heard = False
        self._is_mute = True  # the latest voltage tells nothing of the gas by itself
        # running time until the sensor first left its rest, 0 if it did not begin there
        self.wake_s: float | None = None
        self._said: dict[str, str] = {}

    @property
    def can_judge_heater(self) -> bool:
        """Return whether the heater can be told: its duty, and a cold start or a regulated duty.

        A sensor that was hot from the start, with its heater always at full duty, tells nothing.
        """
        return self._heater_heard and (self._has_rested or self._was_regulated)

    def push(
        self, *, volts: float, x: float, air_g_s: float, running: int, duty_percent: float
    ) -> list[tuple[str, Opinion]]:
        """Take the next sample; return the tests that it decides, each with the finding.

        volts, x (1 - 1/lambda upstream), air_g_s, duty_percent : nan where unknown
        running : samples so far with the engine running, this one included; 0 while it stands
        """
        if math.isnan(volts) or not running:
            return []
        run_s = running * self._period_s
        self._voltage(volts, x, air_g_s, run_s)
        self._heating(duty_percent, run_s)
        found = []
        for test, fault in self._decided(run_s):
            if self._said.get(test) != fault:
                self._said[test] = fault  # a heater that failed tells of the circuit
                found.append((test, Opinion("failed" if fault else "passed", fault or None)))
        return found

    def _hold(self, what: str, goes_on: bool, counts: bool = True) -> None:
        """Let something hold for this sample, too, if it counts, or end."""
        step_s = self._period_s * counts
        self._for_s[what] = self._for_s[what] + step_s if goes_on else 0.0

    def _voltage(self, v: float, x: float, air_g_s: float, run_s: float) -> None:
        config, step_s = self._config, self._period_s
        is_lean, is_hot = x > self._lean_phi, run_s > config.circuit_after_s
        apart = abs(v - MID_V)
        is_low, is_high = v < config.circuit_low_v, v > config.circuit_high_v
        is_awake, rests = apart > config.awake_v, apart < config.rest_band_v
        self._hold("lively", not (is_low or is_high), is_awake)
        lasts = self._for_s["lively"] < config.circuit_pass_s  # through a loose contact
        self._hold("high", lasts or v >= config.lean_v, is_high)
        self._hold("low", lasts, is_low and is_hot and not is_lean)
        self._is_mute = rests or is_low or is_high
        self._hold("rest", rests, is_hot)
        more_g = OXYGEN_IN_AIR * air_g_s * x * step_s
        self._lean_g = self._lean_g + more_g if rests and is_lean else 0.0
        self._most_lean_g = max(self._most_lean_g, self._lean_g) if rests else 0.0
        if self.wake_s is None:
            self.wake_s = run_s * self._has_rested if is_awake else None
            self._has_rested |= not is_awake

    def _heating(self, duty: float, run_s: float) -> None:
        config, is_full = self._config, duty >= self._heater.heater_full_percent
        self._heater_heard |= not math.isnan(duty)
        self._hold("full", is_full)
        self._hold("regulated", not is_full and duty > 0.0 and run_s > config.wake_most_s)
        self._was_regulated |= self._for_s["regulated"] >= config.circuit_pass_s

    def _decided(self, run_s: float) -> Iterator[tuple[str, str]]:
        config, held, is_awake = self._config, self._for_s, self.wake_s is not None
        is_late = (run_s if self.wake_s is None else self.wake_s) > config.wake_most_s
        is_slow_start = is_late and held["full"] >= config.heater_start_s
        is_never_hot = self._was_regulated and held["full"] >= self._heater.heater_full_s
        if is_slow_start or is_never_hot:
            yield HEATER, HEATER
        elif self.can_judge_heater and is_awake and (self._was_regulated or not is_late):
            yield HEATER, ""
        may_be_cold = held["full"] > 0.0 and (self._was_regulated or not is_awake)
        is_unmoved = self._most_lean_g >= 2.0 * config.capacities_g[-1]
        if held["high"] >= config.circuit_s:
            yield CIRCUIT, HIGH
        elif held["low"] >= config.circuit_s:
            yield CIRCUIT, LOW
        elif is_unmoved and held["rest"] >= config.circuit_s and not may_be_cold:
            yield CIRCUIT, INACTIVE
        elif held["lively"] >= config.circuit_pass_s:
            yield CIRCUIT, ""

    @property
    def is_doubtful(self) -> bool:
        """Return whether the latest voltage may be no reading of the gas."""
        config, held = self._config, self._for_s
        if self._is_mute and self._said.get(CIRCUIT) != "":
            return True  # nothing has shown yet that the circuit is sound
        longest = max(held["low"], held["high"], held["rest"] - config.circuit_s)
        return longest > 0.5 * config.circuit_pass_s
