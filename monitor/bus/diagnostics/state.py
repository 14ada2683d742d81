"""State for diagnostic answers: fault memory, identity and the pipeline's latest events."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from monitor.base.errors import O2Error, UsageError
from monitor.memory.dtc_store import DtcStore
from monitor.pipeline.events import Event, Tick

DEFAULT_SESSION: Final = 0x01
EXTENDED_SESSION: Final = 0x03


class RefusedError(Exception):
    """A request gets a negative response; ``code`` is its reason (ISO 14229-1, annex A)."""

    def __init__(self, code: int) -> None:
        super().__init__(f"negative response 0x{code:02X}")
        self.code = code


@dataclass(frozen=True, slots=True)
class Identity:
    """Identification of the monitor and its model."""

    model_name: str  # file name
    model_sha256: str
    profile: str  # "carb" or "eobd"
    vin: str | None = None

    def __post_init__(self) -> None:
        if self.vin is not None and not re.fullmatch(r"[A-HJ-NPR-Z0-9]{17}", self.vin):
            raise UsageError(
                f"vehicle identification number {self.vin!r}: wanted 17 capitals and digits "
                "without I, O and Q"
            )

    @property
    def calibration_id(self) -> str:
        """Return at most 16 characters that identify the model."""
        stem = self.model_name.rpartition(".")[0] or self.model_name
        ascii_stem = stem.encode("ascii", "replace").decode()
        return f"{ascii_stem[:7]}-{self.model_sha256[:8]}"


@dataclass(slots=True)
class State:
    """Everything that an answer depends on.

    clear : clears the codes and stores the change
    names : names of the signals in a sample
    running_rpm : the engine runs from this speed on
    """

    store: DtcStore
    identity: Identity
    clear: Callable[[], None]
    names: Sequence[str]
    running_rpm: float
    clear_while_running: bool = False
    session: int = DEFAULT_SESSION
    tick: Tick | None = None

    def push(self, event: Event) -> None:
        """Keep the latest sample."""
        if isinstance(event, Tick):
            self.tick = event

    @property
    def values(self) -> dict[str, float]:
        """Return the latest good value of each signal, in its unit."""
        if self.tick is None:
            return {}
        pairs = zip(self.names, self.tick.sample.values.tolist(), strict=True)
        return {name: value for name, value in pairs if math.isfinite(value)}

    def try_to_clear(self, failure: int) -> None:
        """Clear the codes; raise RefusedError if the engine runs or its speed is unknown.

        failure : reason of the refusal if the change cannot be stored
        """
        speed_rpm = self.values.get("engine_speed_rpm", math.inf)
        if speed_rpm >= self.running_rpm and not self.clear_while_running:
            raise RefusedError(0x22)
        try:
            self.clear()
        except O2Error:
            raise RefusedError(failure) from None
