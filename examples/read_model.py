"""Read a model file with onnxruntime alone, and predict a drive: docs/reference/model_file.md."""

import json
import sys

import numpy as np
import onnxruntime as ort


def predict(path: str, columns: dict[str, np.ndarray]) -> np.ndarray:
    """Return the free run of a model file over columns (n,) by name, in its output's unit."""
    session = ort.InferenceSession(path)
    card = json.loads(session.get_modelmeta().custom_metadata_map["o2_monitor_card"])
    names = [channel["name"] for channel in card["inputs"]]
    u = np.column_stack([columns[name] for name in names]).astype(np.float32)
    state, predicted = np.zeros((1, card["state"]["size"]), np.float32), []
    for row in [
        *[u[0]] * card["lags"],
        *u,
    ]:  # fill the memory as if the first inputs had been constant
        y, state = session.run(None, {"u": row[None], "state": state})
        predicted.append(float(y[0, 0]))
    return np.array(predicted[card["lags"] :])


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: read_model.py MODEL.onnx TABLE.csv, with the model's inputs as columns")
    table = np.genfromtxt(sys.argv[2], delimiter=",", names=True)
    names = table.dtype.names or ()
    print(*predict(sys.argv[1], {name: table[name] for name in names}), sep="\n")
