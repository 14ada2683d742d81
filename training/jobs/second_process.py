"""A long job in a second process of this machine, beside the work of this one."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

import joblib
from joblib.externals.loky.process_executor import ProcessPoolExecutor, TerminatedWorkerError
from threadpoolctl import threadpool_limits

from training.jobs.worker import WorkerDiedError, end_with

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def beside(
    function: Callable[[Item], Result], item: Item, *, is_long: bool
) -> Iterator[Callable[[], Result]]:
    """Yield a function that returns the result of one job, which a process beside this one does.

    function : module-level
    is_long : whether the job takes longer than the start of a process, some seconds; else, and on a
        single core, it is done here when its result is asked for
    The job is given up if its result is not wanted after all. The yielded function raises as the
    job does, and WorkerDiedError.
    """
    if not is_long or joblib.cpu_count() == 1:
        yield partial(function, item)
        return
    pool = ProcessPoolExecutor(1, initializer=end_with, initargs=(os.getpid(),))
    done = pool.submit(_limited, function, item)

    def result() -> Result:
        try:
            found: Result = done.result()
        except TerminatedWorkerError as error:
            raise WorkerDiedError([function.__name__]) from error
        return found

    try:
        yield result
    finally:
        pool.shutdown(kill_workers=True)


def _limited(function: Callable[[Item], Result], item: Item) -> Result:
    with threadpool_limits(1):
        return function(item)
