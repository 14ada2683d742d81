"""Decision limits: of one model, as they stand in its card, and of one vehicle with a reference."""

from dataclasses import dataclass, replace
from math import inf
from typing import Final

from monitor.base.config import BiasConfig, Config
from monitor.base.errors import ConfigError, ModelError
from monitor.judge.trust import UNKNOWN, Trust
from monitor.memory.codes import TESTS
from monitor.memory.reference import Reference
from monitor.model.card import ModelCard

NAMES: Final = "j_mu", "j_sigma", "noise", "noise_memory", "offset", "offset_std"  # in each card
OPTIONAL: Final = "evidence", "evidence_gain", "gain_model"
STILL: Final = TESTS["activity"]


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one model on one vehicle, by default none; ``noise`` is oriented like phi."""

    j_mu: float = inf  # paper's rule, mean of the residual, output's unit
    j_sigma: float = inf  # paper's rule, standard deviation of the residual, output's unit
    noise: float = 1.0  # healthy residual in enabled windows, standard deviation
    noise_memory: float = 0.0  # its correlation from one sample to the next
    offset_low: float = -inf  # bias, output's unit
    offset_high: float = inf
    offset_std: float = 1.0  # of healthy windows' means, output's unit
    evidence: float = 0.5  # weight of a window's edges, which tell the timing
    evidence_gain: float = 1.0  # weight of its amplitude, which tells the gain
    gain_model: float = 1.0  # amplitude of healthy readings over that of the prediction
    gain: float = 1.0  # of this vehicle's healthy sensor, relative to gain_model
    trust: Trust = UNKNOWN  # what the model finds and mistakes

    @property
    def gain_expected(self) -> float:
        """Return measurement over prediction of this vehicle's healthy sensor."""
        return self.gain_model * self.gain

    @property
    def innovation_var(self) -> float:
        """Return the variance of the new part of each sample of the healthy residual."""
        return self.noise**2 * (1.0 - self.noise_memory**2)

    @classmethod
    def from_card(cls, card: ModelCard, config: Config, where: str) -> "Limits":
        """Return the limits of a card, for a vehicle without a reference.

        Settings may raise offset and its spread, never lower them. Raises ModelError naming
        the file if a limit is missing, ConfigError if the limits were set for windows of
        another length.
        """
        missing = [name for name in NAMES if name not in card.limits]
        if missing:
            raise ModelError(
                f"{where}: the model card has no limit {', '.join(missing)}, so it predicts, "
                "but cannot judge: fit it to more driving, or give healthy drives to "
                "o2train calibrate; without --model, a logger's file gets the electrical tests"
            )
        if card.window_samples != config.window.n_samples:
            raise ConfigError(
                f"{where}: its limits are for windows of {card.window_samples} samples, "
                f"[window] n_samples is {config.window.n_samples}"
            )
        values = {k: own.value for k, own in card.limits.items() if k in (*NAMES, *OPTIONAL)}
        offset = values.pop("offset")
        trust = Trust.from_card(card.trust, where)
        if "still_s" in card.limits:  # of an earlier version: the healthy reading stands still
            trust = replace(trust, false={**(trust.false or {}), **dict.fromkeys(STILL, 1)})
        if card.transform == "phi":
            offset = max(offset, config.bias.offset_limit_lambda)
            values["offset_std"] = max(values["offset_std"], config.bias.window_std_lambda)
        return cls(**values, offset_low=-offset, offset_high=offset, trust=trust)

    def of_vehicle(self, reference: Reference, config: BiasConfig) -> "Limits":
        """Return the limits of the vehicle that the reference was learned on."""
        if reference.drives == 0:
            return self
        low, high = reference.offset_range(config)
        return replace(self, offset_low=low, offset_high=high, gain=reference.gain)


def in_unit(config: Config, card: ModelCard) -> Config:
    """Return the settings for a model's output; what is in lambda is a share of another's range."""
    span, own = card.output.maximum - card.output.minimum, config.plausibility
    if card.transform == "phi":
        return config
    still, band = span * own.stuck_range, span * own.stuck_band_at_one
    return replace(config, plausibility=replace(own, stuck_range=still, stuck_band_at_one=band))


NO_LIMITS: Final = Limits()  # judge nothing, for windows alone
