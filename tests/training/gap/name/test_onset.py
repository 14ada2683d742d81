"""Something that begins within a drive is no effect."""

from dataclasses import replace

import numpy as np
import pytest

from monitor.base.types import FloatArray
from tests.helpers.gap.gap_drives import BASE, case_of, noisy_drive
from training.gap.name.onset import onset_s
from training.greybox.fit.case import Case
from training.greybox.fit.joint import JointFit, fit

BEGINS = (np.arange(6000) > 2500).astype(float)


def explained(
    strength: FloatArray, size: FloatArray | None = None
) -> tuple[Case, JointFit, JointFit]:
    """Return a case whose gap is a signature times a strength by sample, and both fits.

    size : of the signature, default 1
    """
    drive = noisy_drive(1)
    case = case_of(drive)
    m = int(drive.kept.sum())
    rng = np.random.default_rng(3)
    signature = (1.0 if size is None else size[:m]) * np.sin(np.arange(m) / 7.0)
    before = fit(case, (), [BASE])
    gap = strength[:m] * signature + rng.standard_normal(m)
    return case, replace(before, residual=-gap), replace(before, residual=-gap + signature)


def test_what_begins_within_a_drive_is_an_onset_and_what_is_always_there_is_none() -> None:
    found = onset_s(*explained(BEGINS))
    assert found is not None
    assert found[0] == "drive 1"
    assert found[1] == pytest.approx(285.0, abs=75.0)
    assert onset_s(*explained(np.ones(6000))) is None
    assert onset_s(*explained(0.6 + 0.4 * BEGINS)) is None


def test_a_little_that_hardly_shows_before_is_no_onset() -> None:
    # GIVEN an effect that is not there where it would hardly show, such as while the engine is cold
    for before, onset in ((0.4, False), (2.0, True)):  # of the size where it is there
        size = np.where(BEGINS > 0.0, 5.0, before)
        assert (onset_s(*explained(BEGINS, size)) is not None) == onset
