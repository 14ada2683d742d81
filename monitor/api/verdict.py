"""The result of a drive as an object: codes, windows, evidence, series."""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

import numpy as np

from monitor.base.errors import UsageError
from monitor.base.files.json_text import rounded
from monitor.base.types import BoolArray, FloatArray, Shown
from monitor.judge.causes.causes import Cause
from monitor.judge.decision.window_facts import Evidence
from monitor.pipeline.collector import Trace
from monitor.report.lines import verdict_text


@dataclass(frozen=True, slots=True)
class Code:
    """A diagnostic trouble code that is pending or confirmed."""

    code: str  # "P0133"
    fault: str  # "slow_symmetric"
    state: Literal["pending", "confirmed"]
    status: int  # ISO 14229-1 status byte
    t_s: float | None  # since the first sample; None if it is older than the drive
    probability: float  # of the fault's name among the names with this code
    also: tuple[str, ...] = ()  # other names that the evidence does not rule out


@dataclass(frozen=True, slots=True, repr=False)
class Verdict(Shown):
    """The monitor's verdict on one drive.

    ``entry`` is the drive's entry in ``recordings`` of ``o2mon.replay/1`` (docs/reference/json.md);
    the properties read it.
    """

    entry: Mapping[str, Any]
    series: Trace  # on the model's grid; empty unless it was asked for

    @property
    def facts(self) -> dict[str, object]:
        """Return recording, verdict, enabled samples and windows."""
        e = self.entry
        enabled = f"{e['enabled_samples']} of {e['samples']} samples"
        told = {"verdict": verdict_text(e), "enabled": enabled, "windows": len(e["windows"])}
        return {"recording": self.path} | told

    @property
    def path(self) -> str:
        """Return the recording's name."""
        return str(self.entry["path"])

    @property
    def has_fault(self) -> bool:
        """Return whether a code is pending or confirmed at the end."""
        return bool(self.entry["fault_flag"])

    @property
    def is_judged(self) -> bool:
        """Return whether the drive has a verdict: a fault, or every test completed without one."""
        return self.has_fault or not self.entry["not_judged"]

    @property
    def codes(self) -> tuple[Code, ...]:
        """Return the codes that are pending or confirmed at the end."""
        return tuple(
            Code(**{**entry, "also": tuple(entry.get("also", ()))}) for entry in self.entry["dtcs"]
        )

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Return why the drive was not judged, the plainest cause first; empty if it was."""
        return tuple(Cause(**each) for each in self.entry["not_judged"] or ())

    @property
    def tests(self) -> dict[str, str]:
        """Return by test whether it ``passed``, ``failed`` or is ``undecided``."""
        return dict(self.entry.get("tests", {}))

    @property
    def evidence(self) -> dict[str, Evidence]:
        """Return by fault how far the response test is from a decision."""
        return {fault: Evidence(**each) for fault, each in self.entry["evidence"].items()}

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as plain dicts and lists that ``json.dumps`` takes."""
        return dict(rounded(deepcopy(dict(self.entry))))

    def columns(self) -> dict[str, FloatArray | BoolArray]:
        """Return the series by name, each of shape (n,): ``pandas.DataFrame`` takes it as it is.

        ``t_s`` in s since the first sample; ``measured`` and ``predicted`` in the output's unit,
        NaN where invalid; ``enabled`` and ``fault_flag`` bool.
        """
        return {name: np.asarray(getattr(self.series, name)) for name in Trace.__slots__}

    def to_polars(self) -> Any:
        """Return the series as a ``polars.DataFrame``; raises UsageError without polars."""
        return _polars().DataFrame(self.columns())

    def windows_to_polars(self) -> Any:
        """Return the windows as a ``polars.DataFrame``; raises UsageError without polars."""
        nested = ("statistics", "also")
        rows = [
            {key: value for key, value in window.items() if key not in nested}
            for window in self.entry["windows"]
        ]
        return _polars().DataFrame(rows, infer_schema_length=None)

    def __str__(self) -> str:
        """Return the verdict on one line, as ``o2mon replay`` prints it."""
        return f"{self.path}: {verdict_text(self.entry)}"


def _polars() -> Any:
    try:
        return import_module("polars")
    except ModuleNotFoundError:
        raise UsageError("a polars frame needs polars: pip install polars") from None
