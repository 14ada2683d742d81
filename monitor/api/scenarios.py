"""Scenarios: a drive with faults put on, judged, and held against what is expected."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from monitor.api.recordings import Buses, set_up
from monitor.api.verdict import Verdict
from monitor.base.errors import UsageError
from monitor.base.types import Shown
from monitor.inject.drives import play
from monitor.inject.expected import compare, table
from monitor.inject.scenario import Expectation, Scenario, load, parse_fault
from monitor.model.step import Model
from monitor.pipeline.collector import Trace


@dataclass(frozen=True, slots=True, repr=False)
class ScenarioResult(Shown):
    """The verdicts on the drives of a scenario, and what is asserted of them."""

    scenario: Scenario
    verdicts: tuple[Verdict, ...]  # one for each drive

    @property
    def verdict(self) -> Verdict:
        """Return the verdict on the last drive."""
        return self.verdicts[-1]

    @property
    def codes(self) -> tuple[str, ...]:
        """Return the codes that are pending or confirmed after the last drive."""
        return tuple(code.code for code in self.verdict.codes)

    @property
    def detection_s(self) -> dict[str, float | None]:
        """Return by code the time in s from the start of the last drive's first fault.

        The time of a code that is older than the drive is None.
        """
        begin_s = self.scenario.begin_s(len(self.verdicts))
        codes = self.verdict.codes
        return {each.code: None if each.t_s is None else each.t_s - begin_s for each in codes}

    @property
    def facts(self) -> dict[str, object]:
        """Return the verdict on each drive, also for the message of a failed ``assert``."""
        return {f"drive {n}": each for n, each in enumerate(map(str, self.verdicts), 1)}

    def assert_met(self) -> Self:
        """Return the result if every ``[[expect]]`` of the scenario is met.

        Raises AssertionError with a table of what was expected and seen; UsageError if the
        scenario expects nothing.
        """
        __tracebackhide__ = True
        if not self.scenario.expectations:
            raise UsageError("the scenario has no [[expect]]: use assert_codes")
        return self._assert(self.scenario)

    def assert_codes(
        self, *codes: str, state: str = "", within_s: float = math.inf, judged: bool = True
    ) -> Self:
        """Return the result if the last drive has these codes and no others.

        codes : none for a drive without a fault
        state : "pending" or "confirmed"; default either
        within_s : time after the start of the drive's first fault
        judged : without codes, whether the response test must have completed
        Raises AssertionError with a table of what was expected and seen.
        """
        __tracebackhide__ = True
        last = len(self.verdicts)
        expected = [Expectation(code, last, state, within_s) for code in codes]
        expected = expected or [Expectation("none", last, judged=judged)]
        return self._assert(replace(self.scenario, expectations=tuple(expected)))

    def _assert(self, scenario: Scenario) -> Self:
        __tracebackhide__ = True
        rows = compare(scenario, [verdict.entry for verdict in self.verdicts])
        if not all(row.met for row in rows):
            faults = ", ".join(map(str, scenario.faults)) or "no fault"
            title = scenario.title or f"{Path(self.verdict.path).name} with {faults}"
            raise AssertionError("\n".join((title, *table(rows))))
        return self


def play_scenario(
    recording: str | Path,
    scenario: str | Path | None = None,
    *,
    faults: Sequence[str] = (),
    model: str | Path | Model | None = None,
    buses: Buses = (),
    columns: str | Path | None = None,
    config: str | Path | None = None,
    channel: str = "",
) -> ScenarioResult:
    """Put the faults of a scenario into a healthy drive and judge it, as ``o2mon inject`` does.

    recording : CAN log, table or logger's file
    scenario : TOML file with faults and expectations
    faults : further faults, each ``NAME[=SEVERITY][@START[-END]]`` with times in s
    model, buses, columns, config, channel : as in ``monitor.replay``
    Raises O2Error with one line that names the file or signal, what came and what is wanted.
    """
    read = load(Path(scenario)) if scenario else Scenario(())
    read = replace(read, faults=read.faults + tuple(map(parse_fault, faults)))
    entries = play(Path(recording), read, set_up(model, buses, columns, config, channel))
    none = Trace.unpredicted(np.empty(0), np.empty(0))
    return ScenarioResult(read, tuple(Verdict(entry, none) for entry in entries))
