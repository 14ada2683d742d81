"""Effects hidden in real recordings without fuel and air: are they reported and described?

A gasoline engine on a test bench (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0), twelve runs
of 20 minutes; lambda is taken as 1 + 0.064 (z + 0.065). Nine effects are computed from recorded
signals and put on the measured phi of five runs; seven other runs are healthy. Those that are added
have the given size, RMS over the five runs, in healthy errors (the robust spread of the runs that
were left out in turn). Twelve nulls hold five runs as they are against the other seven: four
divisions of the runs times three outputs.

    python benchmarks/gap_bosch.py [FOLDER] [--size 2] [--nulls 12] [--outputs NAME ...]
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from monitor.base.types import FloatArray
from training.gap.response.difference import Difference, References, difference_of
from training.gap.response.regressors import lagged
from training.greybox.fit.comparison import Comparison
from training.recordings.recording import Recording, load

RUNS: Final = (10, 11, 12, 13, 14, 15, 30, 31, 32, 33, 53, 54)
NEW: Final = (
    (11, 13, 31, 33, 54),
    (10, 12, 30, 32, 53),
    (11, 14, 15, 32, 54),
    (13, 15, 30, 33, 53),
)
INPUTS: Final = ("speed_z", "load_z", "ignition_angle_z", "fuel_cutoff_z")
OUTPUTS: Final = ("lambda_z", "nox_z", "t_exh_manifold_z")
PERIOD_S: Final = 0.1
CUT_PHI, BEFORE, AFTER, WASHOUT = 0.6, 6, 11, 50  # phi and samples about a fuel cut
RIPPLE_Z, FILM_S, TAIL_S, LAG_S, GAIN, FROM = 1.0, 1.5, 3.0, 0.6, 0.7, 4
Columns = dict[str, FloatArray]


def delayed(phi: FloatArray, delay_s: FloatArray) -> FloatArray:
    """Return phi (n,) later by ``delay_s`` (n,)."""
    t = np.arange(len(phi)) * PERIOD_S
    return np.interp(t - delay_s, t, phi)


# signals, phi, number of the run from 1 → what is added to phi, of any size
ADDED: Final[dict[str, Callable[[Columns, FloatArray, int], FloatArray]]] = {
    "ripple over speed": lambda x, _phi, _n: np.sin(2 * np.pi * x["speed_z"] / RIPPLE_Z),
    "offset with load": lambda x, _phi, _n: x["load_z"],
    "film-like lag": lambda x, _phi, _n: lagged(x["load_z"], FILM_S, PERIOD_S) - x["load_z"],
    "tail after fuel cut": lambda x, _phi, _n: (
        -lagged((x["fuel_cutoff_z"] > 0).astype(float), TAIL_S, PERIOD_S)
    ),
    "drift with exhaust temperature": lambda x, _phi, _n: x["t_exh_manifold_z"],
    "offset from run 4 on": lambda x, phi, n: np.full(len(phi), float(n >= FROM)),
}
# the reading itself is changed; the size is fixed
CHANGED: Final[dict[str, Callable[[Columns, FloatArray], FloatArray]]] = {
    "lag 0.6 s": lambda x, phi: lagged(phi, LAG_S, PERIOD_S),
    "gain 0.7": lambda x, phi: 1.0 + GAIN * (phi - 1.0),
    "delay with load": lambda x, phi: delayed(phi, np.clip(0.5 - 0.3 * x["load_z"], 0.0, 1.5)),
}


# kinds and driver of the finding that says what was hidden
SAYS: Final[dict[str, tuple[tuple[str, ...], str]]] = {
    "ripple over speed": (("level",), "speed_z"),
    "offset with load": (("level",), "load_z"),
    "film-like lag": (("dynamic",), "load_z"),
    "tail after fuel cut": (("dynamic", "level"), "fuel_cutoff_z"),
    "drift with exhaust temperature": (("level",), "t_exh_manifold_z"),
    "offset from run 4 on": (("begins",), ""),
    "delay with load": (("timing with",), "load_z"),
}


def described(effect: str, found: Difference) -> bool:
    """Return whether the best finding says what was hidden: kind and driver, or the constants."""
    best, response = found.best, found.response
    if best is None:
        return False
    if effect in SAYS:
        kinds, driver = SAYS[effect]
        return best.kind in kinds and best.driver == driver
    if response is None:
        return False
    if effect == "lag 0.6 s":
        return 0.3 <= response.lag_s + response.delay_s <= 1.0
    return 0.5 <= response.gain <= 0.85


def run_of(recording: Recording, output: str, phi: FloatArray | None = None) -> Comparison:
    """Return a run; the model's reading is not used."""
    columns = {n: recording.column(n) for n in recording.names if n != output}
    measured = phi_of(recording) if output == "lambda_z" else recording.column(output)
    measured = measured if phi is None else phi
    scored = np.ones(len(measured), dtype=bool)
    if output == "lambda_z":
        cut = measured < CUT_PHI
        scored &= ~(np.convolve(cut, np.ones(AFTER))[: len(cut)] > 0)
        scored &= ~(np.convolve(cut[::-1], np.ones(BEFORE))[: len(cut)][::-1] > 0)
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
    return 1.0 / (1.0 + 0.064 * (recording.column("lambda_z") + 0.065))


def learn(recordings: list[Recording], output: str) -> References:
    """Return what healthy runs say of an output."""
    inputs = [*INPUTS, *(["lambda_z"] if output != "lambda_z" else [])]
    return References.learn([run_of(r, output) for r in recordings], inputs)


def hidden(effect: str, recordings: list[Recording], size: float) -> list[FloatArray]:
    """Return phi of every run with the effect in it; ``size`` is the RMS of an added one."""
    phi = [phi_of(r) for r in recordings]
    columns = [{n: r.column(n) for n in r.names} for r in recordings]
    if effect in CHANGED:
        return [CHANGED[effect](x, p) for x, p in zip(columns, phi, strict=True)]
    made = [ADDED[effect](x, p, n) for n, (x, p) in enumerate(zip(columns, phi, strict=True), 1)]
    burning = [p >= CUT_PHI for p in phi]
    rms = np.sqrt(np.mean(np.concatenate([e[b] for e, b in zip(made, burning, strict=True)]) ** 2))
    return [p + b * e * size / rms for p, b, e in zip(phi, burning, made, strict=True)]


def report(name: str, found: Difference, right: str, began_s: float) -> None:
    """Print one row."""
    best = found.findings[0]
    print(
        f"| {name} | {'reported' if found.best else 'no gap'} | {right} | {best.p_value:.2g} | "
        f"{best.kind} {best.driver} | {best.sentence if found.best else ''} | "
        f"{time.process_time() - began_s:.0f} |",
        flush=True,
    )


def main() -> None:
    """Print a table, one row per effect and null."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("../shared/data"))
    parser.add_argument("--size", type=float, default=2.0)
    parser.add_argument("--outputs", nargs="+", default=OUTPUTS, help="of the nulls")
    parser.add_argument("--nulls", type=int, default=12, metavar="N")
    args = parser.parse_args()
    runs = {n: load(args.folder / "bosch_gengine1" / f"run_{n:06d}.csv.gz") for n in RUNS}
    print("| hidden | verdict | described | p of the best | kind, driver | sentence | CPU s |")
    print("|---|---|---|---|---|---|---|")
    reported = right = wrong = nulls = 0
    for group in NEW:
        new, healthy = [runs[n] for n in group], [r for n, r in runs.items() if n not in group]
        for output in args.outputs:
            if nulls == args.nulls:
                break
            began_s = time.process_time()
            known = learn(healthy, output)
            found = difference_of([run_of(r, output) for r in new], known)
            nulls += 1
            wrong += found.best is not None
            report(f"none, {output}, {group}", found, "", began_s)
            if group != NEW[0] or output != "lambda_z":
                continue
            spread = np.median(
                np.abs(np.concatenate([r.residual[r.scored] for r in known.each[0].healthy]))
            )
            for effect in (*ADDED, *CHANGED):
                began_s = time.process_time()
                phi = hidden(effect, new, args.size * 1.4826 * float(spread))
                changed = [run_of(r, output, p) for r, p in zip(new, phi, strict=True)]
                found = difference_of(changed, known)
                reported += found.best is not None
                right += described(effect, found)
                report(effect, found, "yes" if described(effect, found) else "no", began_s)
    if "lambda_z" in args.outputs:
        print(f"{reported} of {len(ADDED) + len(CHANGED)} reported, {right} described")
    print(f"{wrong} of {nulls} nulls reported")


if __name__ == "__main__":
    main()
