"""Parameters (PIDs) of SAE J1979 made from canonical signals, encoded as bytes."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Final


def unsigned(value: float, length: int) -> bytes:
    """Return a value rounded and limited to ``length`` bytes, most significant first.

    >>> unsigned(300.4, 2), unsigned(-5.0, 1), unsigned(300.0, 1)
    (b'\\x01,', b'\\x00', b'\\xff')
    """
    return round(min(max(value, 0.0), 256.0**length - 1.0)).to_bytes(length, "big")


@dataclass(frozen=True, slots=True)
class Parameter:
    """The signal of a parameter, and its encoding."""

    signal: str  # canonical name
    encode: Callable[[float], bytes]


# Parameters without a canonical signal, such as calculated load, are left out.
PARAMETERS: Final[Mapping[int, Parameter]] = {
    0x03: Parameter("closed_loop", lambda on: bytes((2 if on > 0.5 else 1, 0))),
    0x05: Parameter("coolant_temperature_degc", lambda degc: unsigned(degc + 40.0, 1)),
    0x06: Parameter("lambda_controller", lambda factor: unsigned(128.0 * factor, 1)),
    0x0B: Parameter("manifold_pressure_kpa", lambda kpa: unsigned(kpa, 1)),
    0x0C: Parameter("engine_speed_rpm", lambda rpm: unsigned(4.0 * rpm, 2)),
    0x0D: Parameter("vehicle_speed_km_h", lambda km_h: unsigned(km_h, 1)),
    0x0F: Parameter("manifold_temperature_degc", lambda degc: unsigned(degc + 40.0, 1)),
    0x10: Parameter("maf_kg_h", lambda kg_h: unsigned(100.0 * kg_h / 3.6, 2)),
    0x11: Parameter("throttle_percent", lambda percent: unsigned(2.55 * percent, 1)),
    # the voltage behind the catalyst, then the byte of a sensor that takes no part in the trim
    0x15: Parameter("downstream_voltage_v", lambda volt: unsigned(200.0 * volt, 1) + b"\xff"),
    0x23: Parameter("rail_pressure_mpa", lambda mpa: unsigned(100.0 * mpa, 2)),
    # lambda in two bytes, then two zero bytes for the sensor voltage, which has no signal
    0x24: Parameter("lambda_measured", lambda x: unsigned(32768.0 * x, 2) + bytes(2)),
    0x2E: Parameter("purge_duty_percent", lambda percent: unsigned(2.55 * percent, 1)),
    0x33: Parameter("ambient_pressure_kpa", lambda kpa: unsigned(kpa, 1)),
    0x3C: Parameter("catalyst_temperature_degc", lambda degc: unsigned(10.0 * (degc + 40.0), 2)),
    0x42: Parameter("battery_voltage_v", lambda volt: unsigned(1000.0 * volt, 2)),
    0x44: Parameter("lambda_target", lambda x: unsigned(32768.0 * x, 2)),
    0x46: Parameter("ambient_temperature_degc", lambda degc: unsigned(degc + 40.0, 1)),
}


def encoded(values: Mapping[str, float]) -> dict[int, bytes]:
    """Return the parameters of the available signals, by number."""
    return {
        number: parameter.encode(values[parameter.signal])
        for number, parameter in PARAMETERS.items()
        if parameter.signal in values
    }


def bitmap(supported: Collection[int], base: int) -> bytes | None:
    """Return four bytes that mark the supported numbers among the 32 after ``base``.

    The last bit marks that a higher number is supported. None if no number above ``base`` is.

    >>> bitmap({0x01, 0x1C, 0x41}, 0x00).hex(), bitmap({0x01}, 0x20)
    ('80000011', None)
    """
    if base % 0x20 or (base and max(supported, default=0) <= base):
        return None
    bits = sum(1 << base + 32 - number for number in supported if base < number <= base + 32)
    return (bits | any(number > base + 32 for number in supported)).to_bytes(4, "big")
