"""The moments at which something is to be counted, of whole recordings: those of ``cycles.Cycles``.

Only the samples in which the engine stands are looked at one by one. A property test holds the two
together.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from monitor.base.config import CyclesConfig, ProfileConfig
from monitor.base.runs import runs
from monitor.base.types import BoolArray, FloatArray, IntArray, Quality, SampleBlock
from monitor.memory.cycles import SIGNALS, EngineWatch, Moment

_ORDER: tuple[Moment, ...] = ("driving_cycle", "ignition_cycle", "warm_up", "general_denominator")


class BlockCycles:
    """Finds the moments of recordings; arguments as for ``Cycles``."""

    def __init__(
        self,
        config: CyclesConfig,
        profile: ProfileConfig,
        names: Sequence[str],
        output: str,
        running_rpm: float,
    ) -> None:
        at = {name: i for i, name in enumerate(names)}
        self._config, self._profile, self._running_rpm = config, profile, running_rpm
        self._places = [at.get(name, -1) for name in SIGNALS]
        self._heard = at[output] if self._places[0] < 0 else self._places[0]

    def moments(self, block: SampleBlock) -> list[tuple[int, Moment]]:
        """Return sample and moment, in the order in which ``Cycles.push`` gives them."""
        n = len(block.t_ns)
        elapsed_s = np.maximum(np.diff(block.t_ns, prepend=block.t_ns[:1]), 0) * 1e-9
        speed, vehicle, coolant, ambient, pressure = (
            block.values[:, place] if place >= 0 else np.full(n, np.nan) for place in self._places
        )
        heard = block.quality[:, self._heard]
        if self._places[0] < 0:
            running = ~np.isin(heard, (Quality.STALE, Quality.OFF_BUS))
            standing = np.zeros(n, dtype=np.bool_)
        else:
            running, standing = speed >= self._running_rpm, speed < self._running_rpm
        starts, nexts = self._starts(elapsed_s, running, standing, heard)
        driven = running.copy()
        driven[starts] = False
        judged = driven & ~self._too(3, ambient, self._config.denominator_ambient_min_degc)
        judged &= ~self._too(4, pressure, self._config.denominator_pressure_min_kpa)
        found: list[tuple[int, Moment]] = [(k, "driving_cycle") for k in nexts]
        edges = [0, *nexts, n]
        for begin, end in pairwise(edges):
            part = slice(begin, end)
            own: dict[Moment, int | None] = {
                "ignition_cycle": self._ignition(
                    elapsed_s[part], running[part], driven[part], np.array(starts) - begin
                ),
                "warm_up": self._warm_up(coolant[part], running[part]),
                "general_denominator": self._denominator(
                    elapsed_s[part], judged[part], vehicle[part]
                ),
            }
            found += [(begin + k, moment) for moment, k in own.items() if k is not None]
        return sorted(found, key=lambda each: (each[0], _ORDER.index(each[1])))

    def _too(self, place: int, values: FloatArray, least: float) -> BoolArray:
        """Return where it is too cold or too high for the general denominator, (n,)."""
        if self._places[place] < 0:
            return np.zeros(len(values), dtype=np.bool_)
        return np.asarray(~(values >= least))

    def _starts(
        self, elapsed_s: FloatArray, running: BoolArray, standing: BoolArray, heard: np.ndarray
    ) -> tuple[list[int], list[int]]:
        """Return at which samples the engine starts, and at which of them a driving cycle does."""
        engine = EngineWatch(self._config)
        starts, nexts, end = [], [], 0
        for begin, next_end in runs(running):
            gap = slice(end, begin)
            told = heard[gap] != Quality.OFF_BUS  # else nothing is known of the engine
            silent = heard[gap] == Quality.STALE
            for seconds, is_silent, is_standing in zip(
                elapsed_s[gap][told].tolist(),
                silent[told].tolist(),
                standing[gap][told].tolist(),
                strict=True,
            ):
                engine.stand(seconds, is_silent=is_silent, is_standing=is_standing)
            started, is_next = engine.run()
            starts += [begin] * started
            nexts += [begin] * is_next
            end = next_end
        return starts, nexts

    def _ignition(
        self, elapsed_s: FloatArray, running: BoolArray, driven: BoolArray, starts: IntArray
    ) -> int | None:
        """Return where an engine start counts in a driving cycle, None if nowhere."""
        seconds = np.where(driven, elapsed_s, 0.0)
        n = len(seconds)
        inside: list[int] = starts[(starts > 0) & (starts < n)].tolist()
        edges = [0, *inside, n]
        for begin, end in pairwise(edges):
            running_s = np.cumsum(seconds[begin:end])
            long = np.flatnonzero(running[begin:end] & (running_s >= self._config.start_s))
            if long.size:
                return begin + int(long[0])
        return None

    def _warm_up(self, coolant_degc: FloatArray, running: BoolArray) -> int | None:
        known = np.flatnonzero(running & ~np.isnan(coolant_degc))
        if not known.size:
            return None
        first_degc = coolant_degc[known[0]]
        warm = running & (coolant_degc >= self._profile.warm_up_degc)
        warm &= coolant_degc - first_degc >= self._profile.warm_up_rise_degc
        return int(np.argmax(warm)) if warm.any() else None

    def _denominator(
        self, elapsed_s: FloatArray, judged: BoolArray, speed_km_h: FloatArray
    ) -> int | None:
        config = self._config
        idled = self._idled(elapsed_s, judged & (speed_km_h <= config.denominator_idle_km_h))
        if idled is None:
            return None
        moving = judged & (speed_km_h >= config.denominator_moving_km_h)
        run_s = np.cumsum(np.where(judged, elapsed_s, 0.0))
        moving_s = np.cumsum(np.where(moving, elapsed_s, 0.0))
        enough = judged & (run_s >= config.denominator_run_s)
        enough &= moving_s >= config.denominator_moving_s
        enough[:idled] = False
        return int(np.argmax(enough)) if enough.any() else None

    def _idled(self, elapsed_s: FloatArray, idle: BoolArray) -> int | None:
        """Return where the engine has idled long enough for the first time, None if nowhere."""
        least_s = self._config.denominator_idle_s
        for begin, end in runs(idle):
            long = np.flatnonzero(np.cumsum(elapsed_s[begin:end]) >= least_s)
            if long.size:
                return begin + int(long[0])
        return None
