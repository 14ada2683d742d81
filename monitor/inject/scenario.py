"""Scenario files: faults with severity and time span, and the expected codes.

``docs/guides/inject.md`` lists the keys with units and defaults.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from monitor.base.errors import ConfigError, UsageError
from monitor.base.files.toml_table import TomlTable
from monitor.inject.injection import Injection
from monitor.memory.codes import every, is_known

NO_CODE: Final = "none"
MOST_DRIVES: Final = 100


@dataclass(frozen=True, slots=True)
class Expectation:
    """The expected code of one drive."""

    code: str  # or NO_CODE
    drive: int  # from 1
    state: str = ""  # "pending", "confirmed", or "" for either
    within_s: float = math.inf  # after the drive's first fault begins
    judged: bool = True  # with NO_CODE: the response test must have completed

    def __str__(self) -> str:
        if self.code == NO_CODE:
            return "no code" + (", judged" if self.judged else "")
        state = f" {self.state}" if self.state else ""
        within = f" within {self.within_s:g} s" if math.isfinite(self.within_s) else ""
        return f"{self.code}{state}{within}"


@dataclass(frozen=True, slots=True)
class Scenario:
    """Faults and expectations of one test."""

    faults: tuple[Injection, ...]
    expectations: tuple[Expectation, ...] = ()
    title: str = ""
    seed: int = 0
    n_drives: int = 1
    keep_counters: bool = False

    def faults_of(self, drive: int) -> tuple[Injection, ...]:
        """Return the faults of a drive; drives count from 1."""
        return tuple(f for f in self.faults if not f.drives or drive in f.drives)

    def seed_of(self, drive: int) -> int:
        """Return the seed of a drive's random faults."""
        return self.seed + drive - 1

    def begin_s(self, drive: int) -> float:
        """Return the start in s of the drive's first fault, 0 without a fault."""
        return min((fault.start_s for fault in self.faults_of(drive)), default=0.0)


def parse_fault(text: str) -> Injection:
    """Return the fault of ``NAME[=SEVERITY][@START[-END]]``, times in s.

    Raises UsageError if the text has another form.

    >>> parse_fault("delay_symmetric=0.8@60-90").end_s
    90.0
    """
    name, at, span = text.partition("@")
    name, equals, severity = name.partition("=")
    start, dash, end = span.partition("-")
    try:
        return Injection.of(
            name,
            float(severity) if equals else None,
            start_s=float(start) if at else 0.0,
            end_s=float(end) if dash else math.inf,
        )
    except ValueError:
        raise UsageError(
            f"--fault {text}: wanted NAME[=SEVERITY][@START[-END]] with numbers, times in s"
        ) from None


def load(path: Path) -> Scenario:
    """Return the scenario of a TOML file.

    Raises ConfigError with file and key if a key is unknown or missing, or a value impossible.
    """
    raw = TomlTable.of_file(path, "the scenario", ConfigError)
    raw.only(("title", "seed", "drives", "keep_counters", "fault", "expect"))
    n_drives = raw.value("drives", int, 1)
    if not 1 <= n_drives <= MOST_DRIVES:
        raise raw.unwanted("drives", f"1 to {MOST_DRIVES} is")
    expectations = tuple(_expectation(table, n_drives) for table in raw.tables("expect"))
    for drive in {each.drive for each in expectations}:
        codes = [each.code for each in expectations if each.drive == drive]
        if len(set(codes)) < len(codes) or (NO_CODE in codes and len(codes) > 1):
            raise raw.fault(f"[[expect]] of drive {drive} contradict each other or repeat")
    return Scenario(
        faults=tuple(_fault(table, n_drives) for table in raw.tables("fault")),
        expectations=expectations,
        title=raw.value("title", str, ""),
        seed=raw.value("seed", int, 0),
        n_drives=n_drives,
        keep_counters=raw.value("keep_counters", bool, False),
    )


def _fault(table: TomlTable, n_drives: int) -> Injection:
    table.only(("name", "severity", "start_s", "end_s", "drives", "messages", "can_id"))
    drives = table.values("drives", int)
    if any(not 1 <= each <= n_drives for each in drives):
        raise table.unwanted("drives", f"numbers from 1 to {n_drives} are")
    for key in ("drives", "messages"):
        if key in table and not table.tree[key]:
            raise table.unwanted(key, "at least one is")
    try:
        return Injection.of(
            table.value("name", str),
            table.value("severity", float, None),
            start_s=table.value("start_s", float, 0.0),
            end_s=table.value("end_s", float, math.inf),
            messages=table.values("messages", str),
            can_id=table.value("can_id", int, 0),
            drives=drives,
        )
    except UsageError as error:
        raise table.fault(str(error)) from None


def _expectation(table: TomlTable, n_drives: int) -> Expectation:
    table.only(("code", "state", "within_s", "drive", "judged"))
    code, state = table.value("code", str), table.value("state", str, "")
    drive = table.value("drive", int, n_drives)
    within_s = table.value("within_s", float, math.inf)
    for key, possible, wanted in (
        ("code", code == NO_CODE or is_known(code), f"{', '.join(every())} or {NO_CODE} is"),
        ("state", state in ("", "pending", "confirmed"), "pending or confirmed is"),
        ("drive", 1 <= drive <= n_drives, f"1 to {n_drives} is"),
        ("within_s", within_s > 0.0, "above 0 is"),
    ):
        if not possible:
            raise table.unwanted(key, wanted)
    for key in ("state", "within_s") if code == NO_CODE else ("judged",):
        if key in table:
            raise table.fault(f"{key} says nothing beside code = {code!r}")
    return Expectation(code, drive, state, within_s, table.value("judged", bool, True))
