"""The library of effects as text: constants, bounds, signals, source, and who brings it."""

from training.greybox.effects import LIBRARY, Effect, origins


def as_text() -> str:
    """Return the library, the effects of plug-ins last."""
    brought = origins()
    return "\n".join(_lines(effect, brought.get(effect.name)) for effect in LIBRARY.values())


def _lines(effect: Effect, origin: str | None) -> str:
    start = [f"{effect.name} ({effect.tag}{f', from {origin}' if origin else ''}): {effect.says}"]
    start += [
        f"  {p.name} {p.low:g} to {p.high:g} {p.unit}".removesuffix(" -") for p in effect.parameters
    ]
    if effect.needs:
        start.append(f"  needs {', '.join(effect.needs)}")
    if effect.source:
        start.append(f"  source: {effect.source}")
    return "\n".join(start)
