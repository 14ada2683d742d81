"""Decision limits from held-out blocks of healthy recordings, unseen by training and choice."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from pathlib import Path

import numpy as np

from monitor.base.config import Config
from monitor.base.errors import RecordingError
from monitor.base.types import FloatArray
from monitor.judge.limits import NO_LIMITS, Limits
from monitor.judge.residual import oriented
from monitor.memory.codes import TESTS
from monitor.model.card import Limit, ModelCard
from monitor.model.step import Model
from monitor.pipeline.events import CutJudged, WindowJudged
from training.limits.fuel_cuts import reference_of
from training.limits.judging import Judged, judge_recordings, most_common_cause
from training.limits.movement import movement_of
from training.limits.region import region_of
from training.limits.repeated_model import RepeatedModel
from training.narx.export import update_card
from training.narx.model_file import HeldOut
from training.recordings.recording import Recording

MINIMUM_WINDOWS = 10
MANY_WINDOWS = 100  # with fewer windows, the 0.99 quantile is the largest value
PAPER_QUANTILE = 0.99
HELD_OUT = "test blocks held out of the training recordings"
ALL_OF_A_CHAIN = "the recordings of the fit, which changed a few constants only"
ALSO_CHOSEN_ON = " and blocks that chose the weights, because these hold too few windows"
MEMORY_MOST = 0.95  # correlation of the noise; above it a window holds almost no information
EVIDENCE_SAFETY = 3.0  # times the healthy recordings' largest evidence of a fault, for a code
WINDOWS_OF_A_CODE = 2  # must speak for a fault where healthy recordings show evidence of one
STEPS = (0.5, 0.8)  # of a weight that is still too large, at least and at most
LEAST_EVIDENCE = 1e-3  # with less the response rule decides nothing within a day
STILL_SAFETY = 1.5  # times the time after which no healthy reading was called stuck


def _held_out_windows(
    drives: Sequence[list[WindowJudged]],
    recordings: Sequence[Recording],
    held_out: Sequence[HeldOut],
    roles: Sequence[str],
) -> list[list[WindowJudged]]:
    """Return the windows of drives that lie in held-out blocks with one of the roles."""
    found = []
    for number, (recording, windows) in enumerate(zip(recordings, drives, strict=True)):
        spans = [(h.first, h.stop) for h in held_out if h.recording == number and h.role in roles]
        ticks = [
            (w.window.t_start_ns // recording.period_ns, w.window.t_end_ns // recording.period_ns)
            for w in windows
        ]
        inside = [any(a <= i and k < b for a, b in spans) for i, k in ticks]
        found.append(list(compress(windows, inside)))
    return found


def limits_of(
    drives: Sequence[Sequence[WindowJudged]],
    card: ModelCard,
    config: Config,
    origin: str,
    recordings: Sequence[Recording],
) -> dict[str, Limit]:
    """Return all decision limits from the windows of healthy drives, name → limit.

    origin : description of the drives for the model card
    recordings : of the drives; if they have too few windows, the error says why
    Raises RecordingError if there are fewer than 10 windows.
    """
    windows = [window for drive in drives for window in drive]
    if len(windows) < MINIMUM_WINDOWS:
        cause = most_common_cause(recordings, card, config)
        driven = " with the vehicle warm and in closed loop" if card.transform == "phi" else ""
        raise RecordingError(
            f"{len(windows)} healthy windows, {MINIMUM_WINDOWS} are wanted to set limits: "
            f"{cause or f'give more or longer recordings{driven}'}"
        )
    unit = card.output.unit
    means = np.array([w.mean for w in windows])
    stds = np.array([w.std for w in windows])
    within = [oriented(w.window.measured, card.transform) - w.window.bank[:, 0] for w in windows]
    noise, memory = _noise(within)
    scale = float(np.concatenate([w.window.measured for w in windows]).std())
    offsets = [np.mean([w.mean for w in drive]) for drive in drives if drive]
    offset_std = math.sqrt(
        float(np.mean([np.var([w.mean for w in drive]) for drive in drives if drive]))
    )
    spread = max(6.0 * offset_std, 3.0 * math.sqrt(float(np.mean(np.square(offsets)))))
    floor = config.bias.offset_limit_lambda if card.transform == "phi" else 0.0
    n = len(windows)
    where = f"{n} healthy windows, {origin}"
    phi = "-" if card.transform == "phi" else unit
    j_mu, j_sigma = _quantile(np.abs(means)), _quantile(stds)
    return {
        "j_mu": Limit(j_mu, unit, f"quantile {PAPER_QUANTILE}, {where}"),
        "j_sigma": Limit(j_sigma, unit, f"quantile {PAPER_QUANTILE}, {where}"),
        "j_mu_z": Limit(j_mu / scale, "z", f"j_mu over the measurement's spread {scale:.4g}"),
        "j_sigma_z": Limit(j_sigma / scale, "z", f"j_sigma over that spread {scale:.4g}"),
        "noise": Limit(noise, phi, f"residual within windows, {where}"),
        "noise_memory": Limit(
            memory, "-", f"correlation of the residual's neighbouring samples, {where}"
        ),
        "excitation": Limit(
            max(config.response.excitation_noise * noise, 1e-9),
            phi,
            f"{config.response.excitation_noise:g} times the noise",
        ),
        "offset": Limit(
            max(floor, spread),
            unit,
            f"largest of {floor:g}, six times the spread of a drive's window means and "
            f"three times that of the drives' means, {where}",
        ),
        "offset_std": Limit(offset_std, unit, f"spread of a drive's window means, {where}"),
    }


def _noise(within: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the standard deviation of the residual within windows, and its lag-1 correlation."""
    x = np.array(within)
    x -= x.mean(axis=1, keepdims=True)
    power = float((x**2).sum())
    memory = float((x[:, 1:] * x[:, :-1]).sum()) / power if power > 0.0 else 0.0
    return math.sqrt(power / x.size), min(max(memory, 0.0), MEMORY_MOST)


def _quantile(values: np.ndarray) -> float:
    return float(np.quantile(values, PAPER_QUANTILE))


def set_limits(
    path: Path,
    recordings: Sequence[Recording],
    held_out: Sequence[HeldOut],
    config: Config,
    origin: str = HELD_OUT,
) -> tuple[ModelCard, int]:
    """Write the limits of ``with_limits`` into the model file ``path``.

    Returns the new card and the number of windows. Raises as ``with_limits``.
    """
    card, windows = with_limits(Model.load(path), recordings, held_out, config, origin)
    update_card(path, card)
    return card, windows


def with_limits(
    model: Model,
    recordings: Sequence[Recording],
    held_out: Sequence[HeldOut],
    config: Config,
    origin: str = HELD_OUT,
) -> tuple[ModelCard, int]:
    """Return the model card with limits from held-out blocks, and the number of their windows.

    Short recordings, whose test blocks hold fewer than 10 windows, give those of the blocks that
    chose the weights, too, and the limits say so; no weight was fitted to either. If these are too
    few for a chain, which has a few constants, all windows of its recordings count.
    The joint region of the inputs is that of all windows of the recordings, for a network. The
    healthy gain is the median over the recordings. The weight of evidence falls until the healthy
    recordings' evidence of a fault stays well below a code.
    Raises RecordingError if there are fewer than 10 windows.
    """
    model = RepeatedModel.of(model)
    judged = judge_recordings(recordings, model, NO_LIMITS, config)
    everything = [each.windows for each in judged]
    drives = _held_out_windows(everything, recordings, held_out, ("test",))
    if sum(map(len, drives)) < MINIMUM_WINDOWS and origin == HELD_OUT:
        drives = _held_out_windows(everything, recordings, held_out, ("test", "validate"))
        origin += ALSO_CHOSEN_ON
        if sum(map(len, drives)) < MINIMUM_WINDOWS and model.card.kind == "greybox":
            drives, origin = everything, ALL_OF_A_CHAIN
    limits = limits_of(drives, model.card, config, origin, recordings)
    region = region_of(everything, model.card.input_names) if model.card.kind == "narx" else None
    card = replace(
        model.card,
        limits={**model.card.limits, **limits},
        region=region.to_card() if region else {},
    )
    card = with_fuel_cuts(card, judged, config)
    used = Limits.from_card(card, config, origin)
    response = response_limits(model, recordings, used, config)
    return replace(card, limits={**card.limits, **response}), sum(map(len, drives))


def with_fuel_cuts(card: ModelCard, judged: Sequence[Judged], config: Config) -> ModelCard:
    """Return the card with what the fuel cuts of healthy drives show, if they show anything."""
    drives = [each.fuel_cuts for each in judged]
    reference = reference_of(drives, config, card.transform, card.period_ns * 1e-9)
    return replace(card, fuel_cut=reference.to_card() if reference else card.fuel_cut)


def whole(recordings: Sequence[Recording]) -> list[HeldOut]:
    """Return whole recordings as held-out blocks.

    Use it for a model with a few constants: a fit to the same recordings changes little.
    """
    return [HeldOut(i, 0, len(r.values), "test") for i, r in enumerate(recordings)]


def response_limits(
    model: Model, recordings: Sequence[Recording], limits: Limits, config: Config
) -> dict[str, Limit]:
    """Return the healthy gains, the weights of evidence and how long the reading may stand still.

    The gain's spread from drive to drive, and a model that follows its vehicle poorly, look like a
    weak or late sensor; then no window alone may say more than half of what a code needs, and the
    evidence counts less by as much as the recordings still say so. Windows around fuel cuts have a
    gain and a weight of their own; the weight is 0 without such windows. A coarse or clipped
    reading that stands still in healthy recordings is given more time before it is stuck.

    One recording shows neither how the gain spreads nor the errors that a model has for a whole
    other drive, least of all the recording that trained it. So windows are bound in any case, and
    the reading of a weak sensor must also move less.
    """
    where, is_alone = f"{len(recordings)} healthy recordings", len(recordings) == 1
    full = config.response.evidence_weight
    plain = replace(limits, gain_model=1.0, evidence=math.inf, evidence_cut=full, gain_cut=1.0)
    unbound = 2.0 * config.response.evidence_most  # from its lead to the last place
    plain = replace(plain, still_s=0.0, evidence_window=unbound)
    judged = judge_recordings(recordings, model, plain, config)
    still_s = _still_s(judged, model, recordings, plain, config)
    gain = _healthy_gain([_last_gain(each.windows) for each in judged], config)
    used = replace(limits, gain_model=gain, evidence=full, evidence_cut=0.0)
    used = replace(used, evidence_window=unbound)
    most = _most_evidence(model, recordings, used, config)
    if is_alone or most > _allowed(config):
        used = replace(used, evidence_window=config.response.evidence_fail / WINDOWS_OF_A_CODE)
    used, _ = _calmed(model, recordings, used, "evidence", config)
    movement = 0.0
    if is_alone:
        movement = movement_of(judged[0].windows, model.card.transform, limits.noise_memory)
    found = {
        "gain_model": Limit(gain, "-", f"median gain of the likeliest sound sensor, {where}"),
        "evidence": Limit(
            used.evidence, "-", f"largest evidence of a fault {most:.3g} at full weight, {where}"
        ),
        "evidence_window": Limit(
            used.evidence_window,
            "-",
            f"half of a code's evidence where {where} show more than a third or are one, "
            "else no bound",
        ),
        "movement": Limit(
            movement,
            "-",
            "spread of the reading over that of the prediction in the only healthy recording"
            if is_alone
            else f"not needed, {where} show how gains differ",
        ),
        "still_s": Limit(
            still_s,
            "s",
            f"{STILL_SAFETY:g} times the time after which none of {where} was stuck"
            if still_s
            else f"none of {where} was stuck after the usual time",
        ),
    }
    n_cuts = sum(len(each.cuts) for each in judged)
    if not n_cuts:
        return found
    gain = _healthy_gain([_last_gain(each.cuts) for each in judged], config)
    unit = "-" if model.card.transform == "phi" else model.card.output.unit
    noise = float(np.median([cut.std for each in judged for cut in each.cuts]))
    used = replace(used, gain_cut=gain, noise_cut=noise, evidence_cut=full)
    used, most = _calmed(model, recordings, used, "evidence_cut", config)
    where = f"{n_cuts} windows around fuel cuts of {where}"
    return found | {
        "gain_cut": Limit(gain, "-", f"median gain of the likeliest sound sensor, {where}"),
        "noise_cut": Limit(noise, unit, f"median spread of the residual, {where}"),
        "evidence_cut": Limit(
            used.evidence_cut,
            "-",
            f"largest evidence of a fault {most:.3g} at full weight, {where}",
        ),
    }


def _healthy_gain(gains: Sequence[float | None], config: Config) -> float:
    """Return the median of the drives' gains, 1 without any."""
    known = [gain for gain in gains if gain is not None]
    least = config.response.gain_least  # a model that follows less says nothing of its vehicle
    return min(max(float(np.median(known)), least), 1.0 / least) if known else 1.0


def _still_s(
    judged: Sequence[Judged],
    model: Model,
    recordings: Sequence[Recording],
    limits: Limits,
    config: Config,
) -> float:
    """Return for how long the healthy reading may stand still, 0 if it is never called stuck."""
    still_s = 0.0
    while any(change.dtc.fault in TESTS["activity"] for each in judged for change in each.changes):
        still_s = STILL_SAFETY * (still_s or config.plausibility.stuck_s)
        judged = judge_recordings(recordings, model, replace(limits, still_s=still_s), config)
    return STILL_SAFETY * still_s


def _weighted(limits: Limits, name: str, weight: float) -> Limits:
    if name == "evidence_cut":
        return replace(limits, evidence_cut=weight)
    return replace(limits, evidence=weight)


def _calmed(
    model: Model,
    recordings: Sequence[Recording],
    limits: Limits,
    name: str,
    config: Config,
) -> tuple[Limits, float]:
    """Return limits with which healthy recordings stay well below a code; their evidence before.

    The weight is lowered. Evidence that the recordings show with the least weight, too, comes from
    other windows.
    """
    most = before = _most_evidence(model, recordings, limits, config)
    if most <= _allowed(config):
        return limits, before
    others = _most_evidence(model, recordings, _weighted(limits, name, LEAST_EVIDENCE), config)
    allowed, weight = max(_allowed(config), others), config.response.evidence_weight
    while most > allowed and weight > LEAST_EVIDENCE:  # evidence has bounds, so it is not linear
        weight *= float(np.clip(allowed / most, *STEPS))
        limits = _weighted(limits, name, weight)
        most = _most_evidence(model, recordings, limits, config)
    return limits, before


def _allowed(config: Config) -> float:
    """Return the largest evidence of a fault that healthy recordings may show."""
    return config.response.evidence_fail / EVIDENCE_SAFETY


def _most_evidence(
    model: Model, recordings: Sequence[Recording], limits: Limits, config: Config
) -> float:
    """Return the largest evidence of a fault in any window of healthy recordings."""
    found = [0.0]
    for judged in judge_recordings(recordings, model, limits, config):
        for windows in (judged.windows, judged.cuts):
            found += [float(window.statistics["evidence"] or 0.0) for window in windows]
    return max(found)


def _last_gain(windows: Sequence[WindowJudged | CutJudged]) -> float | None:
    gain = windows[-1].statistics["gain"] if windows else None
    return float(gain) if isinstance(gain, float) else None
