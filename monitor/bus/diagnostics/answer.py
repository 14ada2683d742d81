"""Answers to diagnostic requests: choice of the service, and when to stay silent.

Sources: SAE J1979 (services $01 to $0A), ISO 14229-1 (the others, and negative responses).
"""

from dataclasses import replace
from typing import Final

from monitor.bus.diagnostics import obd, uds
from monitor.bus.diagnostics.state import RefusedError, State

NEGATIVE: Final = 0x7F
SERVICE_NOT_SUPPORTED: Final = 0x11
RESPONSE_PENDING: Final = 0x78
CLEARING: Final = (0x04, 0x14)
# Negative responses that are not sent to a functional request: service or subfunction not
# supported, request out of range, subfunction or service not supported in this session.
SILENT_IF_FUNCTIONAL: Final = (0x11, 0x12, 0x31, 0x7E, 0x7F)
SERVICES: Final = {**obd.SERVICES, **uds.SERVICES}


def answer(request: bytes, functional: bool, state: State) -> bytes | None:
    """Return the answer to a request, None for silence.

    functional : the request went to all control units
    """
    if not request:
        return None
    service = SERVICES.get(request[0])
    try:
        if service is None:
            raise RefusedError(SERVICE_NOT_SUPPORTED)
        return service(request, state)
    except RefusedError as refusal:
        if functional and refusal.code in SILENT_IF_FUNCTIONAL:
            return None
        return bytes((NEGATIVE, request[0], refusal.code))


def takes_long(request: bytes, state: State) -> bool:
    """Return whether the answer must wait for a write to disk."""
    if not request or request[0] not in CLEARING:
        return False
    rehearsed = answer(request, False, replace(state, clear=lambda: None))
    return rehearsed is not None and rehearsed[0] != NEGATIVE


def pending(request: bytes) -> bytes:
    """Return the answer "response pending", which makes the tester wait."""
    return bytes((NEGATIVE, request[0], RESPONSE_PENDING))
