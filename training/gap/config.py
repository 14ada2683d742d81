"""Numbers of the gap workflow that decide: ``default.toml`` as frozen objects, read once."""

from dataclasses import dataclass
from typing import Final

from monitor.base.files.settings import ShippedSettings, built


@dataclass(frozen=True, slots=True)
class InputsConfig:
    """Recordings and models that can be used, and roles of recordings."""

    scored_min_s: float
    moves_min: float
    moves_quantiles: tuple[float, float]
    correlation_min: float
    effects_max: int


@dataclass(frozen=True, slots=True)
class ErrorAloneConfig:
    """Readings of recordings without fuel or air per stroke."""

    same_correlation: float
    lean_phi: float
    before_cut_s: float


@dataclass(frozen=True, slots=True)
class DriversConfig:
    """Variables that a difference may depend on."""

    rate_s: float
    cut_memory_s: float
    values_min: int


@dataclass(frozen=True, slots=True)
class DifferenceConfig:
    """When a reading without a chain differs from that of healthy runs."""

    false_share: float
    likely: float
    sure: float
    near: float
    straight: float
    runs_min: int


@dataclass(frozen=True, slots=True)
class VerifyConfig:
    """Regimes of the held-out drives and their bounds."""

    cold_degc: float
    after_cut_s: float
    confidence: float
    blocks_min: int
    samples_min: int


@dataclass(frozen=True, slots=True)
class GapConfig:
    """All sections of the file."""

    inputs: InputsConfig
    error_alone: ErrorAloneConfig
    drivers: DriversConfig
    response: DifferenceConfig
    verify: VerifyConfig


CONFIG: Final = built(GapConfig, ShippedSettings("training.gap").values())
