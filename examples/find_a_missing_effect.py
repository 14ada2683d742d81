"""Find the effect that a model lacks: a chain learns a vehicle, then fuel wets its walls.

    python examples/find_a_missing_effect.py

All drives are simulated. The dynamometer's wall film and the workflow's are separate codes.
"""

import tempfile
from pathlib import Path

from training import GapOptions, find_gap, fit
from training.cli import main as o2train

EFFECT = "wall_film=2"


def drives(folder: Path, first_seed: int, *options: str) -> list[Path]:
    """Drive the simulated vehicle four times and return the tables."""
    for seed in range(first_seed, first_seed + 4):
        what = ["--vehicle", "31", "--cycle", "micro_trips", "--seed", str(seed)]
        o2train(["simulate", "--out", str(folder), "--format", "parquet", *what, *options])
    return sorted(folder.glob("*.parquet"))


def main() -> None:
    """Fit, change the vehicle, find the gap, print verdict and figures."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        healthy = drives(folder / "before", 1)
        changed = drives(folder / "after", 11, "--effect", EFFECT)
        fit(healthy, folder / "chain.onnx", kind="greybox")
        gap = find_gap(
            folder / "chain.onnx",
            changed,
            folder / "gap",
            healthy=healthy,
            options=GapOptions(sensor_known_good=True),
        )
        found = gap.to_dict()
        print(f"{gap.verdict}: {', '.join(gap.effects) or '-'} (put in: {EFFECT})")
        for name in (
            "rmse_before",
            "rmse_after",
            "noise_floor",
            "detection_before",
            "detection_after",
        ):
            print(f"  {name:17} {found[name]}")
        print(f"  new model: {gap.model.name if gap.model else 'none'}")


if __name__ == "__main__":
    main()
