"""Jobs on a Dask cluster whose machines have the project's dependencies and nothing else.

The code is a zip from which every worker imports, also a worker that joins later. Shared data is
the result of a task: if its worker dies, Dask makes it again. Jobs and results are bytes, so that
the scheduler needs none of our packages. As on every Dask cluster, anybody who reaches the
scheduler can run code on the workers.
"""

import hashlib
import io
import os
import pickle
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from socket import gethostname
from typing import Any, Final, TypeVar
from uuid import uuid4

import dbc
import monitor
import training
from monitor.base.errors import UsageError
from training.jobs.worker import WorkerDiedError

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")
CONNECT_S = 10.0  # wait for a scheduler's answer, and for its first worker
PACKAGES: Final = (monitor, training, dbc)
AHEAD: Final = 2  # jobs that are sent for each thread of the cluster


def run(
    scheduler: str,
    function: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Iterable[tuple[str, Item]],
) -> Iterator[tuple[str, Result]]:
    """Yield key and result of every item, in the order in which they are finished.

    Raises the error of a job, and UsageError if the scheduler does not answer, has no worker or
    drops the connection, or if a worker lacks a package.
    """
    with _connected(scheduler) as client:
        code = _archive()
        shipment = _shipment(f"o2-monitor-{hashlib.sha256(code).hexdigest()[:16]}", code)
        try:
            client.register_plugin(shipment)
            yield from _results(client, shipment.name, function, pickle.dumps(shared), iter(items))
        except ModuleNotFoundError as error:
            raise UsageError(
                f"scheduler {scheduler}: {error.name} is not installed on its workers, which "
                "need what this command needs here"
            ) from error
        except (CancelledError, OSError) as error:
            if client.status == "running":  # an error of a job
                raise
            raise UsageError(f"scheduler {scheduler}: the connection was lost") from error
        finally:
            if client.status == "running":
                client.unregister_worker_plugin(shipment.name)


def _results(
    client: Any,
    name: str,
    function: Callable[[Shared, Item], Result],
    data: bytes,
    rest: Iterator[tuple[str, Item]],
) -> Iterator[tuple[str, Result]]:
    from distributed import KilledWorker, as_completed  # noqa: PLC0415

    def call(shared: bytes, job: bytes) -> bytes:  # pickled by value, as all functions within one
        from distributed import get_worker  # noqa: PLC0415
        from threadpoolctl import threadpool_limits  # noqa: PLC0415

        import training  # noqa: PLC0415

        plugin: Any = get_worker().plugins[name]
        if not str(training.__file__).startswith(plugin.root):
            raise RuntimeError(f"{training.__file__} was loaded on this worker, not {plugin.root}")
        function, item = pickle.loads(job)
        if plugin.shared is None:  # a model is loaded once and not for every job
            plugin.shared = (pickle.loads(shared),)
        with threadpool_limits(1):
            return pickle.dumps(function(*plugin.shared, item))

    held = _submit(client, bytes, data)
    keys: dict[Any, str] = {}
    running = as_completed()

    def send_ahead() -> None:
        while len(keys) <= AHEAD * sum(client.ncores().values()):
            job = next(rest, None)
            if job is None:
                return
            future = _submit(client, call, held, pickle.dumps((function, job[1])))
            keys[future] = job[0]
            running.add(future)

    send_ahead()
    for future in running:
        key = keys.pop(future)
        send_ahead()
        try:
            result = future.result()
        except KilledWorker as error:
            raise WorkerDiedError([key]) from error
        future.release()
        yield key, pickle.loads(result)


def _submit(client: Any, function: Callable[..., bytes], *arguments: Any) -> Any:
    with warnings.catch_warnings():  # of a large graph: the data is part of it on purpose
        warnings.simplefilter("ignore", UserWarning)
        return client.submit(function, *arguments, pure=False)


def _archive() -> bytes:
    """Return our packages as a zip; the same code gives the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for package in PACKAGES:
            folder = Path(str(package.__file__)).parent
            for path in sorted(folder.rglob("*")):
                if path.is_file() and "__pycache__" not in path.parts:
                    inside = zipfile.ZipInfo(path.relative_to(folder.parent).as_posix())
                    file.writestr(inside, path.read_bytes(), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _shipment(name: str, archive: bytes) -> Any:
    """Return a plugin that makes our code importable on a worker; its class is pickled by value.

    name : of the code; the plugin's name has a part of its own, other runs may use the same code
    """
    from distributed.diagnostics.plugin import WorkerPlugin  # noqa: PLC0415

    ours = [package.__name__ for package in PACKAGES]
    process, home = (gethostname(), os.getpid()), str(Path(str(training.__file__)).parents[1])

    class Shipment(WorkerPlugin):
        def __init__(self) -> None:
            self.name, self.archive = f"{name}-{uuid4().hex}", archive
            self.shared: tuple[Any] | None = None  # of the jobs
            self.root = home

        def setup(self, worker: Any) -> None:
            import importlib  # noqa: PLC0415
            import os  # noqa: PLC0415
            import sys  # noqa: PLC0415
            from pathlib import Path  # noqa: PLC0415
            from socket import gethostname  # noqa: PLC0415

            if process == (gethostname(), os.getpid()):
                return  # a worker thread of the command itself, whose code is ours
            # beside the folders of this machine's workers, so that numba compiles once for all
            own = Path(worker.local_directory)
            path = own.with_name(f"{name}.zip")
            if not path.exists():
                begun = own.with_name(f"{self.name}-{own.name}.begun")  # others begin one, too
                begun.write_bytes(self.archive)
                begun.replace(path)
            self.root = str(path)
            sys.path[:] = [self.root, *(each for each in sys.path if each != self.root)]
            for module, loaded in list(sys.modules.items()):
                is_own = str(getattr(loaded, "__file__", None) or path).startswith(self.root)
                if module.split(".")[0] in ours and not is_own:
                    del sys.modules[module]  # an installed or an earlier version
            importlib.invalidate_caches()

    return Shipment()


@contextmanager
def _connected(scheduler: str) -> Iterator[Any]:
    try:
        from distributed import Client  # noqa: PLC0415 - an extra that few need
    except ImportError as error:
        raise UsageError(
            f"scheduler {scheduler}: needs dask; pip install '.[fleet]' in the project's folder"
        ) from error
    try:
        client = Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise UsageError(f"scheduler {scheduler}: no answer; wanted tcp://host:port") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError as error:
            raise UsageError(f"scheduler {scheduler}: it has no worker") from error
        yield client
