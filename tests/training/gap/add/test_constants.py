"""Constants that suit a typical drive, on drives of plain formulas."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.gap.gap_drives import BASE, case_of, noisy_drive
from tests.helpers.gap.gap_networks import CHAIN, FILM, drive
from training.gap.add.constants import (
    fit_and_leave_out,
    fit_weighted,
    groups,
    left_out_ratio,
    model_corrections,
)
from training.gap.inputs.roles import Material
from training.gap.inputs.subject import Subject
from training.greybox.effects import LIBRARY
from training.greybox.fit.case import Case
from training.greybox.fit.drive import from_recording, phi_of
from training.greybox.fit.joint import JointFit, fit
from training.healthy.base_state import SPREAD_CARD
from training.narx.fit import FitResult
from training.recordings.prediction import predicted_phi

OFFSET = (LIBRARY["injector_offset"],)


def _case(*offsets_mg: float) -> Case:
    drives = [noisy_drive(1 + i, 0.003, "injector_offset", x) for i, x in enumerate(offsets_mg)]
    return replace(case_of(*drives), prior=(BASE, SPREAD_CARD))


def _plain(case: Case) -> tuple[JointFit, JointFit]:
    before = fit(case, (), [BASE])
    return before, fit(case, OFFSET, [before])


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
    # AND drives that agree are fitted as by least squares
    case = _case(0.3, 0.3, 0.3)
    weighed, alike = fit_weighted(case, plain := _plain(case)[1])
    assert alike.parameters[0][0] == pytest.approx(plain.parameters[0][0], rel=1e-2)
    assert max(weighed.scales) < 1.1


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


def test_recordings_of_one_name_in_several_folders_are_each_held_against_their_own_prediction(
    base: FitResult,
) -> None:
    # GIVEN a network, and recordings of other lengths that their logger gave one name
    made = [drive("micro_trips", 2_020_131, FILM), drive("us06", 2_020_132, FILM, 300.0)]
    days = ("monday", "tuesday")
    alike = [replace(r, path=Path(day, "log1.log")) for r, day in zip(made, days, strict=True)]
    card, drives = base.card, list(map(from_recording, alike))
    subject = Subject(Material(base.path, alike), card, drives)
    case = Case(tuple(drives), tuple(np.zeros(len(each)) for each in drives))
    current = fit(case, (), [CHAIN])
    # THEN each has what the network predicts of it beyond the chain
    found, read = model_corrections(subject, case, current), predicted_phi(base.path, alike)
    for own, phi, driven in zip(found, read, drives, strict=True):
        assert own == pytest.approx(phi - phi_of(driven, current.base))
