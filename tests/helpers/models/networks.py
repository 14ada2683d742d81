"""Small networks with random weights, and the cards of their files."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from monitor.base.types import FloatArray
from monitor.model.card import Channel, ModelCard
from training.narx.export import Network
from training.narx.network import Spec, initial_weights
from training.recordings.samples.scaling import Scaling


def network_of(
    inputs: Sequence[str],
    low: FloatArray,
    high: FloatArray,
    transform: str = "phi",
    *,
    lags: int = 5,
    hidden: tuple[int, ...] = (8, 8),
    first_lag: int = 1,
) -> Network:
    y_low, y_high = (0.0, 1.7) if transform == "phi" else (-3.0, 4.0)
    scaling = Scaling(
        u_mean=(low + high) / 2,
        u_std=(high - low) / 4,
        u_low=low,
        u_high=high,
        y_mean=0.9,
        y_std=0.3,
        y_low=y_low,
        y_high=y_high,
    )
    spec = Spec(len(inputs), lags, hidden, first_lag, (y_low - 0.9) / 0.3, (y_high - 0.9) / 0.3)
    weights = 1.3 * initial_weights(spec, np.random.default_rng(4))
    return Network(spec, weights, scaling, transform, tuple(inputs))


def card_of(
    net: Network, low: FloatArray, high: FloatArray, longest: float = 16.0, **more: Any
) -> ModelCard:
    """Return the card of a network that predicts lambda up to ``longest``."""
    ranges = zip(net.inputs, low.tolist(), high.tolist(), strict=True)
    return ModelCard(
        kind="narx",
        inputs=tuple(Channel(name, "", a, b, a, b) for name, a, b in ranges),
        output=Channel("lambda_measured", "-", 0.7, longest, 0.8, longest),
        transform=net.transform,
        output_limits=(net.scaling.y_low, net.scaling.y_high),
        period_ns=100_000_000,
        lags=net.spec.lags,
        input_lag_start=net.spec.input_lag_start,
        layers=net.spec.hidden,
        state=net.state_layout,
        residual_mean=0.0,
        residual_std=0.01,
        **({"recordings": ()} | more),
    )
