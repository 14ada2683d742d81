"""Five rules of the literature for a catalyst, as one index each; larger is a worse catalyst.

- Switches: how often the rear sensor crosses its middle, over how often the front mixture does
  (Clemmens, Sabourin and Rao, SAE 900062).
- Amplitude: standard deviation of the rear voltage, without slow changes, over that of a switching
  sensor in the front mixture (Koupal, Sabourin and Clemmens, SAE 910561).
- Locus: length of the rear signal's path over that of the front signal's.
- Delay: from the begin of a fuel cut until the rear voltage falls, as oxygen in g; its inverse.
- Threshold: path of the rear voltage over the path behind a simulated catalyst at the threshold.

Only warm samples count, outside fuel cut and its refill but for the delay. A rule's limit is the
middle between 0.06 g and 0.25 g, in logarithms, on vehicles that no matrix drives.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from benchmarks.studies.behind.drive import PERIOD_S, drive
from benchmarks.studies.behind.plan import CYCLES, LEARNING, CatalystTrial
from monitor.base import config
from monitor.base.types import BoolArray, FloatArray
from monitor.judge.catalyst.bank import OXYGEN_IN_AIR, CatalystBank

TITLES: Final = {
    "switches": "switching frequency, rear over front",
    "amplitude": "amplitude, rear over front",
    "locus": "length of the locus",
    "delay": "delay in fuel cuts, as oxygen",
    "threshold": "path behind a threshold catalyst",
}
LEARNING_G: Final = (0.06, 0.25)
SMALLEST: Final = 1e-3  # added to an index, so that it has a logarithm
MID_V, HYSTERESIS_V = 0.45, 0.08
WARM_DEGC = 420.0
AFTER_CUT_S, SLOW_S = 12.0, 10.0
WIDTH_PHI = 0.003


class Signals:
    """What the rules look at, each (n,)."""

    def __init__(self, names: tuple[str, ...], values: FloatArray, period_s: float) -> None:
        column: Callable[[str], FloatArray] = lambda name: values[:, names.index(name)]  # noqa: E731
        self.period_s = period_s
        self.volts = column("downstream_voltage_v")
        self.x = 1.0 - 1.0 / np.maximum(column("lambda_measured"), 0.1)
        self.air_g_s = column("maf_kg_h") / 3.6
        warm = column("catalyst_temperature_degc") > WARM_DEGC
        self.cut = column("fuel_cut") > 0.5
        self.warm: BoolArray = (
            warm & np.isfinite(self.volts) & np.isfinite(self.x) & np.isfinite(self.air_g_s)
        )
        n_after = round(AFTER_CUT_S / period_s)
        near_cut = np.convolve(self.cut, np.ones(n_after + 1), "full")[: len(self.cut)] > 0.5
        self.calm: BoolArray = self.warm & ~near_cut & (np.abs(self.x) < 0.15)
        self.front = 1.0 / (1.0 + np.exp(np.clip(self.x / WIDTH_PHI, -40.0, 40.0)))


def crossings(signal: FloatArray, middle: float, hysteresis: float) -> int:
    """Return how often a signal changes its side."""
    high, low = signal > middle + hysteresis, signal < middle - hysteresis
    side = np.where(high, 1, np.where(low, -1, 0))
    side = side[side != 0]
    return int(np.count_nonzero(np.diff(side)))


def without_slow(signal: FloatArray, period_s: float) -> FloatArray:
    """Return a signal without its moving mean."""
    n = max(round(SLOW_S / period_s), 1)
    kernel = np.ones(n)
    count = np.convolve(np.ones(len(signal)), kernel, "same")
    return signal - np.convolve(signal, kernel, "same") / count


def path(signal: FloatArray, where: BoolArray) -> float:
    """Return the length of a signal's path between samples that both count."""
    both = where[1:] & where[:-1]
    return float(np.abs(np.diff(signal))[both].sum())


def oxygen_until_lean(s: Signals) -> float:
    """Return the median oxygen in g that fuel cuts let in until the rear voltage falls."""
    found = []
    for begin in np.flatnonzero(~s.cut[:-1] & s.cut[1:]) + 1:
        held, k = 0.0, int(begin)
        if not s.warm[k] or s.volts[k] < MID_V + HYSTERESIS_V:
            continue
        while k < len(s.cut) and s.cut[k] and s.volts[k] > MID_V:
            held += OXYGEN_IN_AIR * s.air_g_s[k] * max(s.x[k], 0.0) * s.period_s
            k += 1
        if k < len(s.cut) and s.volts[k] <= MID_V:
            found.append(held)
    return float(np.median(found)) if found else np.nan


def behind_threshold(s: Signals) -> FloatArray:
    """Return the voltage of a sound sensor behind a catalyst at the threshold, (n,)."""
    own = config.shipped().catalyst
    single = replace(
        own,
        capacities_g=(own.threshold_g,),
        offsets_phi=(0.0,),
        sensor_sound_lags_s=own.sensor_sound_lags_s[:1],
    )
    bank = CatalystBank(single, s.period_s)
    x, air = np.nan_to_num(s.x), np.nan_to_num(s.air_g_s)
    return np.array([bank.step(*pair).item(0) for pair in zip(x, air, strict=True)])


def indices(names: tuple[str, ...], values: FloatArray, period_s: float) -> Mapping[str, float]:
    """Return each rule's index of one drive, nan where it has nothing to look at."""
    s = Signals(names, values, period_s)
    if s.calm.sum() < round(60.0 / period_s):
        return dict.fromkeys(TITLES, np.nan)
    volts, front = s.volts[s.calm], s.front[s.calm]
    rear, ahead = without_slow(volts, period_s), without_slow(front, period_s)
    span_v = config.shipped().catalyst.voltage_span_v
    front_path = path(s.front, s.calm) * span_v
    return {
        "switches": crossings(volts, MID_V, HYSTERESIS_V) / max(crossings(front, 0.5, 0.1), 1),
        "amplitude": float(rear.std() / max(span_v * ahead.std(), 1e-6)),
        "locus": path(s.volts, s.calm) / max(front_path, 1e-6),
        "delay": 1.0 / max(oxygen_until_lean(s), 1e-3),
        "threshold": path(s.volts, s.calm) / max(path(behind_threshold(s), s.calm), 1e-6),
    }


def limits(seconds: float, vehicles: Sequence[int] = LEARNING) -> dict[str, float | None]:
    """Return each rule's limit from drives of ``seconds``, None where they show it nothing."""
    found: dict[float, list[Mapping[str, float]]] = {grams: [] for grams in LEARNING_G}
    for vehicle in vehicles:
        for grams, rows in found.items():
            cycle = CYCLES[vehicle % len(CYCLES)]
            trial = CatalystTrial(0, "rules", vehicle, cycle, grams=grams, ethanol=5.0)
            names, values, _ = drive(trial, seconds)
            rows.append(indices(names, values, PERIOD_S))
    middle: dict[str, float | None] = {}
    for rule in TITLES:
        bad, sound = ([r[rule] for r in found[g] if np.isfinite(r[rule])] for g in LEARNING_G)
        if not bad or not sound:
            middle[rule] = None
            continue
        logs = [np.median(np.log(np.array(each) + SMALLEST)) for each in (bad, sound)]
        middle[rule] = float(np.exp(0.5 * (logs[0] + logs[1])) - SMALLEST)
    return middle
