"""The catalyst monitor beside five rules of the field, on drawn conditions and new vehicles.

    python benchmarks/catalyst_matrix.py [--drives 300] [--seconds 600] [--out rows.jsonl]
    python benchmarks/catalyst_matrix.py --report rows.jsonl

Every drive has a vehicle of its own, from 1001 on, with its own seed: driver, weather, noise. Drawn
are capacity, evidence (passive: no fuel cut; cut; active: fuel cuts and the ECU's own steps of
0.03), downstream sensor (sound, or aged: slow by 1.0 s on both edges), offset of the upstream
sensor (0, +0.02, -0.02 lambda) and ethanol (0 to 10 %). Every fifth drive has instead a wrong air
meter, injector or fuel (5 %) and no fault. The rules' limits are set on vehicles 3 to 16, by the
middle between 0.06 g and 0.25 g. All numbers are simulated.
"""

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.stats import beta

from benchmarks.catalyst import CYCLES, PERIOD_S, Case, drive, judged
from benchmarks.catalyst_rules import indices
from training.dyno import vehicle as vehicles

FIRST: Final = 1001
MODES: Final = ("passive", "cut", "active")
CAPACITIES_G: Final = (0.03, 0.06, 0.25, 0.4, None)
OFFSETS: Final = (0.0, 0.0, 0.0, 0.02, -0.02)
AGED_S, AGED_SHARE = 1.0, 0.3
WRONG: Final = (
    {"meter": 1.05},
    {"meter": 0.95},
    {"injector": 1.05},
    {"injector": 0.95},
    {"ethanol": 12.8},  # asks for 5 % more fuel
)
LEARNING: Final = (3, 4, 5, 11, 12, 13, 14, 15, 16)  # vehicles that set the rules' limits
RULES: Final = ("switches", "amplitude", "locus", "delay", "threshold")
Row = dict[str, Any]


def drawn(i: int) -> Case:
    """Return the case of drive i."""
    rng = np.random.default_rng([31, i])
    mode = MODES[i % len(MODES)]
    if i % 5 == 4:
        wrong: dict[str, float] = dict(WRONG[i // 5 % len(WRONG)])
        return Case("wrong", mode=mode, **wrong)  # type: ignore[arg-type]
    grams = CAPACITIES_G[rng.integers(len(CAPACITIES_G))]
    offset = OFFSETS[rng.integers(len(OFFSETS))]
    aged = rng.random() < AGED_SHARE
    return Case(
        "main",
        grams,
        sensor="downstream_slow_symmetric" if aged else "",
        sensor_severity=AGED_S if aged else None,
        upstream={1: "biased_lean", -1: "biased_rich"}.get(int(np.sign(offset)), ""),
        bias_lambda=abs(offset) or 0.02,
        ethanol=rng.uniform(0.0, 10.0),
        mode=mode,
    )


def row_of(vehicle: int, case: Case, seconds: float) -> Row:
    """Return one drive's truth and what monitor and rules say of it."""
    cycle = CYCLES[vehicle % len(CYCLES)]
    names, values, true_g = drive(vehicle, cycle, case, seconds)
    sign = {"biased_lean": 1.0, "biased_rich": -1.0}.get(case.upstream, 0.0)
    offset = sign * case.bias_lambda - vehicles.piece(vehicle).sensor_offset
    told = {
        "vehicle": vehicle,
        "cycle": cycle,
        "case": case.name,
        "mode": case.mode,
        "sensor_fault": case.sensor,
        "upstream": case.upstream,
        "ethanol": case.ethanol,
        "meter": case.meter,
        "injector": case.injector,
        "true_g": true_g,
        "true_offset": offset,
    }
    return told | judged(names, values) | dict(indices(names, values, PERIOD_S))


def limits(seconds: float) -> dict[str, float]:
    """Return each rule's limit, the middle between bad and sound catalysts in logarithms."""
    found: dict[float, list[Any]] = {0.06: [], 0.25: []}
    for vehicle in LEARNING:
        for grams, rows in found.items():
            names, values, _ = drive(
                vehicle, CYCLES[vehicle % 3], Case("rules", grams, ethanol=5.0), seconds
            )
            rows.append(indices(names, values, PERIOD_S))
    middle = {}
    for rule in RULES:
        bad, sound = (np.nanmedian([np.log(r[rule] + 1e-3) for r in found[g]]) for g in found)
        middle[rule] = float(np.exp(0.5 * (bad + sound)) - 1e-3)
    return middle


def main() -> None:
    """Judge the drives, write one line of JSON each, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--cpu-minutes", type=float, default=20.0, help="stop after so many")
    parser.add_argument("--out", type=Path, default=Path("catalyst_matrix.jsonl"))
    parser.add_argument("--report", type=Path)
    args = parser.parse_args()
    if args.report is None:
        with args.out.open("a") as file:
            file.write(json.dumps({"case": "limits", **limits(args.seconds)}) + "\n")
            for i in range(args.first, args.first + args.drives):
                if time.process_time() > 60.0 * args.cpu_minutes:
                    break
                file.write(json.dumps(row_of(FIRST + i, drawn(i), args.seconds)) + "\n")
                file.flush()
    lines = (args.report or args.out).read_text().splitlines()
    report([json.loads(line) for line in lines])


def exact(k: int, n: int) -> str:
    """Return k of n with the 95 % interval of Clopper and Pearson, in percent."""
    if not n:
        return "-"
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{k}/{n} [{100 * low:.1f}, {100 * high:.1f}] %"


def report(rows: Sequence[Row]) -> None:
    """Print the tables."""
    (limit, *_) = [row for row in rows if row["case"] == "limits"]
    main_rows = [row for row in rows if row["case"] == "main"]
    for title, of in (
        ("all", lambda r: True),
        *((mode, lambda r, m=mode: r["mode"] == m) for mode in MODES),
        ("aged sensor", lambda r: bool(r["sensor_fault"])),
        ("upstream offset", lambda r: bool(r["upstream"])),
        ("no other fault", lambda r: not r["sensor_fault"] and not r["upstream"]),
    ):
        verdicts(title, [row for row in main_rows if of(row)])
    estimates(main_rows)
    offsets(main_rows, [row for row in rows if row["case"] == "wrong"])
    rules(main_rows, limit)


def verdicts(title: str, rows: Sequence[Row]) -> None:
    """Print found, false pass and false alarm of the catalyst."""
    low = [row for row in rows if row["true_g"] <= 0.06]
    sound = [row for row in rows if row["true_g"] >= 0.25]
    times = [row["decided_s"] for row in rows if row["decided_s"] is not None]
    print(
        f"{title:<16} found {exact(sum(r['ever_failed'] for r in low), len(low))}, "
        f"false pass {exact(sum(r['ever_passed'] for r in low), len(low))}, "
        f"false {exact(sum(r['ever_failed'] for r in sound), len(sound))}, "
        f"passed {exact(sum(r['ever_passed'] for r in sound), len(sound))}, "
        f"open {sum(r['decided'] is None for r in rows)}, "
        f"median time {np.median(times) if times else np.nan:.0f} s"
    )


def estimates(rows: Sequence[Row]) -> None:
    """Print bias, spread and coverage of the capacity above 0.1 g."""
    for title, of in _groups():
        own = [r for r in rows if of(r) and r["true_g"] >= 0.1 and r["capacity_g"]]
        ratio = np.log([r["capacity_g"] / r["true_g"] for r in own])
        inside = sum(
            r["capacity_low_g"] <= r["true_g"] <= (r["capacity_high_g"] or np.inf) for r in own
        )
        print(
            f"capacity, {title:<16} bias {100 * np.expm1(ratio.mean()):+.0f} %, "
            f"spread {100 * ratio.std():.0f} %, covers {exact(inside, len(own))}"
        )


def _groups() -> list[tuple[str, Callable[[Row], bool]]]:
    return [
        ("no other fault", lambda r: not r["sensor_fault"] and not r["upstream"]),
        *((m, lambda r, m=m: r["mode"] == m and not r["sensor_fault"]) for m in MODES),
        ("aged sensor", lambda r: bool(r["sensor_fault"])),
        ("upstream offset", lambda r: bool(r["upstream"])),
    ]


def offsets(rows: Sequence[Row], wrong: Sequence[Row]) -> None:
    """Print what is said of the upstream sensor."""
    biased = [r for r in rows if r["upstream"]]
    named = sum(r["balance"] == r["upstream"] for r in biased)
    straight = [r for r in rows if not r["upstream"]]
    print(f"upstream offset 0.02 named within one drive: {exact(named, len(biased))}")
    for title, own in (("without an offset", straight), ("meter, injector, fuel wrong", wrong)):
        called = sum(r["balance"] is not None for r in own)
        print(f"called, {title}: {exact(called, len(own))}")
    for title, own in (("none", straight), ("0.02", biased), ("wrong", wrong)):
        error = np.array([r["upstream_offset_lambda"] - r["true_offset"] for r in own])
        std = np.array([r["upstream_offset_std"] for r in own])
        inside = int((np.abs(error) <= 1.645 * std).sum())
        print(
            f"offset {title}: bias {error.mean():+.4f}, spread {error.std():.4f}, "
            f"standard error {np.median(std):.4f} (median), 90 % covers {exact(inside, len(own))}"
        )
    for title, is_aged in (("aged", True), ("sound", False)):
        own = [r for r in rows if bool(r["sensor_fault"]) is is_aged]
        called = sum(bool(r["sensor"]) for r in own)
        print(f"{title} downstream sensor called faulty: {exact(called, len(own))}")


def rules(rows: Sequence[Row], limit: Row) -> None:
    """Print the rules of the field on the same drives, and what no limit could do better."""
    for rule in RULES:
        low = [r[rule] for r in rows if r["true_g"] <= 0.06 and np.isfinite(r[rule])]
        sound = [r[rule] for r in rows if r["true_g"] >= 0.25 and np.isfinite(r[rule])]
        missing = sum(not np.isfinite(r[rule]) for r in rows)
        found = sum(value > limit[rule] for value in low)
        false = sum(value > limit[rule] for value in sound)
        area = np.mean([[a > b for b in sound] for a in low]) if low and sound else np.nan
        print(
            f"{rule:<10} limit {limit[rule]:.3g}: found {exact(found, len(low))}, "
            f"false {exact(false, len(sound))}, area under the curve {area:.3f}, "
            f"nothing to look at {missing}"
        )


if __name__ == "__main__":
    main()
