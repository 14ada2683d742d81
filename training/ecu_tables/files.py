"""The files of the tables: JSON, one CSV per table, one TunerStudio table file per table.

A TunerStudio table has no blank cells, so a blank cell is 0 there: no delay, lag or film is ever 0.
"""

import io
import json
from collections.abc import Sequence
from csv import writer
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np

from monitor.base.files.outputs import write_text
from training.jobs.json_tree import json_tree
from training.recordings.ecu_table import DIGITS, SCHEMA, EcuTable

NAMESPACE: Final = "http://www.EFIAnalytics.com/:table"
DOCUMENT: Final = "tables.json"
SCALES: Final = {"s": (1000.0, 0), "-": (100.0, 1)}  # unit → factor, digits


def write_files(folder: Path, tables: Sequence[EcuTable], **more: Any) -> None:
    """Write ``tables.json``, a CSV and a TunerStudio file per table in place of an earlier run's.

    ``tables.json`` holds the digest of every other file, by which the next run knows them.
    """
    texts = {f"{table.key}.csv": csv(table) for table in tables}
    texts |= {f"{t.key}.table": tuner_studio(t) for t in tables if len(t.axes) == 2}
    for path in earlier(folder):
        if path.name not in texts:
            path.unlink()
    digests = {name: sha256(text.encode()).hexdigest() for name, text in sorted(texts.items())}
    made = [table.document() for table in tables]
    tree = {"schema": SCHEMA, **more, "files": digests, "tables": made}
    write_text(folder / DOCUMENT, json.dumps(tree, indent=1) + "\n")
    for name, text in texts.items():
        write_text(folder / name, text)


def earlier(folder: Path) -> set[Path]:
    """Return the tables in a folder that are as an earlier run wrote them."""
    try:
        digests = json.loads((folder / DOCUMENT).read_bytes())["files"].items()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return set()
    files = ((folder / Path(name).name, digest) for name, digest in digests)
    return {p for p, d in files if p.is_file() and sha256(p.read_bytes()).hexdigest() == d}


def csv(table: EcuTable) -> str:
    """Return one line per cell: its place, estimate, bounds, samples, and where it was driven.

    ``log`` and ``at_s`` tell the longest stay; blank cells are empty.
    """
    out = io.StringIO()
    lines = writer(out, lineterminator="\n")
    names = [axis.name for axis in table.axes]
    held = f"{table.name} [{table.unit}]"
    lines.writerow([*names, held, "low", "high", "samples", "log", "at_s"])
    for at in np.ndindex(table.estimate.shape):
        place = [f"{axis.values[k]:g}" for axis, k in zip(table.axes, at, strict=True)]
        values = [json_tree(v[at], DIGITS) for v in (table.estimate, table.low, table.high)]
        stay = [table.log[at], json_tree(table.at_s[at], DIGITS)] if table.log.size else ["", ""]
        lines.writerow([*place, *values, table.samples[at], *stay])
    return out.getvalue()


def tuner_studio(table: EcuTable) -> str:
    """Return the table as TunerStudio and MegaTune import it: speed across, load upwards.

    Times are in ms, fractions in percent, as these programs show them.
    """
    speed, load = table.axes
    factor, digits = SCALES.get(table.unit, (1.0, 3))
    rows = np.nan_to_num(table.estimate.T * factor)  # blank is 0
    lines = [
        '<?xml version="1.0" encoding="UTF-8" standalone="no"?>',
        f'<tableData xmlns="{NAMESPACE}">',
        '  <bibliography author="o2-monitor" company="" writeDate=""/>',
        '  <versionInfo fileFormat="1.0"/>',
        f'  <table cols="{len(speed.values)}" rows="{len(load.values)}">',
        f'    <xAxis cols="{len(speed.values)}" name="rpm">',
        *(f"      {value:.1f}" for value in speed.values),
        "    </xAxis>",
        f'    <yAxis name="{"map" if load.unit == "kPa" else "load"}" rows="{len(load.values)}">',
        *(f"      {value:.1f}" for value in load.values),
        "    </yAxis>",
        f'    <zValues cols="{len(speed.values)}" rows="{len(load.values)}">',
        *("      " + " ".join(f"{v:.{digits}f}" for v in row) for row in rows),
        "    </zValues>",
        "  </table>",
        "</tableData>",
    ]
    return "\n".join(lines) + "\n"
