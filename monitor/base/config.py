"""Configuration: a TOML file becomes frozen objects. An unknown key is an error.

``default.toml`` gives the reason of every value; the unit stands in the key.
"""

import tomllib
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, TypeVar

from monitor.base.errors import ConfigError
from monitor.base.inputs import read_toml


@dataclass(frozen=True, slots=True)
class WindowConfig:
    """Length of the residual window in samples."""

    n_samples: int


@dataclass(frozen=True, slots=True)
class EnableConfig:
    """Limits of the enable conditions."""

    coolant_min_degc: float
    engine_speed_min_rpm: float
    engine_speed_max_rpm: float
    manifold_pressure_min_kpa: float
    manifold_pressure_max_kpa: float
    vehicle_speed_min_km_h: float
    fuel_cut_recovery_s: float
    purge_open_percent: float
    purge_step_percent: float
    purge_recovery_s: float
    model_settle_samples: int
    range_margin: float
    range_recovery_s: float
    range_ignored: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ResponseConfig:
    """The bank of sensor hypotheses, and the limits of the response rule."""

    lags_s: tuple[float, ...]
    delays_s: tuple[float, ...]
    lead_s: float
    lag_limit_s: float
    lag_limit_symmetric_s: float
    delay_limit_s: float
    gain_sound_min: float
    gain_weak_max: float
    gain_slow_min: float
    gain_transient_max: float
    gain_late_min: float
    gain_max: float
    gain_least: float
    gain_known: float
    gain_memory: float
    excitation_noise: float
    noise_least: float
    evidence_weight: float
    false_alarm_probability: float
    miss_probability: float
    evidence_alike: float
    evidence_most: float


@dataclass(frozen=True, slots=True)
class BiasConfig:
    """The bias rule and the vehicle's healthy reference."""

    offset_limit_lambda: float
    window_std_lambda: float
    variance_shared: float
    certainty: float
    memory: float
    n_windows: int
    fuel_span_lambda: float
    gain_spread: float
    gain_drives: int
    reference_windows: int


@dataclass(frozen=True, slots=True)
class PlausibilityConfig:
    """Limits of a stuck, unready, implausible or missing signal."""

    stuck_range: float
    stuck_s: float
    fuel_cut_most_s: float
    stuck_band_at_one: float
    end_s: float
    constant_s: float
    start_patience_s: float
    not_ready_s: float
    engine_running_rpm: float


@dataclass(frozen=True, slots=True)
class CatalystConfig:
    """The bank of catalysts with downstream sensors, and the limits of its rule."""

    threshold_g: float
    threshold_margin: float
    capacities_g: tuple[float, ...]
    offsets_phi: tuple[float, ...]
    offset_std_phi: float
    offset_sound_phi: float
    offset_biased_phi: float
    offset_parts: int
    offset_block: int
    offset_model_phi: float
    leaks_phi: tuple[float, ...]
    flow_most_g_s: float
    leak_flow_g_s: float
    zone_shares: tuple[float, ...]
    breakthrough: float
    equilibrium_phi: float
    hydrogen_phi: float
    switching_phi: float
    voltage_low_v: float
    voltage_span_v: float
    voltage_std_v: float
    tail: float
    sensor_lag_s: float
    sensor_sound_lags_s: tuple[float, ...]
    sensor_slow_lags_s: tuple[float, ...]
    sensor_late_s: float
    sensor_weak_gains: tuple[float, ...]
    sensor_prior: float
    lean_v: float
    rich_v: float
    stuck_range_v: float
    circuit_low_v: float
    circuit_high_v: float
    circuit_s: float
    circuit_after_s: float
    circuit_lean_phi: float
    circuit_pass_s: float
    rest_band_v: float
    awake_v: float
    inactive_s: float
    inactive_oxygen_g: float
    inactive_most_s: float
    wake_most_s: float
    heater_start_s: float
    heater_full_percent: float
    heater_full_s: float
    position: str
    warm_degc: float
    warm_up_s: float
    hold_s: float
    settle_s: float
    segment_s: float
    segment_most: float
    memory_s: float
    evidence_weight: float
    evidence_most: float
    evidence_alike: float
    interval_weight: float
    follow_low: float
    follow_sound: float
    follow_late_s: float
    follow_longest_s: float
    follow_gap_s: float
    follow_hysteresis_v: float
    false_alarm_probability: float
    miss_probability: float

    @property
    def close_coupled(self) -> bool:
        """Return whether the judged catalyst is a warm-up catalyst close to the engine."""
        return self.position == POSITIONS[1]


@dataclass(frozen=True, slots=True)
class MovementConfig:
    """Limits of a reading that does not move, or holds now and then."""

    gain_least: float
    error_share: float
    quantum: float
    still_share: float
    bound: float
    doubt: float
    hold_s: float
    hold_samples: int
    no_hold: float


@dataclass(frozen=True, slots=True)
class DebounceConfig:
    """Steps of the fault detection counter, and times for electrical faults."""

    response_fail: int
    response_pass: int
    tick_fail_s: float
    tick_pass_s: float


@dataclass(frozen=True, slots=True)
class CyclesConfig:
    """Begin of a driving cycle, and the conditions of the general denominator."""

    engine_off_s: float
    silent_s: float
    start_s: float
    denominator_run_s: float
    denominator_moving_s: float
    denominator_moving_km_h: float
    denominator_idle_s: float
    denominator_idle_km_h: float
    denominator_ambient_min_degc: float
    denominator_pressure_min_kpa: float


@dataclass(frozen=True, slots=True)
class ProfileConfig:
    """Numbers of cycles after which a regulation changes codes and lamp."""

    confirm_cycles: int
    lamp_off_cycles: int
    erase_warm_ups: int
    permanent_most: int
    warm_up_degc: float
    warm_up_rise_degc: float


@dataclass(frozen=True, slots=True)
class ObdConfig:
    """The regulation in force."""

    profile: str


@dataclass(frozen=True, slots=True)
class RulesConfig:
    """Decision rules of plug-ins."""

    active: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Config:
    """All settings. Values that are learned stand in the model card or the fault memory."""

    window: WindowConfig
    enable: EnableConfig
    response: ResponseConfig
    bias: BiasConfig
    movement: MovementConfig
    plausibility: PlausibilityConfig
    catalyst: CatalystConfig
    debounce: DebounceConfig
    cycles: CyclesConfig
    rules: RulesConfig
    obd: ObdConfig
    carb: ProfileConfig
    eobd: ProfileConfig

    def with_catalyst(self, position: str) -> "Config":
        """Return the settings for a catalyst at this position; "" changes nothing."""
        if not position:
            return self
        return replace(self, catalyst=replace(self.catalyst, position=position))

    @property
    def profile(self) -> ProfileConfig:
        """Return the cycle numbers of the regulation in force."""
        return self.carb if self.obd.profile == "carb" else self.eobd


PROFILES: Final = ("carb", "eobd")
POSITIONS: Final = ("underfloor", "close_coupled")  # of the judged catalyst
_Section = TypeVar("_Section")

# Lowest allowed numbers. A number without an entry must be above 0.
_LOWEST: Final = {
    "window.n_samples": 10.0,
    "enable.coolant_min_degc": -273.15,
    "enable.engine_speed_min_rpm": 0.0,
    "enable.manifold_pressure_min_kpa": 0.0,
    "enable.vehicle_speed_min_km_h": 0.0,
    "enable.fuel_cut_recovery_s": 0.0,
    "enable.purge_recovery_s": 0.0,
    "enable.model_settle_samples": 0.0,
    "enable.range_margin": 0.0,
    "enable.range_recovery_s": 0.0,
    "response.lag_limit_s": 0.0,
    "response.lag_limit_symmetric_s": 0.0,
    "response.delay_limit_s": 0.0,
    "response.lead_s": 0.0,
    "response.gain_late_min": 0.0,
    "response.excitation_noise": 0.0,
    "response.evidence_alike": 0.0,
    "response.gain_known": 0.0,
    "response.gain_least": 0.0,
    "response.gain_memory": 0.0,
    "bias.variance_shared": 0.0,
    "bias.memory": 0.0,
    "bias.gain_drives": 0.0,
    "catalyst.offsets_phi": -0.5,
    "catalyst.equilibrium_phi": 0.0,
    "catalyst.hydrogen_phi": 0.0,
    "catalyst.voltage_low_v": 0.0,
    "catalyst.sensor_prior": 0.0,
    "catalyst.warm_degc": -273.15,
    "catalyst.warm_up_s": 0.0,
    "catalyst.settle_s": 0.0,
    "catalyst.evidence_alike": 0.0,
    "plausibility.stuck_range": 0.0,
    "plausibility.start_patience_s": 0.0,
    "plausibility.stuck_band_at_one": 0.0,
    "plausibility.not_ready_s": 0.0,
    "plausibility.engine_running_rpm": 0.0,
    "cycles.denominator_idle_km_h": 0.0,
    "cycles.denominator_ambient_min_degc": -273.15,
    "cycles.denominator_pressure_min_kpa": 0.0,
    "carb.permanent_most": 0.0,
    "eobd.permanent_most": 0.0,
}
_HIGHEST: Final = {
    "enable.purge_open_percent": 100.0,
    "enable.purge_step_percent": 100.0,
    "response.gain_memory": 1.0,
    "response.noise_least": 1.0,
    "response.evidence_weight": 1.0,
    "response.false_alarm_probability": 0.5,
    "response.miss_probability": 0.5,
    "catalyst.evidence_weight": 1.0,
    "catalyst.interval_weight": 1.0,
    "catalyst.follow_low": 0.99,
    "catalyst.follow_sound": 0.99,
    "catalyst.hold_s": 60.0,
    "catalyst.false_alarm_probability": 0.5,
    "catalyst.miss_probability": 0.5,
    "catalyst.sensor_late_s": 60.0,  # the bank keeps so much of its prediction in memory
    "bias.variance_shared": 1.0,
    "bias.memory": 1.0,
    "bias.gain_spread": 0.5,
    "debounce.response_fail": 127.0,
    "debounce.response_pass": 127.0,
    "response.lags_s": 60.0,  # the bank keeps so much of the prediction in memory
    "response.delays_s": 60.0,
    "response.lead_s": 60.0,
}
_MOST: Final = 1e6  # of any other number: 11 days, or so many samples


def load(path: Path | None = None) -> Config:
    """Return the configuration of a TOML file, or the shipped one without a file.

    Sections and keys that the file leaves out keep the shipped value.
    Raises ConfigError with file and key if a key is unknown or a value is of the wrong type or
    impossible.
    """
    shipped = tomllib.loads(files("monitor.base").joinpath("default.toml").read_text())
    if path is None:
        return _build(shipped, "default.toml")
    changes = read_toml(path, "the settings", ConfigError)
    for section, values in changes.items():
        if section not in shipped:
            raise ConfigError(f"{path}: section [{section}] is unknown; there are {list(shipped)}")
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: {section} is a section, {values!r} came")
        for key, value in values.items():
            _check(path, section, key, value, shipped[section])
        shipped[section] |= values
    return _build(shipped, str(path))


@cache
def shipped() -> Config:
    """Return the shipped configuration; the file is read once."""
    return load()


def _check(path: Path, section: str, key: str, value: Any, shipped: dict[str, Any]) -> None:
    if key not in shipped:
        raise ConfigError(f"{path}: [{section}] {key} is unknown; there are {list(shipped)}")
    wanted = type(shipped[key])
    texts = wanted is list and all(isinstance(each, str) for each in shipped[key])
    if wanted is list:
        element = str if texts else float
        fits = isinstance(value, list) and all(_is(element, v) for v in value)
        fits = fits and (texts or bool(value))
    else:
        fits = _is(wanted, value)
    if not fits:
        name = f"list of {'names' if texts else 'numbers'}" if wanted is list else wanted.__name__
        raise ConfigError(f"{path}: [{section}] {key} = {value!r}, wanted {name}")
    for number in value if wanted is list else [value]:
        if not texts and wanted is not str:
            _check_size(path, section, key, number)


def _is(wanted: type, value: Any) -> bool:
    """Return whether a value is of a type; an int is a float too, a bool is no number."""
    kinds = int | float if wanted is float else wanted
    return isinstance(value, kinds) and not isinstance(value, bool)


def _check_size(path: Path, section: str, key: str, number: float) -> None:
    name = f"{section}.{key}"
    lowest, highest = _LOWEST.get(name), _HIGHEST.get(name, _MOST)
    above = number >= lowest if lowest is not None else number > 0.0
    if not (above and number <= highest):
        wanted = f"at least {lowest:g}" if lowest is not None else "above 0"
        wanted += f" and at most {highest:g}"
        raise ConfigError(f"{path}: [{section}] {key} = {number}, wanted {wanted}")


def _build(tree: dict[str, Any], where: str) -> Config:
    def section(kind: type[_Section], name: str) -> _Section:
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in tree[name].items()}
        return kind(**values)

    config = Config(
        window=section(WindowConfig, "window"),
        enable=section(EnableConfig, "enable"),
        response=section(ResponseConfig, "response"),
        bias=section(BiasConfig, "bias"),
        movement=section(MovementConfig, "movement"),
        plausibility=section(PlausibilityConfig, "plausibility"),
        catalyst=section(CatalystConfig, "catalyst"),
        debounce=section(DebounceConfig, "debounce"),
        cycles=section(CyclesConfig, "cycles"),
        rules=section(RulesConfig, "rules"),
        obd=section(ObdConfig, "obd"),
        carb=section(ProfileConfig, "carb"),
        eobd=section(ProfileConfig, "eobd"),
    )
    if config.obd.profile not in PROFILES:
        raise ConfigError(
            f"{where}: [obd] profile = {config.obd.profile!r}, wanted one of {list(PROFILES)}"
        )
    if config.catalyst.position not in POSITIONS:
        raise ConfigError(
            f"{where}: [catalyst] position = {config.catalyst.position!r}, "
            f"wanted one of {list(POSITIONS)}"
        )
    enable = config.enable
    for key, low, high in (
        ("engine_speed_{}_rpm", enable.engine_speed_min_rpm, enable.engine_speed_max_rpm),
        (
            "manifold_pressure_{}_kpa",
            enable.manifold_pressure_min_kpa,
            enable.manifold_pressure_max_kpa,
        ),
    ):
        if high <= low:
            raise ConfigError(
                f"{where}: [enable] {key.format('max')} = {high}, wanted above "
                f"{key.format('min')} = {low}"
            )
    bank = config.response
    for lower, higher in (
        ("gain_weak_max", "gain_sound_min"),
        ("gain_transient_max", "gain_slow_min"),
        ("gain_sound_min", "gain_max"),
    ):
        if getattr(bank, lower) >= getattr(bank, higher):
            raise ConfigError(
                f"{where}: [response] {lower} = {getattr(bank, lower)}, wanted below "
                f"{higher} = {getattr(bank, higher)}"
            )
    for key, grid, limit_s in (
        ("lags_s", bank.lags_s, max(bank.lag_limit_s, bank.lag_limit_symmetric_s)),
        ("delays_s", bank.delays_s, bank.delay_limit_s),
    ):
        if max(grid) <= limit_s:
            raise ConfigError(
                f"{where}: [response] {key} = {list(grid)}, wanted one above the limit {limit_s} s"
            )
    return config
