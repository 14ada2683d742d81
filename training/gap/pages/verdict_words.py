"""Sentences of the gap report: the verdict with its figures, the next steps, the warnings."""

from training.gap.name.decision import AMBIGUOUS_MOST
from training.gap.name.posterior import NONE, likely
from training.gap.name.verdict import Candidate
from training.gap.pages.cells import phi
from training.gap.response.difference import COMMAND
from training.gap.result import Result
from training.greybox.effects.empirical import formula
from training.pages.numbers import percent, words


def verdict_sentence(result: Result) -> str:
    """Return the verdict in one sentence with the figures, and whether it is about simulation."""
    sentence = {
        "named": _named,
        "no_gap": _no_gap,
        "ambiguous": _ambiguous,
        "unknown_effect": _unknown,
        "sensor_fault_suspected": _sensor,
    }[result.verdict](result) + _beside(result)
    if not any(result.inputs.simulated):
        return sentence
    every = all(result.inputs.simulated)
    which = "All of it is about" if every else "Some of the recordings are"
    return f"{sentence} {which} simulated{' recordings' if every else ''}."


def _named(result: Result) -> str:
    names = _and([c.says for c in result.effects])
    if not (then := _with_it(result)):
        return f"Named: {names}, but not added; {_level(result)}."
    return f"Named: {names}. {then}"


def _with_it(result: Result) -> str:
    """Return what the new model does to the error, "" if there is none."""
    before, after, floor, on = result.rmse
    if after is None:
        return ""
    why, offer = result.addition.withdrawn, result.addition.offer
    return (
        f"With it in the model the error on {on} {_falls(result)}, from {phi(before)} to "
        f"{phi(after)} RMS in phi; the noise floor is {phi(floor)}{_gone(result)}."
        f"{'' if offer is None else f' {offer} is an offer only: {why}.'}"
    )


def _falls(result: Result) -> str:
    before, after, _, _ = result.rmse
    if after is None or after >= before:
        return "does not fall"
    return "falls" if _is_better(result) else "does not fall beyond confidence"


def _is_better(result: Result) -> bool:
    """Return whether the fall of the error is beyond confidence, if that was looked at."""
    return result.verified is None or result.verified.overall.better


def _gone(result: Result) -> str:
    """Return how much of the gap is gone, measured from healthy recordings where there are some."""
    verified = result.verified
    if verified is None:
        return ""
    share, what = verified.closed_beyond_healthy, "the error on healthy recordings"
    if share is None:
        share, what = verified.closed, "it"
    if share is None:
        return ""
    return f", and {'all' if share >= 1.0 else percent(share)} of what exceeds {what} is gone"


def _no_gap(result: Result) -> str:
    found = "no candidate explains more than healthy drives differ by, evenly and as it can act"
    if not result.tried:
        found = "it is not beyond what healthy recordings differ by; no effect could be tried"
    return f"No gap: {_level(result)}, and {found}."


def _ambiguous(result: Result) -> str:
    names = _and([c.says for c in result.effects], "or")
    return f"Ambiguous: {names} explain the gap about equally well; {_level(result)}."


def _unknown(result: Result) -> str:
    if result.effects and result.effects[0].is_reversed:
        return _reversed(result, result.effects[0])
    found = "no candidate of the library explains enough of it"
    if not result.tried:
        found = "it differs from healthy recordings; no effect could be tried"
    return f"Unknown effect: {_level(result)}, and {found}.{_formula(result)}{_suspects(result)}"


def _reversed(result: Result, effect: Candidate) -> str:
    """Return the effect that acts in the direction that it cannot have, and what to look at."""
    said = f"{words(effect.name).capitalize()}, but in the other direction"
    then = _with_it(result) or f"It is not added to the model; {_level(result)}."
    return f"{said}: look at {effect.look_at}. {then}"


def _suspects(result: Result) -> str:
    """Return the sensor fault that explains as much as any formula, if there is one."""
    suspected = result.naming.answer.suspected
    if suspected is None:
        return ""
    return f" The sensor is among the suspects: {suspected} explains as much as any formula."


def _formula(result: Result) -> str:
    """Return the formula that was added, and what it does to the error."""
    if not result.addition.effects:
        return ""
    terms = [formula(e.name, list(e.parameters.values())) for e in result.addition.effects]
    return f" As an empirical effect: {_and(terms)}. {_with_it(result)}"


def _sensor(result: Result) -> str:
    why, like = result.naming.answer.suspected, result.naming.answer.indistinguishable
    names = _and([c.says for c in like], "or")
    return (
        f"Sensor fault suspected: {why}; {_level(result)}. Nothing was added to the model."
        f"{f' On these recordings it cannot be told from {names}.' if like else ''}"
    )


def _beside(result: Result) -> str:
    """Return what may be there beside the named effect or the suspected fault."""
    between = "or" if result.verdict == "named" else "and"
    names = _and([c.says for c in result.naming.answer.beside], between)
    return f" Beside it there may be {names}." if names else ""


def _level(result: Result) -> str:
    before, _, floor, on = result.rmse
    healthy = result.verified.healthy if result.verified else None
    beside = f" ({phi(healthy.before)} on healthy ones)" if healthy else ""
    size = f"{phi(before)} RMS in {result.inputs.unit}{beside}"
    return f"the error on {on} is {size}, the noise floor {phi(floor)}"


def actions(result: Result) -> list[str]:
    """Return the next steps, the most important first."""
    found = {
        "named": _take_over,
        "no_gap": lambda _: ["Keep the model."],
        "ambiguous": _drive,
        "unknown_effect": _describe,
        "sensor_fault_suspected": _check_sensor,
    }[result.verdict](result)
    if result.naming.answer.experiment is not None and result.verdict != "ambiguous":
        found += _drive(result)
    return [*found, *_skipped(result)]


def _take_over(result: Result) -> list[str]:
    new_model, offer = result.addition.path, result.addition.offer
    if offer is not None:
        return [f"Keep the model, or use {offer} knowing this: {result.addition.withdrawn}."]
    if new_model is None:
        return ["Keep the model: no new one was written, and the warnings say why."]
    verified = result.verified
    if not _is_better(result):
        return [
            f"Keep the model: that {new_model} is better on other recordings is not shown.",
            "Record drives in which the effect is stronger, and run again with them.",
        ]
    at_risk = verified is None or verified.worse or any(f.lost for f in verified.faults)
    verb = "Look at the warnings before using" if at_risk else "Use"
    return [
        f"{verb} {new_model}: the monitor runs it unchanged.",
        "Its card says on what each decision limit was set; o2train calibrate sets them on more "
        "recordings of vehicles with healthy sensors, which is better.",
    ]


def _drive(result: Result) -> list[str]:
    experiment = result.naming.answer.experiment
    if experiment is None:
        return ["Record more varied driving and run again."]
    return [f"To tell them apart record {experiment}. Then run again with these, too."]


def _describe(result: Result) -> list[str]:
    found = [f"Look at {c.look_at}." for c in result.effects if c.is_reversed]
    if result.naming.answer.suspected:
        found += _check_sensor(result)
    if result.difference is not None:
        best = result.difference.best
        if best is not None and best.kind == COMMAND:
            found.append(
                "Fit the model anew with lambda_target among its inputs (o2train fit --inputs), "
                "or to recordings with the present target."
            )
        return found or ["Look at the answers under What: the surest come first."]
    if result.addition.effects:
        found += _take_over(result)
        if any(c.kind == "empirical" for c in result.effects):
            found.append("Do not use its formula beyond these speeds, loads and temperatures.")
    return [*found, "Look at the errors by regime under How much for what the library lacks."]


def _check_sensor(result: Result) -> list[str]:
    like = _and([c.name for c in result.naming.answer.indistinguishable], "or")
    return [
        "Check the sensor, its wiring and its supply, or record again with a sensor known good.",
        "If the sensor is known to be good, run again with --sensor-known-good"
        + (f": then {like} may be named." if like else "."),
    ]


def _skipped(result: Result) -> list[str]:
    if not result.naming.trials.skipped:
        return []
    if not result.tried:
        return ["Record fuel and air per stroke, or what tells them, to have effects named."]
    names = ", ".join(result.naming.trials.skipped)
    return [f"Not looked at for want of signals: {names}. Record them if one of these is likely."]


def cautions(result: Result) -> list[str]:
    """Return all warnings: of naming and adding, worse regimes, lost faults, fault-like effects."""
    found = list(result.all_warnings)
    found += [
        f"{c.name} is what a fault may look like, too."
        for c in result.effects
        if c.tag == "fault-like" and not result.inputs.sensor_known_good
    ]
    verified = result.verified
    if verified is None:
        return found
    if verified.healthy is not None and verified.healthy.worse:
        found.append(
            f"On the healthy recordings the error rises from {phi(verified.healthy.before)} to "
            f"{phi(verified.healthy.after)}: the new model is one of the vehicle as it is now."
        )
    found += [
        f"{f.fault} {f.severity:g} was found in {f.before.found} of {f.before.drives} drives with "
        f"the old model, in {f.after.found} with the new one."
        for f in verified.faults
        if f.lost and f.after
    ]
    for alarms, which in (
        (verified.alarms, "held-out drives without any fault"),
        (verified.healthy_alarms, "healthy recordings, which are of the vehicle as it was"),
    ):
        if alarms is not None and alarms.after is not None and alarms.after.found:
            found.append(
                f"With the new model the monitor raises codes in {alarms.after.found} of "
                f"{alarms.after.drives} {which} (with the old one in {alarms.before.found})."
            )
    return found


def _and(parts: list[str], word: str = "and") -> str:
    """Return a list in words."""
    *others, last = parts or [""]
    return f"{', '.join(others)} {word} {last}" if others else last


def confidence(result: Result) -> str:
    """Return the likeliest hypotheses with their probabilities: as few as hold 95 %, at most 3."""
    odds = result.naming.posterior
    names = likely(odds)[:AMBIGUOUS_MOST]
    told = [f"{percent(odds[n])} for {words('no_gap' if n == NONE else n)}" for n in names]
    if told:
        return f"of all hypotheses, {_and(told)}."
    if result.verdict == "no_gap":
        return "the error is what chance and healthy driving explain; no effect could be tried."
    return "no effect could be tried; the parts below say how far each answer is beyond chance."
