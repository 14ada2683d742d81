"""A SocketCAN interface as the kernel knows it, asked and set through ip(8) of iproute2."""

import json
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from monitor.base.errors import BusError

# bit/s, the most frequent first: powertrain, trucks and marine, bench, body
USUAL: Final = (500_000, 250_000, 1_000_000, 125_000, 100_000, 83_333, 50_000, 33_333)
_SECONDS: Final = 10  # for one call of ip


@dataclass(frozen=True, slots=True)
class Interface:
    """What the kernel tells of an interface; None and "" where it tells nothing."""

    name: str
    kind: str = ""  # "can", "vcan" …
    is_up: bool = True
    bitrate: int | None = None
    sample_point: str = ""
    listen_only: bool = False
    state: str = ""  # of the controller, such as "error-active"
    counters: str = ""  # its error counters in words

    @classmethod
    def of(cls, name: str) -> "Interface | None":
        """Return an interface of this machine, None if ip(8) is missing or does not tell.

        Raises BusError if there is no such interface.
        """
        try:
            told = _ip("-details", "-statistics", "-json", "link", "show", "dev", name)
            link: dict[str, Any] = json.loads(told)[0]
        except BusError as error:
            if "does not exist" not in str(error):
                return None
            raise BusError(
                f"no interface {name}: is the adapter plugged in (dmesg, ip link)? for a virtual "
                f"bus: sudo ip link add dev {name} type vcan; sudo ip link set {name} up"
            ) from None
        except (OSError, ValueError, LookupError, subprocess.TimeoutExpired):
            return None  # no ip(8), or one without JSON
        info = link.get("linkinfo", {})
        data, timing = info.get("info_data", {}), info.get("info_data", {}).get("bittiming", {})
        counts = data.get("berr_counter", {}) | info.get("info_xstats", {})
        return cls(
            name,
            info.get("info_kind", ""),
            "UP" in link.get("flags", ()),
            timing.get("bitrate") or data.get("bittiming_bitrate"),
            str(timing.get("sample_point", "")),
            "LISTEN-ONLY" in data.get("ctrlmode", ()),
            data.get("state", "").lower(),
            ", ".join(f"{key.replace('_', ' ')} {n}" for key, n in counts.items() if n),
        )

    @property
    def in_words(self) -> str:
        """Return bit rate, mode, state and error counters."""
        rate = f"{self.bitrate / 1000:g} kbit/s" if self.bitrate else "no bit rate"
        mode = "" if self.kind != "can" else "listen-only" if self.listen_only else "normal mode"
        return ", ".join(part for part in (rate, mode, self.state, self.counters) if part)

    def set(self, bitrate: int, listen_only: bool, sample_point: str = "") -> None:
        """Set the bit rate; raises BusError if the rights are missing or the kernel refuses."""
        mode = ["listen-only", "on" if listen_only else "off"]
        point = ["sample-point", sample_point] if sample_point else []
        _ip("link", "set", self.name, "down")
        _ip("link", "set", self.name, "type", "can", "bitrate", str(bitrate), *point, *mode)
        _ip("link", "set", self.name, "up")

    def scan(self, is_right: Callable[[int], bool]) -> int | None:
        """Return the first usual bit rate that is right, tried listen-only; None if none is.

        The interface is as before afterwards. Raises BusError as ``set``.
        """
        try:
            for bitrate in USUAL:
                self.set(bitrate, listen_only=True)
                if is_right(bitrate):
                    return bitrate
            return None
        finally:
            if self.bitrate:
                self.set(self.bitrate, self.listen_only, self.sample_point)
            if not (self.bitrate and self.is_up):
                _ip("link", "set", self.name, "down")


def _ip(*words: str) -> str:
    """Return the output of ip(8); raises BusError with its message, OSError if it is missing."""
    call = ["ip", *words]
    done = subprocess.run(call, capture_output=True, text=True, timeout=_SECONDS, check=False)
    if done.returncode:
        reason = " ".join(done.stderr.split()) or f"exit code {done.returncode}"
        rights = " (needs root: sudo)" if "not permitted" in reason else ""
        raise BusError(f"{' '.join(call)}: {reason}{rights}")
    return done.stdout
