"""Jobs side by side on this machine."""

import os

import pytest

from tests.helpers import deadly
from training.jobs import parallel, worker
from training.jobs.second_process import beside


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


@pytest.mark.parametrize("is_long", [False, True])
def test_a_long_job_is_done_beside_this_process(is_long: bool) -> None:
    with beside(deadly.alone, 3, is_long=is_long) as result:
        found, process = result()
    assert found == 4
    assert (process != os.getpid()) == is_long


def test_on_a_single_core_a_long_job_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("joblib.cpu_count", lambda: 1)
    with beside(deadly.alone, 3, is_long=True) as result:
        assert result() == (4, os.getpid())


def test_a_job_beside_this_process_that_dies_is_named() -> None:
    with (
        beside(deadly.alone, -1, is_long=True) as result,
        pytest.raises(worker.WorkerDiedError, match="alone"),
    ):
        result()
