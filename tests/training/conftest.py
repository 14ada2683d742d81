"""What tests of training share: a browser that opens their pages."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from tests.helpers.bus.chromium import chromium


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as running:
        yield running
