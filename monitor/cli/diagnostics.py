"""Options of ``o2mon run`` that answer diagnostic testers on ISO-TP."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated

from monitor.base.errors import UsageError
from monitor.cli.options import say

if TYPE_CHECKING:
    from monitor.bus.attachment import Attachment
    from monitor.bus.loop import Loop
    from monitor.pipeline.replay import Setup

_MISSING = "can-isotp is not installed; pip install '.[diagnostics]' in the project's folder"


@dataclass(frozen=True, kw_only=True)
class DiagnosticsOptions:
    """What is sent on the bus.

    transmit : send fault flag and codes on the bus
    diagnostics_id : identifier of the answers to testers: 7E9 to 7EF, 18DAF1xx, or none (default:
        7E9; needs --transmit)
    vin : vehicle identification number that testers read
    clear_while_running : let testers clear codes while the engine runs or its speed is unknown
    """

    transmit: bool = False
    diagnostics_id: Annotated[str | None, "HEX"] = None
    vin: str | None = None
    clear_while_running: bool = False


def diagnostics(
    args: DiagnosticsOptions, setup: "Setup", loop: "Loop", tell: Callable[[str], None] = say
) -> "list[Attachment]":
    """Return the attachment that answers testers, in a list; an empty list if there is none.

    tell : receives the reason why there is no diagnostics
    Raises UsageError if the options contradict or can-isotp is missing.
    """
    asked, is_none = args.diagnostics_id not in (None, "none"), args.diagnostics_id == "none"
    if is_none or not args.transmit:
        if asked or args.vin or args.clear_while_running:
            why = "not with --diagnostics-id none" if is_none else "only with --transmit"
            raise UsageError(f"diagnostics answers {why}")
        return []
    if find_spec("isotp") is None:
        if asked:
            raise UsageError(_MISSING)
        tell(f"no diagnostics: {_MISSING}")
        return []
    from monitor.bus.diagnostics.server import DEFAULT_RESPONSE_ID, Diagnostics
    from monitor.bus.diagnostics.state import Identity, State

    monitor, config = loop.pipeline.monitor, setup.config
    state = State(
        store=monitor.store,
        identity=Identity(
            model_name=setup.model.path.name,
            model_sha256=setup.model.sha256,
            profile=config.obd.profile,
            vin=args.vin,
        ),
        clear=loop.clear_codes,
        names=monitor.names,
        running_rpm=config.plausibility.engine_running_rpm,
        clear_while_running=args.clear_while_running,
    )
    return [Diagnostics(state, args.diagnostics_id or DEFAULT_RESPONSE_ID)]
