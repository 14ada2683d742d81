"""Jobs side by side on this machine."""

import pytest

from tests.helpers import deadly
from training.jobs import parallel, worker


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_job_comes_back_under_its_key(jobs: int) -> None:
    items = {f"job {i}": i for i in range(9)}
    found = dict(parallel.run(deadly.job, 100, items.items(), jobs=jobs))
    assert found == {key: 100 + i for key, i in items.items()}


def test_a_job_whose_process_dies_is_named() -> None:
    jobs = [("good", 1), ("bad", -1)]
    with pytest.raises(worker.WorkerDiedError, match=r"a worker died.*bad") as died:
        list(parallel.run(deadly.job, 0, jobs, jobs=2))
    assert died.value.keys in (("bad",), ("good", "bad"))
