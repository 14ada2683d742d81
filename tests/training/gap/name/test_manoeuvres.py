"""Manoeuvres that separate two models."""

from dataclasses import replace

from tests.helpers.gap.gap_drives import BASE, noisy_drive
from training.gap.name.manoeuvres import propose
from training.greybox.effects import LIBRARY, Effect
from training.greybox.fit.joint import fit
from training.healthy.base_state import base_state


def held(name: str, *values: float) -> Effect:
    """Return an effect whose constants can hardly leave these values."""
    pairs = zip(LIBRARY[name].parameters, values, strict=True)
    near = (replace(p, low=0.999 * v, high=1.001 * v, start=(v,)) for p, v in pairs)
    return replace(LIBRARY[name], parameters=tuple(near))


def test_the_manoeuvre_that_separates_two_models_is_the_one_they_differ_on() -> None:
    state = base_state([noisy_drive(1)], None, BASE)
    case, alone = state.case, state.current
    film = fit(case, (held("wall_film", 0.1, 0.6, 2.0),), [alone])
    leak = fit(case, (held("exhaust_leak", 0.01, 30.0, 0.5),), [alone])
    dynamic, static = (propose(state, (each, alone)) for each in (film, leak))
    assert "tip-in" in (dynamic or "")
    assert static not in (None, "coasting with fuel cut and picking up again")
