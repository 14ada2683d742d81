"""Configuration: a TOML file becomes frozen objects. An unknown key is an error.

``default.toml`` gives value, bounds and reason of every setting; the unit stands in the key.
"""

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

from monitor.base.files.settings import ShippedSettings, built


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
    timing_s: float
    lag_limit_s: float
    lag_limit_symmetric_s: float
    delay_limit_s: float
    gain_sound_min: float
    gain_weak_max: float
    gain_max: float
    gain_least: float
    gain_memory: float
    noise_least: float
    false_alarm_probability: float
    miss_probability: float
    evidence_alike: float
    evidence_most: float

    @property
    def evidence_fail(self) -> float:
        """Return the log odds from which a fault is called."""
        return math.log((1.0 - self.miss_probability) / self.false_alarm_probability)

    @property
    def evidence_window(self) -> float:
        """Return the most log odds that a window gives, for a model errs for a whole manoeuvre.

        Two such windows decide, whatever their rounding.
        """
        return 0.51 * self.evidence_fail

    @property
    def evidence_pass(self) -> float:
        """Return the log odds from which the sensor is called sound."""
        return math.log((1.0 - self.false_alarm_probability) / self.miss_probability)


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
    visits: int
    end_s: float
    constant_s: float
    start_patience_s: float
    not_ready_s: float
    first_move_s: float
    heater_full_percent: float
    heater_full_s: float
    heater_regulated_s: float
    engine_running_rpm: float


@dataclass(frozen=True, slots=True)
class CatalystConfig:
    """The bank of catalysts with downstream sensors, and the limits of its rule."""

    threshold_g: float
    threshold_margin: float
    capacities_g: tuple[float, ...]
    offsets_phi: tuple[float, ...]
    upstream_lag_s: float
    upstream_lag_most_phi: float
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
    wide_phi: float
    voltage_low_v: float
    voltage_span_v: float
    voltage_std_v: float
    tail: float
    sensor_sound_lags_s: tuple[float, ...]
    sensor_slow_lags_s: tuple[float, ...]
    sensor_late_s: float
    sensor_weak_gains: tuple[float, ...]
    sensor_prior: float
    lean_v: float
    circuit_low_v: float
    circuit_high_v: float
    circuit_s: float
    circuit_after_s: float
    circuit_pass_s: float
    rest_band_v: float
    awake_v: float
    wake_most_s: float
    heater_start_s: float
    position: str
    warm_degc: float
    warm_up_s: float
    hold_s: float
    segment_s: float
    segment_most: float
    rest_range_v: float
    rest_level_v: float
    rest_weight: float
    memory_s: float
    evidence_segments: int
    evidence_most: float
    interval_weight: float
    capacity_model: float
    follow_low: float
    follow_late_s: float
    follow_longest_s: float

    @property
    def close_coupled(self) -> bool:
        """Return whether the judged catalyst is a warm-up catalyst close to the engine."""
        return self.position == "close_coupled"


@dataclass(frozen=True, slots=True)
class MovementConfig:
    """Limits of a reading that does not move, or holds now and then."""

    gain_least: float
    error_share: float
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


_SHIPPED: Final = ShippedSettings("monitor.base")
POSITIONS: Final = _SHIPPED.sections["catalyst"]["position"].one_of  # of the judged catalyst


def load(path: Path | None = None) -> Config:
    """Return the configuration of a TOML file, or the shipped one without a file.

    Sections and keys that the file leaves out keep the shipped value.
    Raises ConfigError with file and key if a key is unknown or a value is of the wrong type or
    impossible.
    """
    return built(Config, _SHIPPED.values() if path is None else _SHIPPED.changed(path))


@cache
def shipped() -> Config:
    """Return the shipped configuration; it is built once."""
    return load()
