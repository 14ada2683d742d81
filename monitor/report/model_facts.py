"""Facts of a model for the report."""

from monitor.base.counts import counted
from monitor.base.signals import OUTPUT
from monitor.pipeline.replay import Setup


def predicted_quantity(setup: Setup) -> str:
    """Return the name that a page gives to the prediction."""
    name = setup.model.card.output.name
    return "lambda" if name == OUTPUT else name


def model_info(setup: Setup) -> dict[str, str]:
    """Return the report's entry of the model."""
    card = setup.model.card
    own = card.output.unit
    unit = own if own and own != "-" else predicted_quantity(setup)
    layers = " and ".join(str(n) for n in card.layers)
    sources = sorted({r.source or "source not said" for r in card.recordings})
    shape = f"lags {card.lags}, hidden layers {layers}" if layers else f"{card.lags} samples"
    return {
        "model": setup.model.path.name,
        "sha256": setup.model.sha256,
        "kind": f"{card.kind}, {shape}",
        "inputs": ", ".join(card.input_names),
        "output": card.output.name,
        "trained on": f"{counted(len(card.recordings), 'recording')} ({', '.join(sources)})",
        "sample period": f"{card.period_ns / 1e6:g} ms",
        "healthy residual": f"mean {card.residual_mean:+.4f}, std {card.residual_std:.4f} {unit}",
    }
