"""Driving cycles and their moments are the same however a recording is cut into blocks."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from monitor.base import config
from monitor.base.types import Quality, SampleBlock
from monitor.memory.cycles import SIGNALS, Cycles
from tests.helpers.examples import inputs

CONFIG = config.load()
NAMES = ("lambda_measured", *SIGNALS)
# speed, vehicle speed, coolant, ambient, pressure; quality of all of them
KINDS = {
    "town": ((2000.0, 50.0, 85.0, 20.0, 100.0), Quality.GOOD),
    "cold": ((1500.0, 45.0, 15.0, 20.0, 100.0), Quality.GOOD),
    "idle": ((800.0, 0.0, 60.0, 20.0, 100.0), Quality.GOOD),
    "frost": ((2000.0, 50.0, 80.0, -12.0, 100.0), Quality.GOOD),
    "pass": ((2000.0, 50.0, 90.0, 5.0, 70.0), Quality.GOOD),
    "stand": ((0.0, 0.0, 85.0, 20.0, 100.0), Quality.GOOD),
    "silent": ((np.nan,) * 5, Quality.STALE),
    "invalid": ((np.nan,) * 5, Quality.INVALID),
    "off the bus": ((np.nan,) * 5, Quality.OFF_BUS),
    "no coolant": ((2000.0, 60.0, np.nan, 20.0, 100.0), Quality.GOOD),
}


@st.composite
def recordings(draw: st.DrawFn) -> SampleBlock:
    parts, quality, steps_ns = [np.empty((0, 6))], [np.empty((0, 6), np.uint8)], [np.empty(0)]
    for _ in range(draw(st.integers(0, 12))):
        values, grade = KINDS[draw(st.sampled_from(sorted(KINDS)))]
        n = draw(st.sampled_from([1, 1, 3, 9, 30, 400]))
        parts.append(np.tile((np.nan if grade else 1.0, *values), (n, 1)))
        quality.append(np.full((n, 6), grade, dtype=np.uint8))
        own_ns = np.full(n, draw(st.sampled_from([1e9, 1e9, 0.3e9, 0.1e9])))
        own_ns[0] *= draw(st.sampled_from([1.0, 1.0, 0.0, -50.0, 320.0]))
        steps_ns.append(own_ns)
    t_ns = 7_000_000_000 + np.cumsum(np.concatenate(steps_ns)).astype(np.int64)
    return SampleBlock(np.arange(len(t_ns)), t_ns, np.concatenate(parts), np.concatenate(quality))


@inputs(60)
@given(
    block=recordings(),
    missing=st.sets(st.sampled_from(SIGNALS), max_size=2),
    cuts=st.lists(st.integers(0, 400), max_size=30),
)
def test_the_moments_and_the_driving_do_not_depend_on_where_blocks_begin(
    block: SampleBlock, missing: set[str], cuts: list[int]
) -> None:
    kept = [i for i, name in enumerate(NAMES) if name not in missing]
    names, n = [NAMES[i] for i in kept], len(block.t_ns)
    block = block._replace(values=block.values[:, kept], quality=block.quality[:, kept])

    def found(edges: list[int]) -> tuple[list[object], list[object]]:
        cycles = Cycles(CONFIG.cycles, CONFIG.profile, names, "lambda_measured", 500.0)
        moments: list[object] = []
        driven: list[object] = []
        for begin, end in pairwise(edges):
            part = cycles.push(block.part(begin, end))
            moments += [(begin + k, moment) for k, moment in part.moments]
            driven += [(begin + k, each) for k, each in part.driven]
        return moments, driven

    whole = found([0, n])
    assert found([0, *sorted(k for k in cuts if k < n), n]) == whole
