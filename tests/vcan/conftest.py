"""A virtual CAN bus for the tests that need the kernel's own."""

import os
from collections.abc import Callable

import pytest

from tests.vcan import guest


@pytest.fixture(scope="session")
def run_with_vcan() -> Callable[..., guest.Finished]:
    """Give ``guest.run_with_vcan`` where it can work; otherwise skip, or fail where it must."""
    try:
        guest.find_place()
    except guest.VcanUnavailableError as unavailable:
        if os.environ.get("O2_REQUIRE_VCAN") == "1":
            pytest.fail(f"O2_REQUIRE_VCAN=1, but {unavailable}")
        pytest.skip(str(unavailable))
    return guest.run_with_vcan
