"""Free run of four outputs on real recordings of a Bosch engine, compared with the best ARX.

Training uses runs 10 to 15 and 30 to 33 and the test runs 53 and 54, unless other ones are named;
10 Hz, all channels z-scored by their authors (boschresearch/Bosch-Engine-Datasets, CC BY-SA 4.0).
``fit`` runs with its defaults. The last 40 % of the training runs choose the orders of the ARX,
which is then fitted to all of them. Figures are fits in percent, of each test run and of all, on
all samples and without fuel cut and the seconds after it.

    python benchmarks/bosch_outputs.py FOLDER [--budget MINUTES] [--outputs NAME ...] [--split]
        [--train RUN ...] [--test RUN ...] [--seed N] [--threads N]
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from monitor.model.step import Model
from training.narx.fit import fit
from training.narx.linear.arx import choose_arx, fit_arx
from training.narx.network import describe
from training.recordings import metrics
from training.recordings.recording import Recording, load
from training.studies.evaluation import predict

OUTPUTS = ("o2_z", "t_exh_manifold_z", "nox_z", "lambda_z")
INPUTS = ("speed_z", "load_z", "lambda_z", "ignition_angle_z", "fuel_cutoff_z")
TRAIN, TEST = (10, 11, 12, 13, 14, 15, 30, 31, 32, 33), (53, 54)
CHOOSING_SHARE = 0.4  # of the training runs, the last ones choose the orders of the ARX
WASHOUT = 60  # samples that drive both models with the measured output
RECOVERY_S = 5.0  # after fuel cut
PERIOD_S = 0.1


def fuel_cut(recording: Recording) -> np.ndarray:
    """Return (n,) bool: fuel cut or its recovery; the channel has two values, no cut is below."""
    cut = recording.column("fuel_cutoff_z") > 0.0
    reach = round(RECOVERY_S / PERIOD_S)
    return np.convolve(cut, np.ones(reach + 1))[: len(cut)] > 0


def stretches(
    recordings: Sequence[Recording], inputs: Sequence[str], output: str
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return inputs (n, k) and output (n,) of every recording."""
    return [(np.stack([r.column(n) for n in inputs], 1), r.column(output)) for r in recordings]


def fits(pairs: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> str:
    """Return the fits of (measured, simulated, rows): each, then all together."""
    parts = [(a[rows], b[rows]) for a, b, rows in pairs]
    together = tuple(np.concatenate(column) for column in zip(*parts, strict=True))
    values = [metrics.fit_percent(a, b) for a, b in (*parts, together)]
    return " / ".join(f"{v:.1f}" for v in values)


def main() -> None:
    """Print a table, one row per output."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--budget", type=float, default=10.0, metavar="MINUTES")
    parser.add_argument("--outputs", nargs="+", default=OUTPUTS)
    parser.add_argument("--train", nargs="+", type=int, default=TRAIN, metavar="RUN")
    parser.add_argument("--test", nargs="+", type=int, default=TEST, metavar="RUN")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument(
        "--split", action="store_true", help="the last training runs validate the network too"
    )
    args = parser.parse_args()
    train, test = (
        [load(args.folder / f"run_{n:06d}.csv.gz") for n in group]
        for group in (args.train, args.test)
    )
    cut = len(train) - int(CHOOSING_SHARE * len(train))
    first, second = train[:cut], train[cut:]
    print(f"fits of runs {' / '.join(map(str, args.test))} / all in percent, free run")
    print("| output | all: NARX | ARX | no fuel cut: NARX | ARX | seconds | shape |")
    print("|---|---|---|---|---|---|---|")
    for output in args.outputs:
        inputs = [name for name in INPUTS if name != output]
        chosen = choose_arx(stretches(first, inputs, output), stretches(second, inputs, output))
        everything = stretches(train, inputs, output)
        arx = fit_arx(everything, len(chosen.a), chosen.b.shape[1], chosen.delays)
        with tempfile.TemporaryDirectory() as folder:
            training, judges = (first, second) if args.split else (train, [])
            result = fit(
                training,
                inputs,
                output,
                Path(folder) / "model.onnx",
                validate=judges,
                budget_minutes=args.budget,
                seed=args.seed,
                threads=args.threads,
            )
            model = Model.load(result.path)
            narx = [predict(model, r, max(WASHOUT, model.card.lags))[:2] for r in test]
        columns = []
        for masked in (False, True):
            rows = [np.arange(len(r.values)) >= WASHOUT for r in test]
            if masked:
                rows = [on & ~fuel_cut(r) for on, r in zip(rows, test, strict=True)]
            linear = [arx.simulate(u, y[:WASHOUT]) for u, y in stretches(test, inputs, output)]
            columns.append(fits([(*pair, on) for pair, on in zip(narx, rows, strict=True)]))
            columns.append(
                fits([(p[0], free, on) for p, free, on in zip(narx, linear, rows, strict=True)])
            )
        print(
            f"| {output} | {' | '.join(columns)} | {result.seconds:.0f} | "
            f"{describe(result.network.spec)}, {result.network.spec.n_weights} weights |",
            flush=True,
        )
        for warning in result.warnings:
            print(f"<!-- {output}: {warning} -->", flush=True)


if __name__ == "__main__":
    main()
