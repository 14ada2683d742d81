"""The bytes in the data of identifiers, parameters and records."""

from dataclasses import dataclass
from typing import Final, Literal

from monitor.bus.diagnostics.parameters import PARAMETERS, Parameter

TO_THE_END: Final = 0


@dataclass(frozen=True, slots=True)
class Field:
    """One value; the physical one is ``factor * number + offset``."""

    name: str
    length: int = 1  # bytes, or TO_THE_END
    kind: Literal["number", "float", "text", "bytes"] = "number"
    factor: float = 1.0
    offset: float = 0.0


Fields = tuple[Field, ...]


def of_parameter(parameter: Parameter) -> Fields:
    """Return the fields of a parameter of SAE J1979, in the unit of its signal."""
    number = Field(
        parameter.signal,
        parameter.length,
        factor=1.0 / parameter.scale,
        offset=-parameter.shift / parameter.scale,
    )
    tail = len(parameter.tail)
    return (number, Field("not_used", tail, "bytes")) if tail else (number,)


SIGNALS: Final[dict[int, Fields]] = {n: of_parameter(p) for n, p in PARAMETERS.items()}
CURRENT: Final[dict[int, Fields]] = {  # parameters that the monitor itself has
    0x01: (Field("readiness", 4, "bytes"),),
    0x1C: (Field("obd_standard"),),
    0x21: (Field("distance_with_mil_km", 2),),
    0x30: (Field("warm_ups_since_clear"),),
    0x31: (Field("distance_since_clear_km", 2),),
    0x41: (Field("readiness_of_cycle", 4, "bytes"),),
    0x4D: (Field("engine_run_with_mil_min", 2),),
    0x4E: (Field("engine_run_since_clear_min", 2),),
}
SUPPORTED: Final[Fields] = (Field("supported", 4, "bytes"),)
INFORMATION: Final[dict[int, Fields]] = {
    0x02: (Field("vin", 17, "text"),),
    0x04: (Field("calibration_id", 16, "text"),),
    0x06: (Field("calibration_verification_number", 4, "bytes"),),
    0x08: (Field("in_use_performance", 40, "bytes"),),
    0x0A: (Field("ecu_name", 20, "bytes"),),
}
PROTOCOL: Final[Fields] = (Field("protocol"),)
RESULT: Final[Fields] = (  # of one test
    Field("test"),
    Field("unit_and_scaling"),
    Field("value", 2),
    Field("low", 2),
    Field("high", 2),
)
IDENTIFIERS: Final[dict[int, Fields]] = {
    0xF186: (Field("session"),),
    0xF18A: (Field("supplier", TO_THE_END, "text"),),
    0xF190: (Field("vin", 17, "text"),),
    0xF195: (Field("software_version", TO_THE_END, "text"),),
    0xF197: (Field("system_name", TO_THE_END, "text"),),
    0xFD00: (Field("model_sha256", 32, "bytes"),),
    0xFD01: (Field("model_name", TO_THE_END, "text"),),
    0xFD02: (Field("measured", 4, "float"),),
    0xFD03: (Field("predicted", 4, "float"),),
    0xFD04: (Field("residual", 4, "float"),),
    0xFD05: (Field("enabled"),),
    0xFD06: (Field("conditions", 4),),
    0xFD07: (Field("windows", 4),),
    0xFD08: (Field("verdict"), Field("mean", 4, "float"), Field("std", 4, "float")),
    0xFD09: (Field("samples", 4), Field("enabled_samples", 4)),
    0xFD0A: (Field("fault_flag_and_lamp"),),
    0xFD0B: (Field("ignored_frames", 4), Field("failed_transfers", 4)),
}
EXTENDED: Final[dict[int, Fields]] = {  # extended data records of a code
    0x01: (Field("failed_cycles"),),
    0x02: (Field("passed_cycles"),),
    0x03: (Field("warm_ups"),),
    0x04: (Field("is_permanent"),),
    0x05: (Field("numerator", 2), Field("denominator", 2)),
    0x91: (Field("numerator", 2), Field("denominator", 2)),
}
