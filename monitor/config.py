"""Configuration: a TOML file becomes frozen objects; an unknown key is an error."""

import tomllib
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from monitor.errors import ConfigError


@dataclass(frozen=True, slots=True)
class WindowConfig:
    """Length of the residual window."""

    n_samples: int


@dataclass(frozen=True, slots=True)
class EnableConfig:
    """When a sample may be judged."""

    coolant_min_degc: float
    engine_speed_min_rpm: float
    engine_speed_max_rpm: float
    manifold_pressure_min_kpa: float
    fuel_cut_recovery_s: float
    model_settle_s: float
    range_margin: float
    range_recovery_s: float


@dataclass(frozen=True, slots=True)
class ResponseConfig:
    """The bank of sensor hypotheses and the limits of the response rule."""

    lags_s: tuple[float, ...]
    delays_s: tuple[float, ...]
    lag_limit_s: float
    delay_limit_s: float
    gain_limit: float
    gain_transient: float
    excitation_noise: float
    noise_correlation_samples: float
    evidence_fail: float
    evidence_pass: float
    evidence_alike: float
    evidence_memory: float


@dataclass(frozen=True, slots=True)
class BiasConfig:
    """The offset test."""

    offset_limit_lambda: float
    n_windows: int


@dataclass(frozen=True, slots=True)
class PlausibilityConfig:
    """Stuck, not ready, out of range, missing."""

    stuck_range: float
    stuck_samples: int
    stuck_band_at_one: float
    not_ready_s: float
    engine_running_rpm: float


@dataclass(frozen=True, slots=True)
class DebounceConfig:
    """Steps of the fault detection counter."""

    response_fail: int
    response_pass: int
    tick_fail: int
    tick_pass: int


@dataclass(frozen=True, slots=True)
class Config:
    """Everything that is set and not learned."""

    window: WindowConfig
    enable: EnableConfig
    response: ResponseConfig
    bias: BiasConfig
    plausibility: PlausibilityConfig
    debounce: DebounceConfig


_Section = TypeVar("_Section")


def load(path: Path | None = None) -> Config:
    """Return the configuration of a TOML file; without one, as shipped.

    A file may leave out sections and keys: these keep the shipped value.
    Raises ConfigError naming file and key for what is unknown or of the wrong type.
    """
    shipped = tomllib.loads(files("monitor").joinpath("default.toml").read_text())
    if path is None:
        return _build(shipped, "default.toml")
    try:
        own = tomllib.loads(path.read_text())
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None
    for section, values in own.items():
        if section not in shipped:
            raise ConfigError(f"{path}: section [{section}] is unknown; there are {list(shipped)}")
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: {section} is a section, {values!r} came")
        for key, value in values.items():
            _check(path, section, key, value, shipped[section])
        shipped[section] |= values
    return _build(shipped, str(path))


def _check(path: Path, section: str, key: str, value: Any, known: dict[str, Any]) -> None:
    if key not in known:
        raise ConfigError(f"{path}: [{section}] {key} is unknown; there are {list(known)}")
    wanted = type(known[key])
    fits = isinstance(value, int | float if wanted is float else wanted)
    if not fits or isinstance(value, bool):
        raise ConfigError(f"{path}: [{section}] {key} = {value!r}, wanted {wanted.__name__}")


def _build(tree: dict[str, Any], where: str) -> Config:
    def section(kind: type[_Section], name: str) -> _Section:
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in tree[name].items()}
        return kind(**values)

    config = Config(
        window=section(WindowConfig, "window"),
        enable=section(EnableConfig, "enable"),
        response=section(ResponseConfig, "response"),
        bias=section(BiasConfig, "bias"),
        plausibility=section(PlausibilityConfig, "plausibility"),
        debounce=section(DebounceConfig, "debounce"),
    )
    if config.window.n_samples < 10:
        raise ConfigError(f"{where}: [window] n_samples = {config.window.n_samples}, wanted >= 10")
    for field in fields(DebounceConfig):
        step = getattr(config.debounce, field.name)
        if not 1 <= step <= 127:
            raise ConfigError(f"{where}: [debounce] {field.name} = {step}, wanted 1 to 127")
    return config
