"""How many inputs a property test draws: some in every run, many with ``make properties``."""

import os
from typing import Any, Final

from hypothesis import settings

USUAL: Final = 100  # of a test that does not say how many
SHARE: Final = float(os.environ.get("O2_INPUTS", "0.2"))  # that a run draws of what a test asks for
FEWEST: Final = 10


def number(asked: int) -> int:
    """Return how many inputs this run draws for a test that asks for so many."""
    return max(round(SHARE * asked), FEWEST)


def inputs(asked: int, **further: Any) -> settings:
    """Return the settings of a test that asks for so many inputs."""
    return settings(max_examples=number(asked), **further)
