"""A model that is sent to a worker as bytes."""

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

from monitor.base.files.outputs import write_bytes
from monitor.model.step import Model


@lru_cache(maxsize=2)
def model_of(name: str, data: bytes) -> Model:
    """Return the model of an ONNX file's content, loaded once; ``name`` is the file's name.

    Raises ModelError as ``Model.load``, UsageError if the temporary folder is full.
    """
    with TemporaryDirectory(prefix="o2-model-") as folder:
        path = Path(folder) / Path(name).name
        write_bytes(path, data)
        return Model.load(path)
