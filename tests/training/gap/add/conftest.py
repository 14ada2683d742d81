"""The network that effects are added to: trained once for the tests of this folder."""

import pytest

from tests.helpers.gap.gap_networks import small_network
from training.narx.fit import FitResult


@pytest.fixture(scope="session")
def base(tmp_path_factory: pytest.TempPathFactory) -> FitResult:
    return small_network(tmp_path_factory.mktemp("base"))
