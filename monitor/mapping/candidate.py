"""One signal of a database that could be a canonical one."""

from dataclasses import dataclass

from cantools.database.can import Message, Signal


@dataclass(frozen=True, slots=True)
class Candidate:
    """One signal that could be the canonical one: value = factor * signal + offset."""

    name: str  # canonical
    message: Message
    signal: Signal
    confidence: float  # 0 to 1
    factor: float
    offset: float
    why: tuple[str, ...]
    blocked: str = ""  # why it is never proposed, only shown
    is_phi: bool = False  # the signal is 1 / lambda
    is_stated: bool = False  # something says that its sensor is the upstream one

    @property
    def place(self) -> str:
        """Return message and signal."""
        return f"{self.message.name}.{self.signal.name}"
