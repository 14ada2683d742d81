"""The first verdict: judge a healthy and a faulty drive and show how the evidence grew.

    python examples/first_verdict.py [RECORDING …]

Without recordings it takes two simulated drives from ``replay_logs``.
"""

import sys
from pathlib import Path

from monitor import replay

LOGS = Path(__file__).parent.parent / "replay_logs"
DRIVES = [
    LOGS / "healthy_micro_trips_v102_s102.blf",
    LOGS / "slow_symmetric_micro_trips_v105_s107.blf",
]


def main(drives: list[Path]) -> None:
    """Print the verdict on each drive, with its windows and evidence."""
    for drive in drives:
        verdict = replay(drive, series=True)
        print(verdict)
        for code in verdict.codes:
            print(f"  {code.code} {code.fault}: {100 * code.probability:.0f} % among its names")
        for fault, evidence in verdict.evidence.items():
            print(f"  {fault:20} log odds {evidence.log_odds:7.1f}, {evidence.needed:.1f} decide")
        frame = verdict.to_polars()
        residual = (frame["measured"] - frame["predicted"]).filter(frame["enabled"])
        print(
            f"  residual {residual.mean():+.4f} ± {residual.std():.4f} in {len(residual)} samples"
        )


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]] or DRIVES)
