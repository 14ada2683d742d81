"""Freeze what the commands write, and compare it after a change that may not change it.

    python -m benchmarks goldens make
    python -m benchmarks goldens compare [--only replay,gap] [--keep FOLDER]

The commands run on simulated drives and on the logs of ``replay_logs``. Paths, versions and
durations are taken out before hashing. Files are compared with ``goldens.json`` beside this file;
``--keep`` leaves them for a look at the differences.
"""

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[2]
STORED: Final = Path(__file__).with_name("goldens.json")
# Values of the machine or the moment, and the regimes in `gap.json`, which decide no verdict.
DROPPED: Final = frozenset(
    {"path", "o2mon_version", "o2train_version", "packages", "parity", "seconds", "where"}
)
CYCLES: Final = ("wltc_3b", "micro_trips", "udds", "us06")
GAPS: Final = {  # what is hidden in a case, as options of `o2train simulate`
    "none": (),
    "wall_film": ("--effect", "wall_film=3"),
    "delay_flow": ("--effect", "delay_flow=3"),
    "leak": ("--effect", "exhaust_leak=3"),
    "air_meter": ("--effect", "maf_offset=3"),
    "slow_sensor": ("--fault", "slow_symmetric=0.5"),
}


def main(argv: Sequence[str]) -> int:
    """Make the goldens or compare with them; return 1 if one differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("make", "compare"))
    parser.add_argument("--only", default=",".join(PARTS), help="parts, separated by commas")
    parser.add_argument("--keep", type=Path, help="folder that keeps the files")
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.keep or Path(temporary)
        found = {
            f"{part}/{name}": digest
            for part in args.only.split(",")
            for name, digest in PARTS[part](_made(folder / part))
        }
    stored = json.loads(STORED.read_text()) if STORED.exists() else {}
    if args.part == "make":
        STORED.write_text(json.dumps(dict(sorted({**stored, **found}.items())), indent=1) + "\n")
        return 0
    differing = [name for name, digest in found.items() if stored.get(name) != digest]
    for name in differing:
        print(f"differs: {name}")
    print(f"{len(found) - len(differing)} of {len(found)} equal")
    return 1 if differing or not found else 0


def _replay(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield text, JSON and page of every log in ``replay_logs``, and its committed events."""
    for log in sorted((ROOT / "replay_logs").glob("*.blf")):
        out, page = folder / f"{log.stem}.json", folder / f"{log.stem}.html"
        text = _run("monitor", "replay", log, "--json", out, "--html", page)
        yield f"{log.stem}.txt", _text(text, folder)
        yield out.name, _tree(out)
        yield page.name, _text(page.read_text(), folder)
    for expected in sorted((ROOT / "replay_logs" / "expected").iterdir()):
        yield f"expected/{expected.name}", _bytes(expected.read_bytes())


def _tables(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the replay of tables and the ECU's tables that are estimated from them."""
    for fault in ("none", "gain_low=0.5", "biased_rich=0.1"):
        own = () if fault == "none" else ("--fault", fault)
        for table in _drives(folder / fault.partition("=")[0], ("micro_trips",), 301, *own):
            out = folder / f"{fault}.json"
            _run("monitor", "replay", table, "--json", out)
            yield out.name, _tree(out)
    tables = _drives(folder / "drives", CYCLES[:2], 311)
    _run("training", "tables", *tables, "--out", folder / "ecu", "--displacement-l", "1.6")
    yield "tables.json", _tree(folder / "ecu" / "tables.json")


def _fleet(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the fleet's tables of drives and windows."""
    import polars  # noqa: PLC0415

    _drives(folder / "cars", CYCLES[:2], 321)
    _drives(folder / "cars", CYCLES[2:3], 331, "--fault", "delay_symmetric=0.6")
    model = ROOT / "monitor" / "model" / "shipped.onnx"
    table = folder / "fleet.parquet"
    _run("training", "fleet", folder / "cars", "--model", model, "--out", table, "--jobs", "1")
    for each in sorted(folder.glob("*.parquet")):
        yield each.name, _text(polars.read_parquet(each).write_json(), folder)


def _fits(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield graph and card of two small networks and a chain."""
    drives = _drives(folder / "drives", CYCLES[1:3], 341)
    for name, shape in {"narrow": "4", "deep": "3 3"}.items():
        model, size = folder / f"{name}.onnx", ("--lags", "3", "--hidden", *shape.split())
        _run(
            *("training", "fit", *drives, "--out", model, *size),
            *("--starts", "1", "--budget", "60", "--seed", "1"),
        )
        yield model.name, _model(model)
    yield "chain.onnx", _model(_chain(folder, drives))


def _gap(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield ``gap.json`` of six cases on a grey-box chain."""
    healthy = _drives(folder / "healthy", CYCLES, 351)
    model = _chain(folder, healthy)
    for name, hidden in GAPS.items():
        drives = _drives(folder / name, CYCLES[:3], 361, *hidden)
        out = folder / f"{name}_gap"
        _run("training", "gap", *drives, "--model", model, "--healthy", *healthy, "--out", out)
        yield f"{name}.json", _tree(out / "gap.json")


PARTS: Final[dict[str, Callable[[Path], Iterator[tuple[str, str]]]]] = {
    "replay": _replay,
    "tables": _tables,
    "fleet": _fleet,
    "fits": _fits,
    "gap": _gap,
}


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _drives(folder: Path, cycles: tuple[str, ...], seed: int, *own: str) -> list[Path]:
    """Simulate ten minutes of each cycle and return the tables."""
    before = set(folder.glob("*.csv.gz"))
    for number, cycle in enumerate(cycles):
        _run(
            *("training", "simulate", "--out", folder, "--cycle", cycle, *own),
            *("--seed", str(seed + number), "--duration", "600", "--format", "csv.gz"),
        )
    return sorted(set(folder.glob("*.csv.gz")) - before)


def _chain(folder: Path, drives: list[Path]) -> Path:
    model = folder / "chain.onnx"
    _run("training", "fit", *drives, "--kind", "greybox", "--out", model)
    return model


def _run(*command: object) -> str:
    """Run ``PACKAGE.cli ARGUMENTS`` of this checkout and return its output."""
    package, *args = map(str, command)
    done = subprocess.run(
        [sys.executable, "-m", f"{package}.cli", *args],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in (0, 1, 3):
        sys.exit(f"{package} {' '.join(args)}: exit {done.returncode}\n{done.stderr}")
    return done.stdout


def _bytes(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _text(text: str, folder: Path) -> str:
    """Return the digest of ``text`` without paths, versions and times of the clock."""
    text = text.replace("<wbr>", "")  # in paths on a page
    for path in (str(folder), str(ROOT)):
        text = text.replace(path, "")
    return _bytes(re.sub(r"\b\d+(\.\d+)? s of (time|work)\b", "", text).encode())


def _tree(path: Path) -> str:
    return _bytes(json.dumps(_kept(json.loads(path.read_text())), sort_keys=True).encode())


def _kept(value: Any) -> Any:
    """Return ``value`` without the keys that name machine or moment."""
    if isinstance(value, dict):
        return {k: _kept(v) for k, v in value.items() if k not in DROPPED}
    if isinstance(value, list):
        return [_kept(each) for each in value]
    return Path(value).name if isinstance(value, str) and value.startswith("/") else value


def _model(path: Path) -> str:
    """Return the digest of a model's graph and of its card."""
    import onnx  # noqa: PLC0415

    model = onnx.load(path)
    card = next(each.value for each in model.metadata_props if each.key == "o2_monitor_card")
    graph = model.graph.SerializeToString(deterministic=True)
    return _bytes(graph + json.dumps(_kept(json.loads(card)), sort_keys=True).encode())
