"""Jobs side by side on this machine."""

import os
import time

import pytest

from training.jobs import parallel, worker


def job(shared: int, item: int) -> int:
    """Add two numbers; a negative item kills the process."""
    if item < 0:
        time.sleep(0.2)  # so that the one before it is done
        os._exit(9)
    return shared + item


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_job_comes_back_under_its_key(jobs: int) -> None:
    items = {f"job {i}": i for i in range(9)}
    found = dict(parallel.run(job, 100, items.items(), jobs=jobs))
    assert found == {key: 100 + i for key, i in items.items()}


def test_a_job_whose_process_dies_is_named() -> None:
    jobs = [("good", 1), ("bad", -1)]
    with pytest.raises(worker.WorkerDiedError, match=r"a worker died.*bad") as died:
        list(parallel.run(job, 0, jobs, jobs=2))
    assert died.value.keys in (("bad",), ("good", "bad"))
