"""A store of codes in the states that tests start from."""

from monitor.base.config import ProfileConfig, shipped
from monitor.memory.dtc import Dtc
from monitor.memory.dtc_store import DtcStore, Saved
from monitor.memory.obd_records import FreezeFrame

CARB = shipped().carb


def code_of(store: DtcStore, code: str) -> Dtc:
    return next(dtc for dtc in store.all if dtc.code == code)


def states(store: DtcStore) -> dict[str, str | None]:
    return {dtc.code: dtc.state for dtc in store.active}


def confirmed(
    fault: str = "biased_lean", profile: ProfileConfig = CARB, saved: Saved | None = None
) -> DtcStore:
    """Return a store in which a fault has just been confirmed."""
    store = DtcStore(saved, profile)
    for _ in range(profile.confirm_cycles):
        store.start_driving_cycle()
        store.fail(fault, 1)
    return store


def heal(store: DtcStore, test: str = "bias", cycles: int = CARB.lamp_off_cycles) -> None:
    """Drive until the lamp is off; the cycle after it has begun."""
    for _ in range(cycles):
        store.start_driving_cycle()
        store.complete(test)
    store.start_driving_cycle()


def frame_of(code: str, t_ns: int) -> FreezeFrame:
    return FreezeFrame(code, t_ns, {"engine_speed_rpm": 1000.0 + t_ns})


def failing(store: DtcStore, fault: str, t_ns: int) -> None:
    for dtc in store.fail(fault, t_ns):
        store.freeze(frame_of(dtc.code, t_ns))
