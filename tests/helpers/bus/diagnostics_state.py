"""A fault memory with something in it, and what diagnostics answers from."""

import numpy as np

from monitor.base.errors import RecordingError
from monitor.base.types import Sample
from monitor.bus.diagnostics.server import answer
from monitor.bus.diagnostics.state import Identity, State
from monitor.memory.dtc import Dtc, Status
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.obd_records import Counts, FreezeFrame, Ratio, TestResult
from monitor.pipeline.events import Tick

SHA256 = "0123456789abcdef" * 4
VIN = "WVWZZZ1JZXW386759"
NAMES = ("engine_speed_rpm", "lambda_measured", "coolant_temperature_degc")
CONFIRMED = Status.CONFIRMED | Status.WARNING_INDICATOR | Status.PENDING | Status.TEST_FAILED
FRAME = FreezeFrame(
    "P0133",
    5,
    {
        "coolant_temperature_degc": 90.0,
        "manifold_pressure_kpa": 45.0,
        "engine_speed_rpm": 2000.0,
        "vehicle_speed_km_h": 80.0,
        "manifold_temperature_degc": 30.0,
        "maf_kg_h": 36.0,
        "throttle_percent": 20.0,
        "rail_pressure_mpa": 10.0,
        "lambda_measured": 1.0,
        "lambda_target": 0.9,
        "closed_loop": 1.0,
        "lambda_controller": 1.05,
        "purge_duty_percent": 40.0,
        "ambient_pressure_kpa": 100.0,
        "battery_voltage_v": 12.5,
        "ambient_temperature_degc": 20.0,
        "fuel_mass_mg": 12.0,  # has no parameter
    },
)


def saved() -> Saved:
    return Saved(
        dtcs=(
            Dtc("P0133", "slow_symmetric", status=CONFIRMED, failed_cycles=2),
            Dtc("P2195", "biased_lean", status=Status.PENDING, passed_cycles=1, warm_ups=3),
        ),
        freeze_frames=(FRAME,),
        permanent={"P0133": "slow_symmetric"},
        results=(
            TestResult("response", "lag_rich_to_lean_s", 0.31, float("-inf"), 0.25),
            TestResult("bias", "offset", -0.02, -0.05, 0.05),
        ),
        ratios=(Ratio("response", 3, 5), Ratio("bias", 4, 5), Ratio("activity", 5, 5)),
        counts=Counts(
            ignition_cycles=11,
            general_denominator=9,
            warm_ups_since_clear=7,
            distance_since_clear_km=123.4,
            distance_with_mil_km=50.6,
            engine_run_with_mil_s=3600.0,
            engine_run_since_clear_s=7200.0,
        ),
        completed=frozenset({"response", "bias", "activity"}),
    )


def tick(engine_speed_rpm: float, lambda_measured: float = 1.02) -> Tick:
    """Return a sample of NAMES that went through the model."""
    values = np.array([engine_speed_rpm, lambda_measured, 90.0])
    sample = Sample(0, 0, values, np.zeros(3, dtype=np.uint8))
    return Tick(sample, 1.0, (True, False, True), False)


class Vehicle:
    """Clears like the loop does, and counts that."""

    def __init__(self, engine_speed_rpm: float | None = 0.0, *, vin: str | None = VIN) -> None:
        self.store, self.clearings, self.fails = DtcStore(saved()), 0, False
        self.state = State(
            store=self.store,
            identity=Identity("shipped.onnx", SHA256, "carb", vin),
            clear=self.clear,
            names=NAMES,
            running_rpm=500.0,
        )
        if engine_speed_rpm is not None:
            self.state.push(tick(engine_speed_rpm))

    def clear(self) -> None:
        if self.fails:
            raise RecordingError("disk full")
        self.clearings += 1
        self.store.clear()


def ask(request: str, vehicle: Vehicle | None = None, *, functional: bool = False) -> str | None:
    found = answer(bytes.fromhex(request), functional, (vehicle or Vehicle()).state)
    return None if found is None else found.hex(" ")
