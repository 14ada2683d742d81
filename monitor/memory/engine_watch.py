"""Engine starts: within a driving cycle, or the begin of the next one."""

from monitor.base.config import CyclesConfig
from monitor.memory.denominator import whole_ns


class EngineWatch:
    """Tells engine starts within a driving cycle from those that begin the next one."""

    def __init__(self, config: CyclesConfig) -> None:
        self._off_ns, self._silent_ns = whole_ns(config.engine_off_s), whole_ns(config.silent_s)
        self._has_run = False  # since the first sample
        self._restart()

    def _restart(self) -> None:
        self._stopped_ns = 0  # since the engine was last seen running
        self._silence_ns = 0  # of the ECU, at present
        self._was_asleep = False  # the ECU was silent for long since then
        self._stood = False  # and was heard again with the engine standing

    def stand(self, elapsed_ns: int, *, is_silent: bool, is_standing: bool) -> None:
        """Take samples that are alike and in which the engine does not run."""
        self._stopped_ns += elapsed_ns
        self._silence_ns = self._silence_ns + elapsed_ns if is_silent else 0
        self._was_asleep |= self._silence_ns >= self._silent_ns
        self._stood |= self._was_asleep and is_standing

    def run(self) -> tuple[bool, bool]:
        """Take a sample in which it runs; return whether it started, and to a new cycle.

        The very first start belongs to the driving cycle that has begun already.
        """
        if self._has_run and self._stopped_ns == 0:
            return False, False
        is_next = self._has_run and (self._stood or self._stopped_ns >= self._off_ns)
        self._has_run = True
        self._restart()
        return True, is_next
