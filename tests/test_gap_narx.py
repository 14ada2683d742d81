"""Added effects in the network's graph, on simulated drives of which one has a hidden effect."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from monitor.errors import RecordingError
from monitor.model import Model, from_model_units
from monitor.replay import shipped_model
from training.dyno.ecu import broadcast, own_bus, samples
from training.dyno.effects import from_severities
from training.dyno.simulate import Experiment, simulate
from training.evaluate import predict
from training.gap.predicted import predicted_phi
from training.recordings import Recording

VEHICLE = 2011


@cache
def drive(
    cycle: str, seed: int, effect: tuple[str, float] | None = None, duration_s: float = 400.0
) -> Recording:
    """Return a recording as the monitor's grid sees it, the plant's own effect inside the loop."""
    experiment = Experiment(
        cycle=cycle,
        vehicle=VEHICLE,
        seed=seed,
        effects=from_severities(dict([effect] if effect else [])),
        duration_s=duration_s,
    )
    bus, rng = own_bus(), np.random.default_rng([5, seed])
    block = samples(broadcast(simulate(experiment), bus, rng), bus, 100_000_000)
    t_s = (block.t_ns - block.t_ns[0]) / 1e9
    return Recording(
        Path(f"{experiment.name}.log"), f"{seed:064x}", 100_000_000, t_s, tuple(bus.names),
        block.values, block.quality,
    )  # fmt: skip


def without(recording: Recording, rows: slice, name: str) -> Recording:
    """Return the recording with one signal missing for a while."""
    values = recording.values.copy()
    values[rows, recording.names.index(name)] = np.nan
    return Recording(
        recording.path, recording.sha256, recording.period_ns, recording.t_s, recording.names,
        values, recording.quality,
    )  # fmt: skip


def test_the_free_run_in_phi_is_that_of_evaluate() -> None:
    recordings = [drive("wltc_3b", 2_020_101), drive("us06", 2_020_102, duration_s=200.0)]
    found = predicted_phi(shipped_model(), recordings)
    for recording, phi in zip(recordings, found, strict=True):
        model = Model.load(shipped_model())
        _, free, _, scored = predict(model, recording, model.card.lags)
        read = 1.0 / from_model_units("phi", phi)
        assert scored.sum() > 0.9 * len(phi)
        assert np.abs(read - 1.0 / free)[scored].max() < 1e-6


def test_recordings_side_by_side_are_bit_for_bit_those_alone() -> None:
    recordings = [drive("wltc_3b", 2_020_101), drive("us06", 2_020_102, duration_s=200.0)]
    together = predicted_phi(shipped_model(), recordings)
    for recording, phi in zip(recordings, together, strict=True):
        assert np.array_equal(predicted_phi(shipped_model(), [recording])[0], phi)


def test_the_free_run_goes_on_over_inputs_that_are_missing() -> None:
    whole = drive("wltc_3b", 2_020_101)
    gap = slice(1000, 1030)
    (held,) = predicted_phi(shipped_model(), [without(whole, gap, "maf_kg_h")])
    (phi,) = predicted_phi(shipped_model(), [whole])
    assert np.isfinite(held).all()
    assert np.array_equal(held[:1000], phi[:1000])
    assert not np.array_equal(held[gap], phi[gap])
    assert np.abs(held - phi)[1100:].max() < 1e-5


def test_a_signal_that_is_never_good_is_refused() -> None:
    missing = without(drive("wltc_3b", 2_020_101), slice(None), "maf_kg_h")
    with pytest.raises(RecordingError, match="maf_kg_h is never good"):
        predicted_phi(shipped_model(), [missing])
