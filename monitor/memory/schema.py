"""The tables of the main file of a fault memory, version by version."""

from typing import Final

from monitor.memory.content import TABLES

# Statements that turn a file of version n - 1 into one of version n.
STEPS: Final = (
    (
        """
CREATE TABLE dtc (
    code TEXT PRIMARY KEY,
    fault TEXT NOT NULL,
    also TEXT NOT NULL,
    status INTEGER NOT NULL,
    t_ns INTEGER NOT NULL,
    failed_before INTEGER NOT NULL,
    passed_cycles INTEGER NOT NULL
) STRICT
""",
    ),
    (
        """
CREATE TABLE reference (
    model_sha256 TEXT PRIMARY KEY,
    offset_low REAL NOT NULL,
    offset_high REAL NOT NULL,
    gain REAL NOT NULL,
    drives INTEGER NOT NULL
) STRICT
""",
    ),
    (
        "ALTER TABLE dtc RENAME COLUMN failed_before TO failed_cycles",
        "ALTER TABLE dtc ADD COLUMN warm_ups INTEGER NOT NULL DEFAULT 0",
        """
CREATE TABLE freeze_frame (
    place INTEGER NOT NULL,
    code TEXT PRIMARY KEY,
    t_ns INTEGER NOT NULL,
    signals TEXT NOT NULL
) STRICT
""",
        """
CREATE TABLE permanent (
    place INTEGER NOT NULL,
    code TEXT PRIMARY KEY,
    fault TEXT NOT NULL
) STRICT
""",
        """
CREATE TABLE result (
    test TEXT NOT NULL,
    quantity TEXT NOT NULL,
    value REAL NOT NULL,
    low REAL NOT NULL,
    high REAL NOT NULL,
    PRIMARY KEY (test, quantity)
) STRICT
""",
        """
CREATE TABLE ratio (
    test TEXT PRIMARY KEY,
    numerator INTEGER NOT NULL,
    denominator INTEGER NOT NULL
) STRICT
""",
        "CREATE TABLE counted (name TEXT PRIMARY KEY, number ANY NOT NULL) STRICT",
        "CREATE TABLE completed (test TEXT PRIMARY KEY) STRICT",
    ),
    (
        *(f"ALTER TABLE {table} ADD COLUMN checksum TEXT NOT NULL DEFAULT ''" for table in TABLES),
        # The columns of this table stay as they are in every later version: they say which it is.
        """
CREATE TABLE head (
    schema INTEGER NOT NULL,
    memory TEXT NOT NULL,
    generation INTEGER NOT NULL,
    set_aside TEXT NOT NULL,
    digest TEXT NOT NULL,
    checksum TEXT NOT NULL
) STRICT
""",
    ),
)
# Texts in a file of ours, whatever its version; a file in which one of them stands was ours.
SIGNATURES: Final = (
    b"passed_cycles INTEGER NOT NULL",
    b"model_sha256 TEXT PRIMARY KEY",
    b"CREATE TABLE freeze_frame (",
    b"CREATE TABLE permanent (",
)
