"""Jobs on a Dask cluster whose machines have the project's dependencies and nothing else.

The code is a zip that every worker unpacks, also a worker that joins later. Shared data is the
result of a task: if its worker dies, Dask makes it again. Jobs and results are bytes, so that the
scheduler needs none of our packages. As on every Dask cluster, anybody who reaches the scheduler
can run code on the workers.
"""

import hashlib
import io
import pickle
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
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
    rest = iter(items)
    first = next(rest, None)
    if first is None:
        return
    with _connected(scheduler) as client:
        data, code = pickle.dumps(shared), _archive()
        folder = f"o2-monitor-{hashlib.sha256(code).hexdigest()[:16]}"
        name = f"{folder}-{uuid4().hex}"  # other runs may use the same code
        try:
            client.register_plugin(_shipment(name, folder, code))
            yield from _results(
                client,
                name,
                scheduler=scheduler,
                function=function,
                data=data,
                first=first,
                rest=rest,
            )
        except (CancelledError, OSError) as error:
            if client.status == "running":  # an error of a job
                raise
            raise UsageError(f"scheduler {scheduler}: the connection was lost") from error
        finally:
            if client.status == "running":
                client.unregister_worker_plugin(name)


def _results(
    client: Any,
    name: str,
    scheduler: str,
    function: Callable[[Shared, Item], Result],
    data: bytes,
    first: tuple[str, Item],
    rest: Iterator[tuple[str, Item]],
) -> Iterator[tuple[str, Result]]:
    from distributed import KilledWorker, as_completed  # noqa: PLC0415

    call, hold = _functions(name)
    held = _submit(client, hold, data)
    keys: dict[Any, str] = {}
    running = as_completed()

    def send(key: str, item: Item) -> None:
        future = _submit(client, call, held, pickle.dumps((function, item)))
        keys[future] = key
        running.add(future)

    send(*first)
    for future in running:
        while len(keys) <= AHEAD * sum(client.ncores().values()):
            job = next(rest, None)
            if job is None:
                break
            send(*job)
        key = keys.pop(future)
        try:
            result = future.result()
        except ModuleNotFoundError as error:
            raise UsageError(
                f"scheduler {scheduler}: {error.name} is not installed on its workers, which "
                "need what this command needs here"
            ) from error
        except KilledWorker as error:
            raise WorkerDiedError([key]) from error
        future.release()
        yield key, pickle.loads(result)


def _submit(client: Any, function: Callable[..., bytes], *arguments: Any) -> Any:
    with warnings.catch_warnings():  # of a large graph: the data is part of it on purpose
        warnings.simplefilter("ignore", UserWarning)
        return client.submit(function, *arguments, pure=False)


def _functions(name: str) -> tuple[Callable[[bytes, bytes], bytes], Callable[[bytes], bytes]]:
    """Return the functions that tasks call; a function defined here is pickled by value."""

    def call(shared: bytes, job: bytes) -> bytes:
        from distributed import get_worker  # noqa: PLC0415

        from training.jobs import worker  # noqa: PLC0415

        plugin: Any = get_worker().plugins[name]
        root = plugin.root
        if not worker.__file__.startswith(root):
            raise RuntimeError(f"{worker.__file__} was loaded on this worker, not from {root}")
        return worker.of_bytes(shared, job)

    def hold(data: bytes) -> bytes:
        return data

    return call, hold


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


def _shipment(name: str, folder_name: str, archive: bytes) -> Any:
    """Return a plugin that makes our code importable on a worker; its class is pickled by value.

    folder_name : folder of the unpacked code
    """
    from distributed.diagnostics.plugin import WorkerPlugin  # noqa: PLC0415

    ours = [package.__name__ for package in PACKAGES]

    class Shipment(WorkerPlugin):
        def __init__(self) -> None:
            self.name, self.archive, self.ours = name, archive, ours
            self.folder_name = folder_name

        def setup(self, worker: Any) -> None:
            import contextlib  # noqa: PLC0415
            import importlib  # noqa: PLC0415
            import importlib.util  # noqa: PLC0415
            import io  # noqa: PLC0415
            import sys  # noqa: PLC0415
            import zipfile  # noqa: PLC0415
            from pathlib import Path  # noqa: PLC0415

            def is_same(root: Path) -> bool:
                return all(
                    (root / name).is_file() and (root / name).read_bytes() == file.read(name)
                    for name in file.namelist()
                )

            file = zipfile.ZipFile(io.BytesIO(self.archive))
            spec = importlib.util.find_spec("training")
            if spec and spec.origin and is_same(Path(spec.origin).parent.parent):
                self.root = str(Path(spec.origin).parent.parent)
                return
            # beside the folders of this machine's workers, so that numba compiles once for all
            folder = Path(worker.local_directory).parent / self.folder_name
            if not folder.exists():
                begun = Path(worker.local_directory) / self.name
                file.extractall(begun)
                with contextlib.suppress(OSError):  # another worker was quicker
                    begun.rename(folder)
            self.root = str(folder)
            sys.path[:] = [self.root, *(path for path in sys.path if path != self.root)]
            for module, loaded in list(sys.modules.items()):
                own = str(getattr(loaded, "__file__", None) or folder).startswith(self.root)
                if module.split(".")[0] in self.ours and not own:
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
