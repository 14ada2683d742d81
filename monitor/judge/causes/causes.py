"""Why a recording was not judged: which condition held it up, by which signal, and a remedy."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Final

from monitor.base.config import Config
from monitor.base.counts import counted, duration, plain
from monitor.base.signals import BY_NAME, unit_of
from monitor.base.types import Quality
from monitor.judge import enable
from monitor.judge.causes.observation import DEAD, Observation, dead_at_end
from monitor.judge.electrical.plausibility import ENGINE
from monitor.judge.enable import CONDITIONS
from monitor.judge.limits import Limits
from monitor.judge.trust import UNKNOWN
from monitor.model.card import ModelCard

MOST: Final = 3  # conditions that are named
ENOUGH_WINDOWS: Final = 6  # from so many on, more of them alone do not help
PINNED: Final = (
    "the sensor's reading stands at an end of its range in {}: cold, broken, or in a fuel cut that "
    "the log does not tell; log fuel_cut or the pulse width"
)
CONTROLLER: Final = "lambda_controller"
HELD_ENOUGH: Final = 0.9  # a condition that held for this share kept no drive from its verdict


@dataclass(frozen=True, slots=True)
class Cause:
    """One reason why a recording was not judged."""

    condition: str  # enable condition, name of a test, "evidence", "sensor_alive" or "samples"
    held_share: float | None  # of the samples; None where no share applies
    signal: str | None  # canonical name
    reason: str
    advice: str

    @property
    def in_words(self) -> str:
        """Return the cause on one line."""
        is_known, share = self.condition in enable.BY_NAME, self.held_share
        held = f" for {100 * share:.0f} % of the time" if is_known and share is not None else ""
        lead = f"{enable.statement(self.condition)}{held}: "
        return lead * (not is_known or bool(held)) + self.advice


@dataclass(frozen=True, slots=True)
class SignalSource:
    """Where a recording's signal comes from."""

    place: str  # message and signal, or column
    timeout_s: float | None = None


@dataclass(frozen=True, slots=True)
class Judgement:
    """The state of the tests at the end of the recording."""

    windows: int = 0
    excited: int = 0  # windows in which the prediction moves clearly
    unfinished: tuple[str, ...] = ()  # tests without a decision
    left_s: float | None = None  # enabled driving that the response test still needs
    judges_cuts: bool = False  # the edges of fuel cuts are evidence, too
    is_foreign: bool = False  # the model does not describe the reading


@dataclass(frozen=True, slots=True)
class Asked:
    """Whose causes are asked for."""

    card: ModelCard
    config: Config
    sources: Mapping[str, SignalSource] = field(default_factory=dict)  # by canonical name
    limits: Limits | None = None  # with which the recording was judged


def causes(seen: Observation, asked: Asked, judgement: Judgement | None = None) -> list[Cause]:
    """Return why a recording gives no verdict, the plainest cause first; none if nothing is wrong.

    judgement : of the tests; without it only signals and conditions are looked at
    """
    settles = enable.settings_for(asked.config.enable, asked.card).model_settle_samples
    needed = settles + asked.config.window.n_samples
    if seen.samples < needed:
        length_s, least_s = seen.samples * seen.period_s, needed * seen.period_s
        advice = f"the recording is {length_s:.1f} s long, at least {least_s:g} s are wanted"
        return [Cause("samples", None, None, "short", advice)]
    top = seen.high[seen.names.index(ENGINE)].item() if ENGINE in seen.names else math.inf
    if 0.0 <= top < asked.config.plausibility.engine_running_rpm:  # -inf: it is not known
        most = f"{ENGINE} is at most {plain(top)} 1/min{_place(ENGINE, asked)}"
        return [Cause("engine_speed", None, ENGINE, "off", f"the engine never runs: {most}")]
    # without an enabled sample fuel cuts alone may have told of the response
    unfinished = ("response",) if judgement is None else judgement.unfinished
    undecided = "response" in unfinished or (bool(unfinished) and not seen.enabled)
    found = _blocked(seen, asked) if undecided else []
    found += list(_still_inputs(seen, asked, found if undecided else None))
    grave = [each for each in found if _is_grave(each)]
    if judgement is None:
        return grave[:MOST]
    if judgement.judges_cuts:  # fuel cuts are evidence, so few are no remedy
        found = [each for each in found if each.condition != "fuel_cut_recovered"]
    found = (grave or found)[:MOST]
    if judgement.unfinished and (not found or judgement.windows >= ENOUGH_WINDOWS):
        evidence = _evidence(seen, asked, judgement)
        found = [*grave, *evidence] if grave else [*evidence, *found]
    if (reason := dead_at_end(seen, asked.card, asked.config)) is not None:
        name = asked.card.output.name
        advice = f"{name} {DEAD[reason]} when the recording ended: check the sensor, record further"
        found.append(Cause("sensor_alive", None, name, reason, advice))
    return found


def _is_grave(cause: Cause) -> bool:
    """Return whether a cause may keep a recording from its verdict: half the samples, or a defect.

    Good signals of an ordinary drive keep a quarter of its samples from being judged.
    """
    is_of_driving = cause.reason in ("below", "above", "interrupted", "untrained", "pinned")
    return not is_of_driving or cause.held_share is None or cause.held_share < 0.5


def _blocked(seen: Observation, asked: Asked) -> list[Cause]:
    """Return the causes of the conditions that held least."""
    shares = {c: seen.share(c) for c in CONDITIONS if c not in seen.unavailable}
    if shares["inputs_valid"] < HELD_ENOUGH:
        del shares["model_settled"], shares["trained_range"]  # they follow from the inputs
    named = dict[tuple[str | None, str], Cause]()  # by signal and reason, the plainest first
    for condition, share in sorted(shares.items(), key=itemgetter(1)):
        if share < HELD_ENOUGH:
            cause = _of_condition(condition, share, seen, asked)
            named.setdefault((cause.signal, cause.reason), cause)
    return [*named.values()]


def _of_condition(condition: str, share: float, seen: Observation, asked: Asked) -> Cause:
    """Return the cause of one condition: of its signals, the one that is worst."""
    output = asked.card.output.name
    worst = min(asked.card.input_names, key=lambda name: seen.of(name, Quality.GOOD))
    signal = output if condition == "measured_valid" else enable.BY_NAME[condition].signal or worst
    told = None
    if condition == "trained_range":
        beside = {name: sum(each) for name, (*each, _) in seen.outside(condition).items()}
        most, pinned = max(beside.values()), seen.of(output, Quality.PINNED)
        if pinned > most:
            signal, told = output, ("pinned", PINNED.format(_share(pinned, seen)))
        elif most:  # else it is NaN, which is outside, too
            signal = max(beside, key=lambda name: beside[name])
    reason, advice = told or _of_signal(condition, signal, seen, asked)
    return Cause(condition, round(share, 6), signal, reason, advice)


def _of_signal(condition: str, signal: str, seen: Observation, asked: Asked) -> tuple[str, str]:
    """Return reason and advice for the signal of a condition that did not hold."""
    below, above, limits = seen.outside(condition).get(signal, (0, 0, None))
    beside, remedy = below + above, enable.BY_NAME[condition].remedy
    bad = _bad(signal, seen, asked)
    if bad is not None and seen.samples - seen.of(signal, Quality.GOOD) >= beside:
        return bad
    if seen.is_constant(signal) and beside:
        return "constant", _constant(signal, seen, asked)
    if limits is None or not beside:
        return "interrupted", remedy or f"{signal} is interrupted again and again"
    side, limit = ("below", limits.low) if below >= above else ("above", limits.high)
    said = f"{signal} is {side} {plain(limit)}{_unit(signal)} in {_share(beside, seen)}"
    if condition == "trained_range":
        remedy = "outside the model's training; check its unit, or train on such drives"
        return "untrained", f"{said}: {remedy}"
    return side, f"{said}: {remedy}"


def _bad(signal: str, seen: Observation, asked: Asked) -> tuple[str, str] | None:
    """Return reason and advice for a signal whose values are not usable, None if all are."""
    stale = seen.of(signal, Quality.STALE) + seen.of(signal, Quality.OFF_BUS)
    source = asked.sources.get(signal, SignalSource("its source"))
    if stale == seen.samples:
        text = f"{signal} never came ({source.place}): correct the map, or leave the signal out"
        return "never_seen", text
    gaps = seen.of(signal, Quality.GAP) - seen.quality[Quality.GAP].min().item()  # its own
    invalid, wild = seen.of(signal, Quality.INVALID) + gaps, seen.of(signal, Quality.OUT_OF_RANGE)
    most = max(stale, invalid, wild)
    share = _share(most, seen)
    if not most:
        return None
    if most == stale:
        return "stale", f"{signal} is stale in {share}: {_stale(signal, stale, source, seen)}"
    if most == invalid:
        return "invalid", f"{signal} has no value in {share} ({source.place}): check sensor and map"
    limits = BY_NAME.get(signal)
    within = f", {limits.minimum:g} to {limits.maximum:g} {limits.unit} is" if limits else ""
    remedy = f"check unit, factor and offset ({source.place})"
    return "out_of_range", f"{signal} is not plausible in {share}{within}: {remedy}"


def _share(count: int, seen: Observation) -> str:
    return f"{100 * count / seen.samples:.0f} % of the samples"


def _stale(signal: str, stale: int, source: SignalSource, seen: Observation) -> str:
    """Return how seldom the values come, or since when they came no longer."""
    n = max(int(seen.stale_runs[seen.names.index(signal)]), 1)
    held_s = source.timeout_s or 0.0
    age_s = held_s + stale / n * seen.period_s
    if n == 1 or source.timeout_s is None:
        return f"no value for {plain(age_s)} s ({source.place})"
    said = f"its values come about {plain(age_s, 2)} s apart, timeout_s is {held_s:g} s"
    return f"{said} ({source.place}); set timeout_s = {timeout_of(age_s):g} in the map"


def timeout_of(interval_s: float) -> float:
    """Return how old a value may be that comes at such an interval: three of them, at least 0.3 s.

    >>> timeout_of(0.1), timeout_of(1.0)
    (0.3, 3.0)
    """
    return float(f"{max(3.0 * interval_s, 0.3):.2g}")


def _constant(signal: str, seen: Observation, asked: Asked) -> str:
    value = f"{plain(seen.low[seen.names.index(signal)].item(), 6)}{_unit(signal)}"
    return (
        f"{signal} is {value} throughout{_place(signal, asked)}: if it did change, this is "
        "another quantity or was not recorded; name the right one, or leave it out"
    )


def _still_inputs(
    seen: Observation, asked: Asked, found: Sequence[Cause] | None
) -> Iterator[Cause]:
    """Yield the causes of inputs that never move, which no condition shows.

    A controller that never moves stands in a loop that was never closed, whatever a flag says.
    found : causes of the conditions; None asks for the loop alone
    """
    still = [n for n in asked.card.input_names if n in seen.names and seen.is_constant(n)]
    if CONTROLLER in still:
        advice = f"the loop was never closed: {_constant(CONTROLLER, seen, asked)}"
        yield Cause("closed_loop", 0.0, CONTROLLER, "constant", advice)
    named = {CONTROLLER, *(each.signal for each in found or ())}
    for signal in still if found is not None else ():
        if signal not in named:
            yield Cause("inputs_valid", None, signal, "constant", _constant(signal, seen, asked))


def _evidence(seen: Observation, asked: Asked, judgement: Judgement) -> list[Cause]:
    """Return why tests have no decision though most samples could be judged."""
    trust = asked.limits.trust if asked.limits else UNKNOWN
    if judgement.is_foreign:
        advice = "the model does not describe this reading: another vehicle's, or far too late?"
        return [Cause("response", None, None, "model", advice)]
    if blind := [test for test in judgement.unfinished if trust.is_blind(test)]:
        said = f"tried on {counted(trust.drives, 'drive')}, the model finds none of its faults"
        advice = f"{said}: train on more drives, unlike each other"
        return [Cause(blind[0], None, None, "model", advice)]
    n, excited = judgement.windows, judgement.excited
    had = f"{duration(seen.enabled * seen.period_s)} could be judged"
    if "response" in judgement.unfinished and n:
        moved = f"in {excited} of {n} windows the prediction moves clearly"
        left_s, window_s = judgement.left_s, asked.config.window.n_samples * seen.period_s
        more = "more" if left_s is None else f"about {duration(max(left_s, window_s))} more"
        quicker = "changing load or fuel cuts" if judgement.judges_cuts else "changing load"
        advice = f"{had}, {moved}: drive {more} like this; with {quicker} less is enough"
        reason = "not_excited" if excited < n / 2 else "undecided"
        return [Cause("evidence", round(excited / n, 6), None, reason, advice)]
    tests = ", ".join(judgement.unfinished)
    advice = f"{had}, without a decision of {tests}: record a longer drive"
    return [Cause(judgement.unfinished[0], None, None, "undecided", advice)]


def _place(signal: str, asked: Asked) -> str:
    return f" ({asked.sources[signal].place})" if signal in asked.sources else ""


def _unit(signal: str) -> str:
    unit = unit_of(signal)
    return "" if unit in ("", "-") else f" {unit}"
