"""The sensor's gain by how much the reading moves, for a model whose errors lower the other gain.

Least squares take a reading that does not follow the prediction for that of a weak sensor: errors
in the prediction lower the slope (Fuller, Measurement Error Models, section 1.1). The movement of
the reading over that of the prediction is lowered much less. It grows where the engine does what
the model does not know, so only a low one says something.
"""

from monitor.base.config import ResponseConfig


class MovementGain:
    """The gain by the movement in all windows so far, the older ones fading.

    Before them the reading is supposed to have moved as a sound one's for ``movement_known``
    windows, which moved as these did.

    healthy : movement of healthy readings over that of the prediction
    """

    def __init__(self, config: ResponseConfig, healthy: float) -> None:
        self._config, self._healthy = config, healthy
        self.reset()

    def reset(self) -> None:
        """Forget all windows."""
        self._windows = self._moved = self._expected = 0.0

    def add(self, moved: float, predicted: float) -> None:
        """Take the squared movement of the reading and of the prediction in a window."""
        memory = self._config.gain_memory
        self._windows = memory * self._windows + 1.0
        self._moved = memory * self._moved + moved
        self._expected = memory * self._expected + self._healthy**2 * predicted

    @property
    def is_weak(self) -> bool:
        """Return whether the reading moves as little as that of a weak sensor."""
        if not self._windows:
            return False
        known = self._config.movement_known * self._expected / self._windows
        return self._moved + known <= self._config.gain_weak_max**2 * (self._expected + known)
