"""Constants that suit a typical drive, on drives of plain formulas."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.gap.gap_drives import BASE, case_of, noisy_drive
from training.gap.add.constants import fit_and_leave_out, fit_weighted, groups, left_out_ratio
from training.greybox.effects import LIBRARY
from training.greybox.fit.case import Case, Prior
from training.greybox.fit.joint import JointFit, fit
from training.healthy.base_state import SPREAD_CARD

OFFSET = (LIBRARY["injector_offset"],)


def _case(*offsets_mg: float) -> Case:
    drives = [noisy_drive(1 + i, 0.003, "injector_offset", x) for i, x in enumerate(offsets_mg)]
    return replace(case_of(*drives), prior=Prior(BASE, SPREAD_CARD))


def _plain(case: Case) -> tuple[JointFit, JointFit]:
    before = fit(case, (), [BASE])
    return before, fit(case, OFFSET, [before])


def test_drives_that_agree_are_fitted_as_by_least_squares() -> None:
    case = _case(0.3, 0.3, 0.3)
    _, plain = _plain(case)
    weighed, alike = fit_weighted(case, plain)
    assert alike.parameters[0][0] == pytest.approx(plain.parameters[0][0], rel=1e-2)
    assert max(weighed.scales) < 1.1


def test_a_drive_in_which_the_effect_is_many_times_as_strong_spoils_the_others_less() -> None:
    # GIVEN three drives with an effect, and one with ten times as much of it
    case = _case(0.3, 0.3, 3.0, 0.3)
    _, plain = _plain(case)
    # WHEN every drive counts by its own variance
    weighed, alike = fit_weighted(case, plain)
    # THEN the constant is near that of the three, and the fourth has the large errors
    assert plain.parameters[0][0] > 0.6
    assert alike.parameters[0][0] == pytest.approx(0.3, abs=0.1)
    assert int(np.argmax(weighed.scales)) == 2


@pytest.mark.parametrize(
    ("offsets_mg", "holds"),
    [
        ((0.3, 0.3, 0.3), True),  # the same in every drive
        ((0.3, 0.6, 0.2), True),  # of another size, but the same effect
        ((1.5, -1.5, 1.5, -1.5), False),  # another sign in every other drive
        ((0.3,), True),  # nothing to hold it against
    ],
)
def test_an_effect_is_kept_if_drives_left_out_are_predicted_better_with_it(
    offsets_mg: tuple[float, ...], holds: bool
) -> None:
    case = _case(*offsets_mg)
    before, plain = _plain(case)
    of = groups(len(case.drives))
    found = fit_and_leave_out(case, plain, of)
    assert (left_out_ratio(case, before, *found, of) < 1.0) is holds
