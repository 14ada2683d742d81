"""Every sentence on why a recording was not judged, from recordings that are made here."""

from typing import Any

import numpy as np
import pytest

from monitor.base.types import Quality
from monitor.judge.causes.causes import Asked, Judgement, SignalSource, causes
from monitor.judge.causes.observation import Observation
from monitor.judge.enable import Enable
from monitor.pipeline.replay import Setup

N = 2000  # samples
LATE, SELDOM = slice(500, None), np.arange(N) % 20 < 10


def told(
    setup: Setup,
    judgement: Judgement | None,
    *,
    rows: Any = slice(0),
    column: int | slice = 0,
    is_read: Quality | float = Quality.GOOD,
    n: int = N,
) -> list[str]:
    """Return why a recording with the model's signals was not judged.

    is_read : value or quality of some rows of a column, whose last one is the output
    """
    card = setup.model.card
    names = (*card.input_names, card.output.name)
    middle = [0.5 * (c.minimum + c.maximum) for c in (*card.inputs, card.output)]
    values = np.array(middle) * (1.0 + 1e-3 * np.sin(np.arange(n)))[:, np.newaxis]
    quality = np.zeros(values.shape, dtype=np.uint8)
    if not isinstance(is_read, Quality):
        values[rows, column] = is_read
    else:
        quality[rows, column] = is_read
        values[rows, column] *= 1.0 if is_read == Quality.PINNED else np.nan
    enable = Enable.of(setup.config.enable, names, card)
    seen = Observation(enable, names, setup.config.plausibility, 0.1)
    seen.push(values, quality, enable.push(values, quality))
    sources = {name: SignalSource(f"message.{name}", 0.5) for name in names}
    asked = Asked(card, setup.config, sources, setup.limits)
    return [cause.in_words for cause in causes(seen.observed(), asked, judgement)]


@pytest.mark.parametrize(
    ("is_read", "column", "rows", "words"),
    [
        (Quality.STALE, 0, slice(None), "air_mass_mg never came (message.air_mass_mg): "),
        (Quality.STALE, 0, LATE, "is stale in 75 % of the samples: no value for "),
        (
            Quality.STALE,
            0,
            SELDOM,
            "1.5 s apart, timeout_s is 0.5 s (message.air_mass_mg); set tim",
        ),
        (Quality.INVALID, 0, LATE, "no value in 75 % of the samples (message.air_mass_mg): check"),
        (Quality.OUT_OF_RANGE, 0, LATE, "0 to 2000 mg/stroke is: check unit, factor and offset"),
        (Quality.GAP, slice(None), slice(0, N, 3), "is interrupted again and again"),
        (Quality.PINNED, -1, LATE, "stands at an end of its range in 75 % of the samples: cold,"),
        (2900.0, 0, LATE, "in 75 % of the samples: outside the model's training; check its unit"),
        (300.0, 0, slice(None), "air_mass_mg is 300 mg/stroke throughout (message.air_mass_mg): "),
        (1.02, -1, slice(-150, None), "did not move any more when the recording ended: check the"),
    ],
)
def test_a_signal_that_holds_a_verdict_up_is_named_with_a_remedy(
    setup: Setup, is_read: Quality | float, column: int | slice, rows: Any, words: str
) -> None:
    judgement = Judgement(unfinished=("response",))
    said = told(setup, judgement, is_read=is_read, column=column, rows=rows)
    assert any(words in each for each in said), said


@pytest.mark.parametrize(
    ("judgement", "words"),
    [
        ((10, 2, ("response",), 300.0), "drive about 5\xa0min more like this; with changing load"),
        ((10, 8, ("response",), None, True), "drive more like this; with changing load or fuel cu"),
        ((10, 8, ("bias",)), "could be judged, without a decision of bias: record a longer drive"),
    ],
)
def test_without_a_signal_at_fault_more_driving_is_asked_for(
    setup: Setup, judgement: Any, words: str
) -> None:
    said = told(setup, Judgement(*judgement))
    assert any(words in each for each in said), said


def test_a_recording_shorter_than_a_window_is_too_short(setup: Setup) -> None:
    for n in (0, 30):
        (said,) = told(setup, None, n=n)
        assert said.startswith("samples: the recording is") and "s long, at least" in said
