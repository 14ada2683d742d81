"""Reads recorded answers of the diagnostic server by its ODX description, with odxtools.

    python benchmarks/odx_answers.py [--count 100000] [--seed 1]

Requests are drawn for every described service, and the state of the monitor is drawn anew after all
of them. It exits with 1 if an answer is not read, or not by exactly one service.
"""

import argparse
import random
import sys
import time
from collections import Counter

import repository  # noqa: F401
from odxtools.exceptions import OdxError

from monitor.bus.diagnostics.answer import answer
from tests.helpers.odx_reader import drawn_vehicle, read, requests


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    draw, layer = random.Random(args.seed), read()
    counts: Counter[str] = Counter()
    began_s = time.perf_counter()
    while counts["answers"] < args.count:
        vehicle = drawn_vehicle(draw)
        for request in requests(layer, draw):
            answered = answer(request, False, vehicle.state)
            if answered is None:
                continue
            counts["answers"] += 1
            counts["refused"] += answered[0] == 0x7F
            try:
                n_read = len(layer.decode_response(answered, request))
            except OdxError as error:
                n_read = 0
                print(f"{request.hex(' ')} -> {answered.hex(' ')}: {error}")
            counts["not read"] += n_read != 1
    seconds = time.perf_counter() - began_s
    print(
        f"{counts['answers']} answers of {len(layer.services)} services, {counts['refused']} of "
        f"them negative: {counts['not read']} not read, {seconds:.0f} s"
    )
    return int(counts["not read"] > 0)


if __name__ == "__main__":
    sys.exit(main())
