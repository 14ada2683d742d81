"""Decision limits that depend on the vehicle, as they stand in the model card."""

from dataclasses import dataclass, fields

from monitor.config import Config
from monitor.errors import ConfigError, ModelError
from monitor.model_card import ModelCard


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one model; ``noise`` and ``excitation`` are oriented like phi."""

    j_mu: float  # paper's rule, mean of the residual, output's unit
    j_sigma: float  # paper's rule, standard deviation of the residual, output's unit
    noise: float  # healthy residual in enabled windows, standard deviation
    excitation: float  # least standard deviation of the prediction that makes a window judgeable
    offset: float  # bias, output's unit

    @classmethod
    def from_card(cls, card: ModelCard, config: Config, where: str) -> "Limits":
        """Return the limits of a card; settings may raise offset and excitation, never lower them.

        Raises ModelError naming the file if a limit is missing, ConfigError if the limits were set
        for windows of another length.
        """
        missing = [f.name for f in fields(cls) if f.name not in card.limits]
        if missing:
            raise ModelError(f"{where}: the model card has no limit {', '.join(missing)}")
        if card.window_samples != config.window.n_samples:
            raise ConfigError(
                f"{where}: its limits are for windows of {card.window_samples} samples, "
                f"[window] n_samples is {config.window.n_samples}"
            )
        values = {f.name: card.limits[f.name].value for f in fields(cls)}
        excitation = config.response.excitation_noise * values["noise"]
        values["excitation"] = max(values["excitation"], excitation)
        if card.transform == "phi":
            values["offset"] = max(values["offset"], config.bias.offset_limit_lambda)
        return cls(**values)
