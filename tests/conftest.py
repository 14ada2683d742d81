"""What all tests share: one thread per numeric library, property test profile, shared data."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# Before any test imports numpy: one thread is the fastest on small matrices.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_threads] = "1"

ROOT = Path(__file__).resolve().parent.parent

settings.register_profile("default", deadline=None)
# A case that is found elsewhere is printed, and becomes an @example of its test.
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tests that mostly wait for a bus, so that others run beside them."""
    items.sort(key=lambda item: "run_with_vcan" not in getattr(item, "fixturenames", ()))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Give the folder of real recordings beside the repository, or skip."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the shared recordings (../shared/data beside the repository) are not here")
    return folder
