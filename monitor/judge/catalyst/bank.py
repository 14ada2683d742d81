"""A bank of catalysts with downstream sensors, and the voltage of each.

Every member is one store of oxygen with a breakthrough that grows with its filling, an offset of
the upstream reading, and a switching sensor behind it. The members run side by side from upstream
lambda and air flow. One tick costs a few array operations, whatever the number of members.

Equations, with x = 1 - 1/lambda + offset (positive is lean), filling f from 0 to 1 and capacity C:
oxygen 0.23 · air · x · period enters; the part f^p (lean) or (1 - f)^p (rich) passes, the rest is
stored as far as there is room. Source of the storage equation: Brandt, Wang and Grizzle, IEEE
Trans. Control Systems Technology 8 (2000), with one store instead of their rate maps.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.config import CatalystConfig
from monitor.base.types import FloatArray

OXYGEN_IN_AIR: Final = 0.23  # mass fraction
LEAK: Final = "leak"  # between catalyst and sensor; no fault of the sensor
STUCK: Final = ("downstream_stuck_lean", "downstream_stuck_rich")
WEAK: Final = "downstream_weak"
MID_V: Final = 0.45  # of a switching sensor, between rich and lean


@dataclass(frozen=True, slots=True)
class RearSensor:
    """A downstream sensor: lags and dead times per direction, and its gain."""

    fault: str  # "" is a sound sensor
    tau_to_rich_s: float
    tau_to_lean_s: float
    delay_s: float = 0.0
    direction: int = 0  # of the dead time: 1 to rich, -1 to lean, 0 both
    gain: float = 1.0
    leak_phi: float = 0.0  # air drawn in before the sensor, at no flow; it makes the gas leaner


def bank_sensors(config: CatalystConfig) -> tuple[RearSensor, ...]:
    """Return the sensors of the bank, sound ones first."""
    late, lags = config.sensor_late_s, config.sensor_sound_lags_s
    sound = lags[0]
    found = [RearSensor("", to_rich, to_lean) for to_rich in lags for to_lean in lags]
    for tau in config.sensor_slow_lags_s:
        found += [
            RearSensor("downstream_slow_symmetric", tau, tau),
            RearSensor("downstream_slow_rich_to_lean", sound, tau),
            RearSensor("downstream_slow_lean_to_rich", tau, sound),
        ]
    found += [
        RearSensor("downstream_delay_symmetric", sound, sound, late),
        RearSensor("downstream_delay_rich_to_lean", sound, sound, late, -1),
        RearSensor("downstream_delay_lean_to_rich", sound, sound, late, 1),
    ]
    found += [RearSensor(WEAK, sound, sound, gain=g) for g in config.sensor_weak_gains]
    found += [RearSensor(name, sound, sound) for name in STUCK]
    found += [RearSensor(LEAK, sound, sound, leak_phi=leak) for leak in config.leaks_phi]
    return tuple(found)


class CatalystBank:
    """Runs all members; the state goes on from block to block.

    sensors, capacity_g, (n_capacities, 1), and offset, (n_offsets,), the addend of the upstream x,
    are the axes of the members, and ``shape`` their numbers.
    wide : the sensors are of wide range. Their lags act on x, and what they read is turned into
        the voltage of a switching sensor as the measured lambda is.
    """

    def __init__(self, config: CatalystConfig, period_s: float, *, wide: bool = False) -> None:
        self._config, self._period_s, self._wide = config, period_s, wide
        self.sensors = sensors = bank_sensors(config)
        self.capacity_g: FloatArray = np.array(config.capacities_g)[:, np.newaxis]
        self.offset: FloatArray = np.array(config.offsets_phi)
        self.shape = len(sensors), len(self.capacity_g), len(self.offset)
        to_rich, to_lean, gain, leak = (
            np.array([getattr(s, name) for s in sensors])[:, np.newaxis, np.newaxis]
            for name in ("tau_to_rich_s", "tau_to_lean_s", "gain", "leak_phi")
        )
        rising = 1.0 - np.exp(-period_s / to_rich)
        self._falling = 1.0 - np.exp(-period_s / to_lean)
        self._more_rising = rising - self._falling
        self._gain = config.voltage_span_v * gain
        self._low_v = MID_V + (config.voltage_low_v - MID_V) * gain
        self._ticks = max(round(config.sensor_late_s / period_s), 1)
        shares = np.array(config.zone_shares) / sum(config.zone_shares)
        self._zones_g = shares[:, np.newaxis, np.newaxis] * self.capacity_g
        self._late = [(i, s.direction) for i, s in enumerate(sensors) if s.delay_s > 0.0]
        self._leaks = np.flatnonzero(leak)
        self._leak_phi = leak[self._leaks]
        self.reset()

    def reset(self) -> None:
        """Begin with every catalyst half full."""
        shape = self.shape
        self._filling = np.full((len(self._zones_g), *shape[1:]), 0.5)
        self._reading = np.full(shape, 0.5)
        self._step, self._rise, self._v = (np.empty(shape) for _ in range(3))
        self._past = np.full((self._ticks, *shape[1:]), 0.5)  # a ring of the sensors' steady states
        self._at = 0

    def step(self, x: float, air_g_s: float) -> FloatArray:
        """Return the voltages of all members on a tick, (n_sensors, n_capacities, n_offsets).

        The array holds until the next tick; the caller may write into it.

        x : 1 - 1/lambda upstream
        """
        grams = OXYGEN_IN_AIR * self._period_s * air_g_s
        x_behind = self._behind(x, grams)
        steady = self._steady(x_behind)
        step, rise, volts, reading = self._step, self._rise, self._v, self._reading
        step[:] = steady
        full = OXYGEN_IN_AIR * self._period_s * self._config.leak_flow_g_s
        share = 1.0 / (1.0 + (grams / full) ** 2)
        step[self._leaks] = self._steady(x_behind + self._leak_phi * share)
        if self._late:
            late = self._past[self._at]
            for i, direction in self._late:
                one_sided = {1: np.minimum, -1: np.maximum}.get(direction)
                step[i] = one_sided(steady, late) if one_sided else late
            self._past[self._at] = steady
            self._at = (self._at + 1) % self._ticks
        step -= reading
        np.maximum(step, 0.0, out=rise)
        rise *= self._more_rising
        step *= self._falling
        reading += step
        reading += rise
        seen = richness(-reading, self._config) if self._wide else reading
        np.multiply(seen, self._gain, out=volts)
        volts += self._low_v
        return volts

    def _behind(self, x: float, grams: float) -> FloatArray:
        """Return x of the gas behind each catalyst as a switching sensor sees it.

        Shape (n_capacities, n_offsets).
        """
        config, own = self._config, x + self.offset
        rich = np.where(own > 0.0, 0.0, 1.0)
        free = 1.0 - np.abs(self._filling - rich)  # part of each zone, in the gas's direction
        reaching = 1.0 - (1.0 - free) ** config.breakthrough
        room = free * self._zones_g
        carried = np.empty(self.shape[1:])  # oxygen, or its want
        carried[:] = grams * np.abs(own)
        for zone, most in enumerate(room):
            stored = reaching[zone]
            stored *= carried
            np.minimum(stored, most, out=stored)
            carried -= stored
        free -= reaching / self._zones_g
        self._filling = np.abs(1.0 - free - rich)
        out = carried * (1.0 - 2.0 * rich) / max(grams, 1e-9)
        shift = config.equilibrium_phi * (2.0 * self._filling[-1] - 1.0) - config.hydrogen_phi
        return np.asarray(out + shift)

    def _steady(self, x: FloatArray) -> FloatArray:
        """Return the readings in the steady state: richness, or -x of wide-range sensors."""
        return -x if self._wide else richness(x, self._config)


def richness(x: FloatArray, config: CatalystConfig) -> FloatArray:
    """Return the reading of a sound switching sensor in the steady state, 0 to 1."""
    return np.asarray(0.5 - 0.5 * np.tanh(x / (2.0 * config.switching_phi)))


def switching_volts(x: FloatArray, config: CatalystConfig) -> FloatArray:
    """Return the voltage that a sound switching sensor shows where a wide-range one measures x."""
    seen = richness(x - config.hydrogen_phi, config)
    return np.asarray(config.voltage_low_v + config.voltage_span_v * seen)
