"""Find the effect that a model lacks, and estimate an ECU's tables."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from monitor.base.counts import plain
from monitor.base.errors import UsageError
from monitor.base.types import Shown
from monitor.model.step import Model
from training.api.parameters import LOADS, LoadAxis, TableParameters
from training.api.recordings import Given, load_recordings
from training.ecu_tables import config, fit, signals, tables
from training.ecu_tables.msq import read_axes
from training.gap.inputs.roles import GapOptions, Material
from training.gap.pages import gap_page
from training.gap.result import Result, as_json
from training.gap.workflow import investigate
from training.recordings.ecu_table import EcuTable, axes_of
from training.recordings.recording import Pairs, check_each_once

__all__ = ["Gap", "GapOptions", "estimate_tables", "find_gap"]

DEFAULT: Final = GapOptions()


@dataclass(frozen=True, slots=True, repr=False)
class Gap(Shown):
    """The findings of the gap workflow; ``entry`` is ``o2train.gap/1`` (docs/reference/json.md)."""

    entry: Mapping[str, Any]
    result: Result

    @property
    def facts(self) -> dict[str, object]:
        """Return verdict, effects, RMSE before and after, and the new model."""
        rmse = {when: self.entry[f"rmse_{when}"] for when in ("before", "after")}
        told = {f"RMSE {when}": plain(each) for when, each in rmse.items() if each is not None}
        effects = " ".join(self.effects) or "none"
        return {"verdict": self.verdict, "effects": effects, **told, "model": self.model}

    @property
    def verdict(self) -> str:
        """Return named, no_gap, ambiguous, unknown_effect or sensor_fault_suspected."""
        return str(self.entry["verdict"])

    @property
    def effects(self) -> list[str]:
        """Return the names of the effects that were added, or of the ambiguous set."""
        return [effect["name"] for effect in self.entry["effects"]]

    @property
    def model(self) -> Path | None:
        """Return the new model file, None if none was written."""
        return self.result.addition.path

    def to_dict(self) -> dict[str, Any]:
        """Return ``o2train.gap/1`` as plain dicts and lists."""
        return dict(self.entry)

    def write_report(self, path: str | Path) -> None:
        """Write the page that ``o2train gap`` writes."""
        gap_page.save(self.result, Path(path))


def find_gap(
    model: str | Path,
    recordings: Given | Sequence[Given],
    out: str | Path,
    *,
    healthy: Given | Sequence[Given] = (),
    verify: Given | Sequence[Given] = (),
    options: GapOptions = DEFAULT,
    progress: Callable[[str], None] = lambda _: None,
) -> Gap:
    """Find where a model and recordings disagree, name the effect, add it, verify the new model.

    out : folder for the new ``model.onnx``, made if it is not there
    healthy : recordings on which the model was accepted; verify : recordings that no fit may see
    Files are read at the model's period and with its profile, unless ``load_recordings`` read them.
    Raises O2Error with one line that names what cannot be used.
    """
    card = Model.load(model).card
    read = partial(load_recordings, period_s=card.period_ns / 1e9, of_model=card.profile)
    material = Material(Path(model), *map(read, (recordings, healthy, verify)))
    result = investigate(material, Path(out), options, progress=progress)
    return Gap(as_json(result), result)


def estimate_tables(
    recordings: Given | Sequence[Given],
    *,
    axes: str | Path | None = None,
    load: LoadAxis | None = None,
    displacement_l: float | None = None,
    cylinders: int = TableParameters.cylinders,
    period_s: float | None = None,
    buses: Pairs | None = None,
    columns: str | Path | None = None,
) -> list[EcuTable]:
    """Estimate an ECU's tables from recordings of one car, as ``o2train tables`` does.

    axes : TunerStudio tune (``.msq``) whose axes are used
    load : load axis, default pressure if the recordings have it
    displacement_l : of all cylinders, in litres
    cylinders : their number
    Other parameters as in ``load_recordings``; recordings with several periods take the slowest.
    Returns one ``EcuTable`` per table: ``estimate``, ``low`` and ``high`` (90 %) as arrays with one
    dimension per axis, NaN where nothing was measured.
    Raises O2Error with one line that names what cannot be used.
    """
    if load not in LOADS:
        raise UsageError(f"load {load!r}: kpa or mg is wanted")
    how: dict[str, Any] = {"buses": buses, "columns": columns, "one_grid": True}
    drives = load_recordings(recordings, period_s=period_s, **how)
    check_each_once(drives)
    subject = signals.subject_of(drives, LOADS[load], displacement_l, cylinders)
    own = () if axes is None else read_axes(Path(axes), subject.load)
    return tables.tables(fit.fit(subject), axes_of(subject.load, *own), config.defaults())
