"""Healthy and faulty simulated drives with the imperfections of ordinary logs, buses and loggers.

An imperfection is no fault of the sensor: a healthy drive that has one may not get a code, and a
faulty one should keep its own. The drives are 600 s of four cycles, the vehicles others than those
of the shipped model, the faults at twice the limit from the beginning. Nothing of this was recorded
on a road.

python -m benchmarks imperfections [--drives N] [--only TEXT] [--model FILE]

Ends with exit code 1 if a healthy drive got a code that is false: another one than that of the
part which the imperfection itself spoils.
"""

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from monitor.base import faults
from monitor.base.config import load as load_config
from monitor.base.errors import O2Error
from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray, FrameBlock, IntArray
from monitor.frames.blocks import chosen
from monitor.judge.causes.causes import Cause
from monitor.pipeline import replay
from training.dyno import ecu
from training.dyno.downstream import fault_behind
from training.dyno.simulation import Experiment, simulate
from training.recordings.files.can_log import merge, write_log

CYCLES: Final = ("wltc_3b", "udds", "us06", "micro_trips")
FAULTS: Final = {
    "slow_symmetric": 0.6, "slow_rich_to_lean": 0.8, "delay_symmetric": 0.6, "gain_low": 0.45,
    "delay_lean_to_rich": 0.6, "biased_lean": 0.1, "stuck_at_one": None, "no_activity": None,
    "slow_lean_to_rich": 0.8, "biased_rich": 0.1,
}  # fmt: skip
BEHIND: Final = ("catalyst_low", "downstream_stuck_lean")
# the error of a meter looks like an offset, and the advice says so first
TOLD: Final = {
    "fuel x 0.9": {"biased_rich"},
    "fuel x 1.1": {"biased_lean"},
    "rear voltage + 0.3 V": {"downstream_high"},
}
FIRST_VEHICLE, FIRST_SEED = 7100, 7_100_000
STEP_NS: Final = 100_000_000
LAMBDA, FUEL, AIR = "lambda_measured", "fuel_mass_mg", "air_mass_mg"


@dataclass(frozen=True, slots=True)
class Logged:
    """A drive as rows of a table."""

    t_s: FloatArray  # (n,)
    columns: dict[str, FloatArray]  # canonical name → (n,)

    def rows(self, chosen: IntArray) -> "Logged":
        return Logged(self.t_s[chosen], {k: v[chosen] for k, v in self.columns.items()})

    def with_(self, change: Callable[[FloatArray], FloatArray], *names: str) -> "Logged":
        some = {name: change(self.columns[name]) for name in names or tuple(self.columns)}
        return replace(self, columns=self.columns | some)


def held(rows: int) -> Callable[[FloatArray], FloatArray]:
    return lambda values: values[np.arange(len(values)) // rows * rows]


def late(rows: int) -> Callable[[FloatArray], FloatArray]:
    return lambda values: np.concatenate([np.full(rows, values[0]), values[:-rows]])


def hit(share: float, put: float) -> Callable[[FloatArray], FloatArray]:
    """Return a change of some cells, a share of them, to a value."""
    rng = np.random.default_rng(51)
    return lambda values: np.where(rng.random(len(values)) < share, put, values)


def lost(drive: Logged, share: float) -> Logged:
    kept = np.random.default_rng(52).random(len(drive.t_s)) >= share
    return drive.rows(np.flatnonzero(kept))


def at_resolution(drive: Logged, step_s: float) -> Logged:
    return replace(drive, t_s=np.floor(drive.t_s / step_s + 1e-9) * step_s)


def held_rounded_lost(drive: Logged) -> Logged:
    return lost(drive.with_(lambda v: np.round(held(3)(v), 2)), 0.02)


TABLES: Final[dict[str, Callable[[Logged], Logged]]] = {
    "as it is": lambda d: d,
    "2 rows a second": lambda d: d.rows(np.arange(0, len(d.t_s), 5)),
    "1 row a second": lambda d: d.rows(np.arange(0, len(d.t_s), 10)),
    "times to 0.5 s": lambda d: at_resolution(d, 0.5),
    "times to 1 s": lambda d: at_resolution(d, 1.0),
    "columns held 0.2 s": lambda d: d.with_(held(2)),
    "columns held 0.5 s": lambda d: d.with_(held(5)),
    "columns held 1 s": lambda d: d.with_(held(10)),
    "columns held 2 s": lambda d: d.with_(held(20)),
    "lambda held 1 s": lambda d: d.with_(held(10), LAMBDA),
    "fuel held 0.5 s": lambda d: d.with_(held(5), FUEL),
    "held 0.3 s, rounded to 0.01, 2 % lost": held_rounded_lost,
    "fuel and air 0.1 s late": lambda d: d.with_(late(1), FUEL, AIR),
    "fuel and air 0.2 s late": lambda d: d.with_(late(2), FUEL, AIR),
    "fuel and air 0.5 s late": lambda d: d.with_(late(5), FUEL, AIR),
    "lambda holds AFR": lambda d: d.with_(lambda v: 14.7 * v, LAMBDA),
    "lambda holds 1/lambda": lambda d: d.with_(lambda v: 1.0 / v, LAMBDA),
    "fuel x 0.9": lambda d: d.with_(lambda v: 0.9 * v, FUEL),
    "fuel x 1.1": lambda d: d.with_(lambda v: 1.1 * v, FUEL),
    "1 % spikes of lambda to its end": lambda d: d.with_(
        hit(0.01, plausible_range(LAMBDA)[1]), LAMBDA
    ),
    "1 % of cells blank": lambda d: d.with_(hit(0.01, np.nan)),
    "5 % of cells blank": lambda d: d.with_(hit(0.05, np.nan)),
}
BEHIND_TABLES: Final[dict[str, Callable[[Logged], Logged]]] = {
    "as it is": lambda d: d,
    "rear voltage + 0.3 V": lambda d: d.with_(lambda v: v + 0.3, "downstream_voltage_v"),
    "air flow in g/s": lambda d: d.with_(lambda v: v / 3.6, "maf_kg_h"),
}


def paused(f: FrameBlock, pauses: Sequence[tuple[float, float]]) -> FrameBlock:
    t_s, kept = (f.t_ns - f.t_ns[0]) / 1e9, np.ones(len(f.t_ns), dtype=bool)
    for begin_s, length_s in pauses:
        kept &= (t_s < begin_s) | (t_s >= begin_s + length_s)
    return chosen(f, np.flatnonzero(kept))


def each_minute(length_s: float) -> list[tuple[float, float]]:
    return [(40.0 + 60.0 * i, length_s) for i in range(9)]


def changed_only(f: FrameBlock) -> FrameBlock:
    kept = []
    for key in np.unique(f.key):
        own = np.flatnonzero(f.key == key)
        moved = (np.diff(f.data[own].astype(int), axis=0) != 0).any(axis=1)
        kept.append(own[np.concatenate([[True], moved])])
    return chosen(f, np.sort(np.concatenate(kept)))


def batched(f: FrameBlock, ends_s: FloatArray) -> FrameBlock:
    """Return the frames with the time at which the batch that holds each is delivered."""
    ends_ns = (ends_s * 1e9).astype(np.int64) + f.t_ns[0]
    t_ns = ends_ns[np.searchsorted(ends_ns, f.t_ns).clip(max=len(ends_ns) - 1)]
    return f._replace(t_ns=t_ns + np.arange(len(t_ns)) % 50 * 1000)


def random_ends() -> FloatArray:
    return np.cumsum(np.random.default_rng(53).uniform(0.01, 0.3, 6000))


def chance(f: FrameBlock, share: float) -> IntArray:
    return np.flatnonzero(np.random.default_rng(54).random(len(f.t_ns)) < share)


def jittered(f: FrameBlock, std_s: float) -> FrameBlock:
    moved = np.random.default_rng(55).normal(0.0, std_s * 1e9, len(f.t_ns)).astype(np.int64)
    return merge([f._replace(t_ns=f.t_ns + moved)])


def stepped(f: FrameBlock, step_s: float) -> FrameBlock:
    half = len(f.t_ns) // 2
    return f._replace(t_ns=f.t_ns + (np.arange(len(f.t_ns)) > half) * round(step_s * 1e9))


FRAMES: Final[dict[str, Callable[[FrameBlock], FrameBlock]]] = {
    "as it is": lambda f: f,
    "a pause of 3 s": lambda f: paused(f, [(300.0, 3.0)]),
    "a pause of 10 s": lambda f: paused(f, [(300.0, 10.0)]),
    "a pause of 59 s": lambda f: paused(f, [(300.0, 59.0)]),
    "3 s lost each minute": lambda f: paused(f, each_minute(3.0)),
    "10 s lost each minute": lambda f: paused(f, each_minute(10.0)),
    "only frames whose payload changed": changed_only,
    "each fifth frame kept": lambda f: chosen(f, np.arange(0, len(f.t_ns), 5)),
    "batches of up to 300 ms": lambda f: batched(f, random_ends()),
    "batches each 500 ms": lambda f: batched(f, np.arange(1, 1300) * 0.5),
    "2 % lost": lambda f: chosen(f, np.setdiff1d(np.arange(len(f.t_ns)), chance(f, 0.02))),
    "2 % sent twice": lambda f: chosen(f, np.sort(np.r_[np.arange(len(f.t_ns)), chance(f, 0.02)])),
    "times jittered by 10 ms": lambda f: jittered(f, 0.01),
    "the clock steps by 1 h": lambda f: stepped(f, 3600.0),
    "the clock steps back by 2 s": lambda f: stepped(f, -2.0),
}


def plan(n: int, *, behind: bool) -> Iterator[tuple[str, Experiment]]:
    """Yield the fault, "" for none, and the experiment of ``n`` healthy and ``n`` faulty drives."""
    for i in range(n):
        usual = Experiment(
            CYCLES[i % len(CYCLES)], FIRST_VEHICLE + i, FIRST_SEED + i,
            duration_s=600.0, downstream=behind,
        )  # fmt: skip
        yield "", usual
        usual = replace(usual, vehicle=usual.vehicle + n, seed=usual.seed + n)
        if behind:
            name = BEHIND[i % len(BEHIND)]
            yield name, replace(usual, downstream_fault=fault_behind(name))
        else:
            name = tuple(FAULTS)[i % len(FAULTS)]
            yield name, replace(usual, fault=faults.resolve(name, FAULTS[name]))


def sent(experiment: Experiment) -> list[ecu.Broadcast]:
    rng = np.random.default_rng([51, experiment.seed])
    return ecu.broadcast(simulate(experiment), ecu.own_bus(), rng, experiment.fault)


def write_table(path: Path, drive: Logged) -> None:
    header = ",".join(("time_s", *drive.columns))
    rows = np.column_stack([drive.t_s, *drive.columns.values()])
    np.savetxt(path, rows, "%.9g", ",", header=header, comments="")
    path.write_text(path.read_text().replace("nan", ""))


def as_table(messages: list[ecu.Broadcast]) -> Logged:
    block, names = (
        ecu.samples(messages, ecu.own_bus(), STEP_NS),
        ecu.names_of(messages, ecu.own_bus()),
    )
    return Logged(block.t_ns / 1e9, dict(zip(names, block.values.T, strict=True)))


class Tally:
    """What the drives of one imperfection gave."""

    def __init__(self, kind: str, name: str) -> None:
        self._about = {"log": kind, "imperfection": name}
        self._told = TOLD.get(name, set())
        self._codes: Counter[str] = Counter()
        self._why: Counter[str] = Counter()
        self._n = Counter[str]()

    def add(self, path: Path, fault: str, setup: replay.Setup) -> None:
        """Judge a log."""
        side = "faulty" if fault else "healthy"
        self._n[side] += 1
        try:
            entry, _ = replay.replay(path, setup)
        except O2Error as error:
            self._why[str(error).partition(": ")[2][:60]] += 1
            return
        codes = {dtc["fault"] for dtc in entry["dtcs"]}
        self._n[f"{side} with code"] += bool(codes)
        self._n[f"{side} misnamed"] += bool(codes - self._told)
        self._n[f"{side} judged"] += bool(codes) or entry["completed"]
        self._n["named"] += bool(fault) and any(
            fault in (dtc["fault"], *dtc.get("also", ())) for dtc in entry["dtcs"]
        )
        if not fault:
            self._codes.update(codes)
            self._why.update(
                Cause(**each).in_words[:60] for each in (entry["not_judged"] or [])[:1]
            )

    @property
    def row(self) -> dict[str, str | float | bool | None]:
        """Return the figures."""
        n = self._n
        return {
            **self._about,
            "healthy": n["healthy"], "with a code": n["healthy with code"],
            "false": n["healthy misnamed"], "judged": n["healthy judged"], "faulty": n["faulty"],
            "found": n["faulty with code"], "named": n["named"],
            "codes": " ".join(f"{k}:{v}" for k, v in self._codes.most_common()) or "none",
            "most said": next((k for k, _ in self._why.most_common(1)), "")[:60],
        }  # fmt: skip


def main(argv: Sequence[str]) -> int:
    """Judge every drive under every imperfection."""
    options = BenchmarkOptions(__name__, __doc__, drives=1, only="fuel and air 0.2 s")
    options.add_argument("--drives", type=int, default=40, help="healthy ones, and as many faulty")
    options.add_argument("--only", default="", metavar="TEXT", help="imperfections with this text")
    options.add_argument("--model", type=Path)
    args = options.parse_args(argv)
    setup = replay.set_up(args.model, [], load_config(None))
    tallies: dict[tuple[str, str], Tally] = {}
    with tempfile.TemporaryDirectory() as folder:
        for behind in (False, True):
            for number, (fault, experiment) in enumerate(plan(args.drives, behind=behind)):
                messages = sent(experiment)
                for kind, name, path in logs(messages, Path(folder), args.only, behind=behind):
                    tally = tallies.setdefault((kind, name), Tally(kind, name))
                    tally.add(path, fault, setup)
                say(f"drive {number + 1} of {2 * args.drives}: {experiment.name}")
    rows: list[Row] = [tally.row for tally in tallies.values()]
    missed = [
        f"{row['log']}, {row['imperfection']}: {row['false']} healthy drives have a false code"
        for row in rows
        if row["false"]
    ]
    return finish(args, rows, missed)


def logs(
    messages: list[ecu.Broadcast], folder: Path, only: str, *, behind: bool
) -> Iterator[tuple[str, str, Path]]:
    """Yield each imperfect log of a drive: its kind, the imperfection, the file."""
    kind, tables = ("rear table", BEHIND_TABLES) if behind else ("table", TABLES)
    drive = as_table(messages)
    for name, of_table in tables.items():
        if only in name:
            write_table(path := folder / "drive.csv", of_table(drive))
            yield kind, name, path
    encoded = ecu.frames(messages)
    for name, of_frames in FRAMES.items():
        if only in name and not behind:
            write_log(path := folder / "drive.log", of_frames(encoded))
            yield "frames", name, path
