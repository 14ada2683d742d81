"""Bounds of the settings: type and size of each value, and relations between values."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from monitor.base.errors import ConfigError

if TYPE_CHECKING:
    from monitor.base.config import Config

PROFILES: Final = ("carb", "eobd")
POSITIONS: Final = ("underfloor", "close_coupled")  # of the judged catalyst

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
    "response.timing_s": 0.0,
    "response.gain_late_min": 0.0,
    "response.excitation_noise": 0.0,
    "response.evidence_alike": 0.0,
    "response.gain_known": 0.0,
    "response.gain_least": 0.0,
    "response.gain_memory": 0.0,
    "response.movement_known": 0.0,
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
    "plausibility.first_move_s": 0.0,
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
    "response.timing_s": 60.0,
}
_MOST: Final = 1e6  # of any other number: 11 days, or so many samples


def check_value(path: Path, section: str, key: str, value: Any, shipped: dict[str, Any]) -> None:
    """Raise ConfigError if a section has no such key, or its value is of another type or size.

    shipped : the section as shipped, whose values have the types that are wanted
    """
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


def check_together(config: "Config", where: str) -> None:
    """Raise ConfigError if values contradict each other; ``where`` names the file."""
    _check_choices(config, where)
    _check_order(config, where)
    _check_bank(config, where)


def _check_choices(config: "Config", where: str) -> None:
    if config.obd.profile not in PROFILES:
        raise ConfigError(
            f"{where}: [obd] profile = {config.obd.profile!r}, wanted one of {list(PROFILES)}"
        )
    if config.catalyst.position not in POSITIONS:
        raise ConfigError(
            f"{where}: [catalyst] position = {config.catalyst.position!r}, "
            f"wanted one of {list(POSITIONS)}"
        )


def _check_order(config: "Config", where: str) -> None:
    """A value that bounds another from below must lie under it."""
    for table, lower, higher in (
        ("enable", "engine_speed_min_rpm", "engine_speed_max_rpm"),
        ("enable", "manifold_pressure_min_kpa", "manifold_pressure_max_kpa"),
        ("response", "gain_weak_max", "gain_sound_min"),
        ("response", "gain_transient_max", "gain_slow_min"),
        ("response", "gain_sound_min", "gain_max"),
    ):
        low, high = (getattr(getattr(config, table), key) for key in (lower, higher))
        if low >= high:
            raise ConfigError(f"{where}: [{table}] {lower} = {low}, wanted below {higher} = {high}")


def _check_bank(config: "Config", where: str) -> None:
    """The bank of hypotheses must reach beyond the limits."""
    bank = config.response
    for key, grid, limit_s in (
        ("lags_s", bank.lags_s, max(bank.lag_limit_s, bank.lag_limit_symmetric_s)),
        ("delays_s", bank.delays_s, bank.delay_limit_s),
    ):
        if max(grid) <= limit_s:
            raise ConfigError(
                f"{where}: [response] {key} = {list(grid)}, wanted one above the limit {limit_s} s"
            )
