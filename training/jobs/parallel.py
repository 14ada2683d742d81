"""Jobs side by side on this machine's cores or on a Dask cluster.

A job is a module-level function of shared data and its own item. Jobs return, the caller writes: a
cluster needs no common file system. ``training.jobs.cluster`` says what a cluster needs.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError
from threadpoolctl import threadpool_limits

from training.jobs import cluster
from training.jobs.worker import WorkerDiedError, end_with

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")


def run(
    function: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Iterable[tuple[str, Item]],
    *,
    jobs: int = 2,
    scheduler: str | None = None,
) -> Iterator[tuple[str, Result]]:
    """Yield key and result of every item, in the order in which they are finished.

    function : module-level, takes ``shared`` and an item
    items : with a key each; long jobs should come first
    scheduler : address of a Dask scheduler, ``tcp://host:port``; None uses ``jobs`` processes here
    Raises as the jobs do, UsageError if the scheduler cannot be used, and WorkerDiedError; a
    cluster does the jobs of a dead worker again and raises it only for one that has met several.
    """
    if scheduler is not None:
        yield from cluster.run(scheduler, function, shared, items)
        return
    watch = {"initializer": end_with, "initargs": (os.getpid(),)} if jobs != 1 else {}
    parallel = joblib.Parallel(
        jobs,
        backend="loky",
        return_as="generator_unordered",
        batch_size=1,
        max_nbytes=None,
        pre_dispatch="2*n_jobs",
        inner_max_num_threads=1,
        **watch,
    )
    sent: dict[str, None] = {}

    def calls() -> Iterator[Any]:
        for key, item in items:
            sent[key] = None
            yield joblib.delayed(_call)(function, shared, key, item)

    try:
        for key, result in parallel(calls()):
            del sent[key]
            yield key, result
    except TerminatedWorkerError as error:
        raise WorkerDiedError(sent) from error


def _call(
    function: Callable[[Shared, Item], Result], shared: Shared, key: str, item: Item
) -> tuple[str, Result]:
    with threadpool_limits(1):  # one thread is the fastest on small matrices
        return key, function(shared, item)
