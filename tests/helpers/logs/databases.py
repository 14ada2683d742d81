"""Databases as text, and what is proposed for them."""

import logging
from pathlib import Path
from typing import Any

from cantools.database import load_string
from cantools.database.can import Database

from monitor.mapping.map_proposal import MapProposal, make_map

logging.getLogger("cantools").setLevel(logging.ERROR)  # made-up databases repeat names


def database_of(
    *signals: str, message: str = "Engine_1", length: int = 64, more: str = ""
) -> Database:
    """Return a database with one message; signals as ``Name (factor,offset) [min|max] "unit"``.

    A - before the factor makes a signal signed.
    """
    lines = []
    for n, text in enumerate(signals):
        name, rest = text.split(" ", 1)
        sign = "-" if rest[0] == "-" else "+"
        lines.append(f" SG_ {name} : {16 * n}|16@1{sign} {rest.removeprefix('-')} X")
    body = "\n".join(lines)
    return load_string(
        f'VERSION ""\nBU_: ECU X\nBO_ 256 {message}: {length} ECU\n{body}\n{more}\n', strict=False
    )


def proposed(database: Database, **options: Any) -> tuple[str, MapProposal]:
    return make_map(database, Path("test.dbc"), **options)
