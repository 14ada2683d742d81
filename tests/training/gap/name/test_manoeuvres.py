"""Manoeuvres that separate two models."""

from dataclasses import replace

import numpy as np

from tests.helpers.gap.gap_drives import BASE, case_of, noisy_drive
from training.gap.name.manoeuvres import library, separate
from training.greybox.effects import LIBRARY
from training.greybox.fit.joint import fit


def test_the_manoeuvre_that_separates_two_models_is_the_one_they_differ_on() -> None:
    case = case_of(noisy_drive(1))
    alone = fit(case, (), [BASE])
    film = replace(alone, terms=(LIBRARY["wall_film"],), parameters=(np.array([0.2, 0.6, 2.0]),))
    leak = replace(
        alone, terms=(LIBRARY["exhaust_leak"],), parameters=(np.array([0.05, 30.0, 0.5]),)
    )
    dynamic = separate(film, alone)
    static = separate(leak, alone)
    assert "tip-in" in dynamic.name
    assert "1,500 rpm" in static.name or "speed sweep" in static.name
    assert dynamic.difference["motorway at 2,600 rpm"] < 0.3 * dynamic.rms_phi
    assert set(dynamic.difference) == set(library())
    assert dynamic.name in str(dynamic)
