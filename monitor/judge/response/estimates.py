"""What the rules estimate in a window, beside its verdict."""

from typing import NamedTuple


class Estimates(NamedTuple):
    """Estimates of the response rule after a window."""

    excitation: float  # standard deviation of the prediction, output's unit
    evidence: float  # log likelihood of the likeliest fault over the likeliest sound sensor
    hypothesis: str  # the likeliest, "healthy" or a fault
    lag_rich_to_lean_s: float = 0.0
    lag_rich_to_lean_std_s: float = 0.0
    lag_lean_to_rich_s: float = 0.0
    lag_lean_to_rich_std_s: float = 0.0
    dead_time_rich_to_lean_s: float = 0.0
    dead_time_rich_to_lean_std_s: float = 0.0
    dead_time_lean_to_rich_s: float = 0.0
    dead_time_lean_to_rich_std_s: float = 0.0
    gain: float | None = None  # None before any window
    gain_std: float | None = None


class WindowEstimates(NamedTuple):
    """Estimates of all rules after a window."""

    response: Estimates
    offset: float  # fading mean of the residual, output's unit
    offset_std: float | None
    offset_beyond: float | None  # standard deviations outside the healthy offsets
    dead: float  # log likelihood ratio of a dead sensor over a live one, summed
    holds: float  # the same of a sensor that holds now and then

    def as_dict(self) -> dict[str, float | str | None]:
        """Return the estimates by name."""
        own = self._asdict()
        return dict(own.pop("response")._asdict() | own)
