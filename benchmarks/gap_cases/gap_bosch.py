"""Effects hidden in real recordings without fuel and air: are they reported and described?

A gasoline engine on a test bench (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0), twelve runs
of 20 minutes; lambda is taken as 1 + 0.064 (z + 0.065), and fuel cut by its flag, as the workflow
does. Nine effects are computed from recorded signals and put on the measured phi of five runs;
seven other runs are healthy. Those that are added have the given size, RMS over the five runs, in
healthy errors (the robust spread of the runs that were left out in turn). Twelve nulls hold five
runs as they are against the other seven: four divisions of the runs times three outputs.
``--seeds`` draws other divisions, signals and constants, nine effects per seed.

python -m benchmarks gap_bosch [FOLDER] [--size 2] [--nulls 12] [--outputs NAME ...]
    [--seeds N ...]
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from benchmarks.outcome import BenchmarkOptions, Row, finish, say
from benchmarks.verdicts.bosch import LAMBDA_PER_Z, RUNS, STOICHIOMETRIC_Z, run_of
from monitor.base.types import BoolArray, FloatArray
from training.gap.response.account import ResponseAccount
from training.gap.response.difference import Difference, Finding, difference_of
from training.gap.response.reference import ResponseReference
from training.greybox.fit.drive import Comparison
from training.greybox.quantity.dynamics import lag
from training.recordings.recording import Recording

NEW: Final = (
    (11, 13, 31, 33, 54),
    (10, 12, 30, 32, 53),
    (11, 14, 15, 32, 54),
    (13, 15, 30, 33, 53),
)
INPUTS: Final = ("speed_z", "load_z", "ignition_angle_z", "fuel_cut")
CUT: Final = "fuel_cutoff_z"
OUTPUTS: Final = ("lambda_z", "nox_z", "t_exh_manifold_z")
PERIOD_S: Final = 0.1
AFTER_CUT, WASHOUT = 20, 50  # samples that are not scored
Columns = dict[str, FloatArray]


class HiddenEffect(NamedTuple):
    """What is hidden, and whether the answer says so."""

    name: str
    make: Callable[[Columns, FloatArray, int], FloatArray]  # of signals, phi, the run's number
    says: Callable[[Finding, ResponseAccount | None], bool]  # of the best finding and its constants
    added: bool = True  # to phi, in the given size; otherwise ``make`` returns the whole reading


def finding(kind: str, driver: str = "") -> Callable[[Finding, object], bool]:
    """Return what asks for a finding of the kind, with the driver."""
    return lambda best, _: (best.kind, best.driver) == (kind, driver)


def ripple(driver: str, length: float) -> HiddenEffect:
    """Return a sine over a signal."""

    def make(x: Columns, _phi: FloatArray, _n: int) -> FloatArray:
        return np.asarray(np.sin(2 * np.pi * x[driver] / length))

    return HiddenEffect(f"ripple of {length:.1f} over {driver}", make, finding("level", driver))


def offset(driver: str) -> HiddenEffect:
    """Return an offset in proportion to a signal."""
    return HiddenEffect(
        f"offset with {driver}", lambda x, _phi, _n: x[driver], finding("level", driver)
    )


def film(driver: str, lag_s: float) -> HiddenEffect:
    """Return what a lag leaves of a signal."""

    def make(x: Columns, _phi: FloatArray, _n: int) -> FloatArray:
        return lag(x[driver], lag_s, PERIOD_S) - x[driver]

    return HiddenEffect(f"film of {lag_s:.1f} s, {driver}", make, finding("dynamic", driver))


def tail(lag_s: float) -> HiddenEffect:
    """Return a lean tail after fuel cuts."""

    def make(x: Columns, _phi: FloatArray, _n: int) -> FloatArray:
        return -lag((x[CUT] > 0).astype(np.float64), lag_s, PERIOD_S)

    return HiddenEffect(f"tail of {lag_s:.1f} s", make, finding("level", "after_fuel_cut_s"))


def later(first: int) -> HiddenEffect:
    """Return an offset that begins with a run."""

    def make(_x: Columns, phi: FloatArray, n: int) -> FloatArray:
        return np.full(len(phi), float(n >= first))

    return HiddenEffect(f"offset from run {first} on", make, finding("begins"))


def slow(lag_s: float) -> HiddenEffect:
    """Return a lag of the reading; delay and lag together say it within a factor."""

    def make(_x: Columns, phi: FloatArray, _n: int) -> FloatArray:
        return lag(phi, lag_s, PERIOD_S)

    def says(_best: Finding, response: ResponseAccount | None) -> bool:
        return response is not None and 0.5 <= (response.lag_s + response.delay_s) / lag_s <= 1.7

    return HiddenEffect(f"lag {lag_s:.1f} s", make, says, added=False)


def scaled(gain: float) -> HiddenEffect:
    """Return a gain of the reading."""

    def make(_x: Columns, phi: FloatArray, _n: int) -> FloatArray:
        return 1.0 + gain * (phi - 1.0)

    def says(_best: Finding, response: ResponseAccount | None) -> bool:
        return response is not None and abs(response.gain - gain) <= 0.15

    return HiddenEffect(f"gain {gain:.2f}", make, says, added=False)


def late(driver: str, slope_s: float) -> HiddenEffect:
    """Return a delay that changes with a signal."""

    def make(x: Columns, phi: FloatArray, _n: int) -> FloatArray:
        t = np.arange(len(phi)) * PERIOD_S
        return np.interp(t - np.clip(0.5 + slope_s * x[driver], 0.0, 1.5), t, phi)

    return HiddenEffect(f"delay with {driver}", make, finding("timing with", driver), added=False)


NINE: Final = (
    *(ripple("speed_z", 1.0), offset("load_z"), film("load_z", 1.5), tail(3.0)),
    *(offset("t_exh_manifold_z"), later(4), slow(0.6), scaled(0.7), late("load_z", -0.3)),
)


def drawn(rng: np.random.Generator) -> tuple[HiddenEffect, ...]:
    """Return nine of the same kinds with other signals and constants."""
    speed_or_load = ("speed_z", "load_z")
    return (
        ripple(str(rng.choice(speed_or_load)), rng.uniform(0.7, 1.6)),
        offset(str(rng.choice(INPUTS[:3]))),
        film(str(rng.choice(speed_or_load)), rng.uniform(1.0, 4.0)),
        tail(rng.uniform(2.0, 8.0)),
        offset(str(rng.choice(("t_exh_manifold_z", "t_cat1_z")))),
        later(int(rng.integers(2, 5))),
        slow(rng.uniform(0.4, 1.2)),
        scaled(rng.uniform(0.55, 0.8)),
        late(str(rng.choice(speed_or_load)), rng.choice((-0.3, 0.3))),
    )


def compared(recording: Recording, output: str, phi: FloatArray | None = None) -> Comparison:
    """Return a run; the model's reading is not used."""
    columns = {n: recording.column(n) for n in recording.names if n not in (output, CUT)}
    columns["fuel_cut"] = in_cut(recording).astype(np.float64)
    measured = phi_of(recording) if output == "lambda_z" else recording.column(output)
    measured = measured if phi is None else phi
    scored = np.ones(len(measured), dtype=bool)
    if output == "lambda_z":
        scored &= np.convolve(in_cut(recording), np.ones(AFTER_CUT + 1))[: len(scored)] == 0
    scored[:WASHOUT] = False
    return Comparison(
        name=recording.path.name,
        period_s=PERIOD_S,
        signals=columns,
        phi_measured=measured,
        phi_predicted=np.zeros(len(measured)),
        scored=scored,
    )


def phi_of(recording: Recording) -> FloatArray:
    """Return phi (n,) of a run."""
    return 1.0 / (1.0 + LAMBDA_PER_Z * (recording.column("lambda_z") - STOICHIOMETRIC_Z))


def in_cut(recording: Recording) -> BoolArray:
    """Return where fuel is cut (n,); the sensor reads its limit there, phi = 0.667."""
    return np.asarray(recording.column(CUT) > 0)


def learn(recordings: list[Recording], output: str) -> ResponseReference:
    """Return what healthy runs say of an output."""
    inputs = [*INPUTS, *(["lambda_z"] if output != "lambda_z" else [])]
    return ResponseReference.learn([compared(r, output) for r in recordings], inputs)


def hidden(effect: HiddenEffect, recordings: list[Recording], size: float) -> list[FloatArray]:
    """Return phi of every run with the effect in it; ``size`` is the RMS of an added one."""
    phi = [phi_of(r) for r in recordings]
    columns = [{n: r.column(n) for n in r.names} for r in recordings]
    made = [effect.make(x, p, n) for n, (x, p) in enumerate(zip(columns, phi, strict=True), 1)]
    if not effect.added:
        return made
    burning = [~in_cut(r) for r in recordings]
    rms = np.sqrt(np.mean(np.concatenate([e[b] for e, b in zip(made, burning, strict=True)]) ** 2))
    return [p + b * e * size / rms for p, b, e in zip(phi, burning, made, strict=True)]


def row_of(name: str, found: Difference, right: bool | None, began_s: float) -> Row:
    """Return the row of one question."""
    best, cpu_s = found.findings[0], time.process_time() - began_s
    say(f"{name}: {best.sentence if found.best else 'no gap'}, {cpu_s:.0f} s")
    return {
        "hidden": name,
        "reported": found.best is not None,
        "described": right,
        "p of the best": float(best.p_value),
        "kind, driver": f"{best.kind} {best.driver}",
        "cpu_s": cpu_s,
    }


def main(argv: Sequence[str]) -> int:
    """Ask for effects and nulls, and count."""
    options = BenchmarkOptions(__name__, __doc__, outputs=["lambda_z"], nulls=1, effects=1)
    options.add_argument("folder", nargs="?", type=Path, default=Path("../shared/data"))
    options.add_argument("--size", type=float, default=2.0)
    options.add_argument("--outputs", nargs="+", default=OUTPUTS, help="of the nulls")
    options.add_argument("--nulls", type=int, default=12, metavar="N")
    options.add_argument("--seeds", nargs="+", type=int, help="of other divisions and effects")
    options.add_argument("--effects", type=int, help="only the first so many of each division")
    args = options.parse_args(argv)
    runs = {n: run_of(args.folder, 1, n) for n in RUNS[1][: 5 if args.smallest else None]}
    sets = [(NEW[0], NINE), *((group, ()) for group in NEW[1:])]
    if args.seeds:
        rngs = [np.random.default_rng(seed) for seed in args.seeds]
        sets = [(sorted(g.choice(RUNS[1], 5, replace=False).tolist()), drawn(g)) for g in rngs]
    nulls, answers = list[Row](), list[Row]()
    for group, effects in sets:
        new, healthy = ([r for n, r in runs.items() if (n in group) is w] for w in (True, False))
        for output in args.outputs:
            if len(nulls) == args.nulls:
                break
            began_s = time.process_time()
            known = learn(healthy, output)
            found = difference_of([compared(r, output) for r in new], known)
            nulls.append(row_of(f"none, {output}, {group}", found, None, began_s))
            if output != "lambda_z":
                continue
            errors = [r.residual[r.scored] for r in known.healthy]
            spread = 1.4826 * float(np.median(np.abs(np.concatenate(errors))))
            for effect in effects[: args.effects]:
                began_s = time.process_time()
                phi = hidden(effect, new, args.size * spread)
                changed = [compared(r, output, p) for r, p in zip(new, phi, strict=True)]
                found = difference_of(changed, known)
                right = found.best is not None and effect.says(found.best, found.response)
                answers.append(row_of(effect.name, found, right, began_s))
    counts: Row = {
        "effects": len(answers),
        "reported": sum(bool(row["reported"]) for row in answers),
        "described": sum(bool(row["described"]) for row in answers),
        "nulls": len(nulls),
        "nulls reported": sum(bool(row["reported"]) for row in nulls),
    }
    return finish(args, [*answers, *nulls, counts])
