"""Fit a model and evaluate it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from monitor.base.counts import plain
from monitor.base.errors import UsageError
from monitor.base.signals import OUTPUT
from monitor.base.types import Shown
from monitor.model.card import ModelCard
from monitor.model.step import Model
from training.api.recordings import Given, load_recordings
from training.greybox.chain import RANGES
from training.greybox.model import GreyboxResult, fit_greybox
from training.healthy.new_model import complete
from training.limits.evaluation import evaluate as evaluated
from training.narx.fit import FitOptions, FitResult, FitSource
from training.narx.fit import fit as fit_narx
from training.narx.page import training_page
from training.recordings.recording import Pairs, Recording, check_each_once
from training.recordings.samples.input_choice import choose_inputs

FitOutcome = FitResult | GreyboxResult


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Fit(Shown):
    """A fitted model: its file, its card with limits and healthy reference, and its training."""

    outcome: FitOutcome

    @classmethod
    def of(
        cls,
        outcome: FitOutcome,
        recordings: Sequence[Recording],
        columns: str | Path | None = None,
        progress: Callable[[str], None] = lambda _: None,
    ) -> "Fit":
        """Complete the card of a new model by its recordings and return the fit."""
        card, warnings = complete(outcome, recordings, columns, progress)
        return cls(outcome=replace(outcome, card=card, warnings=(*outcome.warnings, *warnings)))

    @property
    def card(self) -> ModelCard:
        """Return the card of the model, as it stands in the file."""
        return self.outcome.card

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what is doubtful about the model."""
        return self.outcome.warnings

    @property
    def path(self) -> Path:
        """Return the model file."""
        return self.outcome.path

    @property
    def facts(self) -> dict[str, object]:
        """Return file, kind, inputs, correlation on held-out samples, warnings."""
        correlation = self.card.fit["test"].get("correlation", math.nan)
        told = {"correlation": f"{correlation:.3f}", "warnings": len(self.warnings)}
        inputs = " ".join(self.card.input_names)
        return {"file": self.path, "kind": self.card.kind, "inputs": inputs} | told

    def to_dict(self) -> dict[str, Any]:
        """Return path, kind, inputs, errors on held-out samples, limits and warnings."""
        return {
            "path": str(self.path),
            "kind": self.card.kind,
            "inputs": list(self.card.input_names),
            "output": self.card.output.name,
            "period_s": self.card.period_ns / 1e9,
            "fit": {part: dict(figures) for part, figures in self.card.fit.items()},
            "limits": {name: limit.value for name, limit in self.card.limits.items()},
            "warnings": list(self.warnings),
        }

    def write_report(self, path: str | Path) -> None:
        """Write the page that ``o2train fit`` writes."""
        if isinstance(self.outcome, FitResult):
            training_page.write_report(Path(path), self.outcome)
        else:
            title = f"Grey-box model {self.path.name}"
            template = "fit/greybox_fit.html"
            training_page.write_page(path, self.outcome, template, title, ranges=RANGES)


def fit(
    recordings: Given | Sequence[Given],
    out: str | Path,
    *,
    kind: Literal["narx", "greybox"] = "narx",
    inputs: Sequence[str] | None = None,
    output: str = OUTPUT,
    period_s: float | None = None,
    buses: Pairs | None = None,
    columns: str | Path | None = None,
    seed: int = 0,
    **shape: Any,
) -> Fit:
    """Train a model on drives of a healthy vehicle and write it, with its limits, as ``out``.

    recordings, period_s, buses, columns : as in ``load_recordings``
    out : the ``.onnx`` file to write
    kind : a network, or the physical chain
    inputs : default the paper's where all recordings have them, else chosen from what there is
    output : signal to predict
    shape : of a network: the fields of ``training.narx.fit.FitOptions``: ``lags``, ``hidden``,
        ``starts``, ``budget_minutes`` (10, counted work), ``wall_minutes``, ``threads``,
        ``progress``
    Raises O2Error with one line that names what cannot be used.
    """
    if Path(out).suffix != ".onnx":
        raise UsageError(f"{out}: a model file ends in .onnx")
    if kind not in ("narx", "greybox"):
        raise UsageError(f"kind {kind!r}: narx or greybox is wanted")
    if kind == "greybox" and shape:
        raise UsageError(f"{', '.join(shape)}: a grey-box model has no such thing, a NARX has")
    drives = load_recordings(recordings, period_s=period_s, buses=buses, columns=columns)
    check_each_once(drives)
    if kind == "greybox":
        chain = fit_greybox(drives, out, inputs=inputs, output=output, seed=seed)
        return Fit.of(chain, drives, columns)
    source = FitSource(drives, inputs or choose_inputs(drives, output), output)
    return Fit.of(fit_narx(source, out, FitOptions(seed=seed, **shape)), drives, columns)


@dataclass(frozen=True, slots=True, repr=False)
class Evaluation(Shown):
    """The errors of a model on recordings; ``entry`` is ``o2train.evaluate/1``."""

    entry: Mapping[str, Any]

    @property
    def facts(self) -> dict[str, object]:
        """Return the RMSE on each recording."""
        unit, told = self.entry["unit"].replace("-", ""), self.recordings
        return {each["path"]: f"RMSE {plain(each['rmse'])} {unit}".strip() for each in told}

    @property
    def recordings(self) -> list[Mapping[str, Any]]:
        """Return the figures of each recording, in the output's unit."""
        return list(self.entry["recordings"])

    def to_dict(self) -> dict[str, Any]:
        """Return ``o2train.evaluate/1`` as plain dicts and lists."""
        return dict(self.entry)

    def to_polars(self) -> Any:
        """Return one row per recording as a ``polars.DataFrame``, without the enabled samples."""
        rows = [{k: v for k, v in each.items() if k != "enabled"} for each in self.recordings]
        return import_module("polars").DataFrame(rows, infer_schema_length=None)


def evaluate(
    model: str | Path,
    recordings: Given | Sequence[Given],
    *,
    washout: int | None = None,
    healthy: bool = False,
    buses: Pairs | None = None,
    columns: str | Path | None = None,
) -> Evaluation:
    """Return a model's errors on recordings, in free run and one step ahead.

    washout : first samples, which set the state and are not scored; default the longest lag
    healthy : the sensors were sound: ``false_alarms`` in the entry, stated and observed
    Other parameters as in ``load_recordings``.
    Raises O2Error with one line that names what cannot be used.
    """
    card = Model.load(model).card
    how: dict[str, Any] = {"buses": buses, "columns": columns, "of_model": card.profile}
    drives = load_recordings(recordings, period_s=card.period_ns / 1e9, **how)
    return Evaluation(evaluated(model, drives, washout, healthy=healthy))
