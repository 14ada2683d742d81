"""From recordings to a grey-box model file: prepare, fit the constants, export, check."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.signals import OUTPUT
from monitor.base.types import BoolArray, FloatArray
from monitor.model.card import ModelCard
from training.greybox.chain import RANGES, RECOVERY_S, Constants, inputs_of
from training.greybox.charge import INPUTS as CHARGE_INPUTS
from training.greybox.charge import fit_with_charge, has_own_charge
from training.greybox.effects.model_effect import ModelEffect
from training.greybox.fit.constants import Fitted, Report, described, nobody, reference
from training.greybox.fit.drive import ChainDrive, until
from training.greybox.fit.vehicle_effects import own_of
from training.greybox.graph.chain_graph import Greybox, build
from training.greybox.graph.effect_inputs import from_fuel_cut, with_margin
from training.narx.export import write
from training.narx.model_file import FreeRunFit, card_of, recorded
from training.recordings.recording import Recording
from training.recordings.samples.preparation import Prepared, Role, prepare

POOR_CORRELATION = 0.6  # a lower one is a warning
WASHOUT_S = 5.0  # start of a stretch that is not fitted, longer than ``RECOVERY_S``


@dataclass(frozen=True, slots=True, kw_only=True)
class GreyboxResult(FreeRunFit):
    """The model and its fit."""

    greybox: Greybox
    fitted: Fitted


def greybox_inputs(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the chain's inputs: with the charge, else with its density, else the air meter."""
    common = frozenset.intersection(*(recording.known for recording in recordings))
    return CHARGE_INPUTS if has_own_charge(common) else inputs_of(common)


def fit_greybox(
    recordings: Sequence[Recording],
    out: Path | str,
    *,
    inputs: Sequence[str] | None = None,
    output: str = OUTPUT,
    seed: int = 0,
    progress: Report = nobody,
) -> GreyboxResult:
    """Fit the chain's constants to ``recordings`` and write the model file ``out``.

    inputs : default those of the chain and of the vehicle's own effects. With manifold pressure
        and temperature but without air per stroke the chain makes its own charge. Further inputs
        are for effects to be added.
    progress : is told the share done, 0 to 1, and the RMSE in phi
    Raises RecordingError or UsageError if the recordings or names cannot be used.
    """
    began = time.monotonic()
    chosen, inputs = inputs is not None, tuple(inputs or greybox_inputs(recordings))
    _check_names(inputs, output)
    data = prepare(recordings, inputs, output, seed=seed)
    u = recorded(data, data.names)
    limits = {each.name: with_margin(each.name, each.minimum, each.maximum) for each in data.inputs}
    period_s = data.period_ns / 1e9
    greybox = Greybox(constants=Constants(), limits=from_fuel_cut(limits), period_s=period_s)
    signals = greybox.seen(dict(zip(data.names, u.T, strict=True)))
    drive = ChainDrive(
        name=", ".join(str(recording.path) for recording in recordings),
        period_s=period_s,
        signals=signals,
        phi_measured=data.scaling.unscale_y(data.samples.y),
        scored=scored_rows(data, signals) & (data.role == Role.TRAIN),
    )
    own = () if has_own_charge(inputs) else own_of(drive)
    drive = replace(drive, own=own)
    further = [] if chosen else _further_inputs(own, data)
    if further:  # a cold engine's walls
        wider = (*inputs, *further)
        return fit_greybox(recordings, out, inputs=wider, seed=seed, progress=progress)
    fitted, charge = fit_with_charge(drive, progress)
    greybox = replace(greybox, constants=fitted.constants, own=own, charge=charge)
    predicted = _free_run(data, u, greybox)
    card = card_of(
        data,
        predicted,
        kind="greybox",
        lags=greybox.memory,
        input_lag_start=0,
        layers=(),
        state=greybox.state_layout,
        structure=described(fitted) | greybox.structure(),
        checks={"contraction": asdict(greybox.contraction)},
        reference=reference(fitted),
    )
    write(out, build(greybox), card)
    warnings = (*data.warnings, *_warnings(fitted, card), *greybox.contraction.warnings())
    return GreyboxResult(
        path=Path(out),
        card=card,
        greybox=greybox,
        fitted=fitted,
        data=data,
        predicted=predicted,
        seconds=time.monotonic() - began,
        warnings=warnings,
    )


def _further_inputs(own: Sequence[ModelEffect], data: Prepared) -> list[str]:
    """Return the signals of the vehicle's own effects that are no inputs, but move in its drives.

    A constant one, as the coolant of a warm engine, tells an effect nothing.
    """
    common = frozenset.intersection(*(recording.known for recording in data.recordings))
    wanted = dict.fromkeys(name for each in own for name in each.effect.signals_of(common))
    present = {*data.names, "engine_speed_rpm"}  # the chain computes a speed that is not broadcast
    further = [name for name in wanted if name not in present]
    seen = recorded(data, further)[data.role == Role.TRAIN]
    moves = np.fmax.reduce(seen) > np.fmin.reduce(seen)
    return [name for name, moving in zip(further, moves, strict=True) if moving]


def scored_rows(data: Prepared, signals: Mapping[str, FloatArray]) -> BoolArray:
    """Return (n,) bool: enabled, clear of fuel cut, and not at the start of a stretch."""
    period_s = data.period_ns / 1e9
    rows = data.enabled & ~until(signals["fuel_mass_mg"] <= 0.0, RECOVERY_S, period_s)
    for s in data.segments:
        rows[s.start : s.start + round(WASHOUT_S / period_s)] = False
    return rows


def _check_names(inputs: Sequence[str], output: str) -> None:
    if not has_own_charge(inputs) and not set(inputs_of(inputs)) <= set(inputs):
        raise UsageError(
            f"inputs {' '.join(inputs)}: a grey-box model needs fuel_mass_mg, engine_speed_rpm "
            "and for its charge air_mass_mg, manifold_pressure_kpa and manifold_temperature_degc, "
            "or maf_kg_h; engine speed may be left out where there are air_mass_mg and maf_kg_h"
        )
    if output != OUTPUT:
        raise UsageError(f"output {output}: a grey-box model predicts {OUTPUT} alone")


def _free_run(data: Prepared, u: FloatArray, greybox: Greybox) -> FloatArray:
    """Return the prediction (n,) in phi, NaN at the start of each stretch."""
    predicted = np.full(len(data.role), np.nan)
    washout = round(WASHOUT_S / greybox.period_s)
    for s in data.segments:
        predicted[s.start + washout : s.stop] = greybox.reading(u[s.start : s.stop])[washout:]
    return predicted


def _warnings(fitted: Fitted, card: ModelCard) -> list[str]:
    warnings = [
        f"{name} ended at its bound, {getattr(fitted.constants, name):g} {RANGES[name].unit}: "
        "the recordings do not hold it"
        for name in fitted.at_bound
    ]
    found = card.fit["test_enabled"].get("correlation", 1.0)
    if not found >= POOR_CORRELATION:
        warnings.append(
            f"the chain follows the measurement poorly (correlation {found:.2f} on held-out "
            "enabled samples): its constants mean little"
        )
    return warnings
