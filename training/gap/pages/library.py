"""The library of effects as text: constants, bounds, signals, source."""

from training.greybox.effects import LIBRARY, Effect


def as_text() -> str:
    """Return the library."""
    return "\n".join(map(_lines, LIBRARY.values()))


def _lines(effect: Effect) -> str:
    start = [f"{effect.name} ({effect.tag}): {effect.says}"]
    start += [
        f"  {p.name} {p.low:g} to {p.high:g} {p.unit}".removesuffix(" -") for p in effect.parameters
    ]
    if effect.needs:
        start.append(f"  needs {', '.join(effect.needs)}")
    if effect.source:
        start.append(f"  source: {effect.source}")
    return "\n".join(start)
