"""Parameters (PIDs) of SAE J1979 made from canonical signals, encoded as bytes."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final


def unsigned(value: float, length: int) -> bytes:
    """Return a value rounded and limited to ``length`` bytes, most significant first.

    >>> unsigned(300.4, 2), unsigned(-5.0, 1), unsigned(300.0, 1)
    (b'\\x01,', b'\\x00', b'\\xff')
    """
    return round(min(max(value, 0.0), 256.0**length - 1.0)).to_bytes(length, "big")


@dataclass(frozen=True, slots=True)
class ReportedParameter:
    """The signal of a parameter, and its encoding: the number ``scale * value + shift``."""

    signal: str  # canonical name
    length: int  # bytes of the number
    scale: float
    shift: float = 0.0
    tail: bytes = b""  # after the number, where the standard has a value that has no signal

    def encode(self, value: float) -> bytes:
        """Return a value of the signal as bytes."""
        return unsigned(self.scale * value + self.shift, self.length) + self.tail


# Parameters without a canonical signal, such as calculated load, are left out.
PARAMETERS: Final[Mapping[int, ReportedParameter]] = {
    0x03: ReportedParameter("closed_loop", 1, 1.0, 1.0, bytes(1)),  # 1 open, 2 closed loop
    0x05: ReportedParameter("coolant_temperature_degc", 1, 1.0, 40.0),
    0x06: ReportedParameter("lambda_controller", 1, 128.0),
    0x0B: ReportedParameter("manifold_pressure_kpa", 1, 1.0),
    0x0C: ReportedParameter("engine_speed_rpm", 2, 4.0),
    0x0D: ReportedParameter("vehicle_speed_km_h", 1, 1.0),
    0x0F: ReportedParameter("manifold_temperature_degc", 1, 1.0, 40.0),
    0x10: ReportedParameter("maf_kg_h", 2, 100.0 / 3.6),
    0x11: ReportedParameter("throttle_percent", 1, 2.55),
    # the voltage behind the catalyst, then the byte of a sensor that takes no part in the trim
    0x15: ReportedParameter("downstream_voltage_v", 1, 200.0, tail=b"\xff"),
    0x23: ReportedParameter("rail_pressure_mpa", 2, 100.0),
    # the sensor's voltage behind it is not known
    0x24: ReportedParameter("lambda_measured", 2, 32768.0, tail=bytes(2)),
    0x25: ReportedParameter("downstream_lambda", 2, 32768.0, tail=bytes(2)),
    0x2E: ReportedParameter("purge_duty_percent", 1, 2.55),
    0x33: ReportedParameter("ambient_pressure_kpa", 1, 1.0),
    0x3C: ReportedParameter("catalyst_temperature_degc", 2, 10.0, 400.0),
    0x42: ReportedParameter("battery_voltage_v", 2, 1000.0),
    0x44: ReportedParameter("lambda_target", 2, 32768.0),
    0x46: ReportedParameter("ambient_temperature_degc", 1, 1.0, 40.0),
}


def encoded(values: Mapping[str, float]) -> dict[int, bytes]:
    """Return the parameters of the available signals, by number."""
    return {
        number: parameter.encode(values[parameter.signal])
        for number, parameter in PARAMETERS.items()
        if parameter.signal in values
    }


def bitmaps(supported: Collection[int]) -> dict[int, bytes]:
    """Return, by the number before them, four bytes that mark the supported ones among 32 numbers.

    The last bit marks that a higher number is supported; behind the highest there is no more.

    >>> bitmaps({0x01, 0x1C, 0x21})[0x00].hex(), bitmaps({0x01}).keys()
    ('80000011', dict_keys([0]))
    """
    highest = max(supported, default=0)
    bits = {
        base: sum(1 << base + 32 - n for n in supported if base < n <= base + 32)
        for base in range(0, highest or 1, 32)
    }
    return {b: (each | (highest > b + 32)).to_bytes(4, "big") for b, each in bits.items()}
