"""How much driving a calibration takes: models of growing parts of it find faults on other drives.

*Model Based Diagnosis of Oxygen Sensors* claims that a network needs little effort to calibrate.
Each model is fitted with all defaults, so nobody sets a number by hand; faults at their limits are
put on drives that no part of the study trained on.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from monitor.base import config
from monitor.base.errors import RecordingError, UsageError
from monitor.model.step import Model
from training.limits.decision_limits import with_limits
from training.limits.trust import trust_of
from training.narx.fit import FitOptions, FitSource, fit
from training.recordings.recording import Recording
from training.study.task import Parts, Task, source

LEAST_S: Final = 300.0  # of the first part; each further one is twice as long
WANTED: Final = 0.99  # of the faults
BUDGET_SHARE: Final = 0.2  # of the study's budget, for each part


def effort(task: Task, _: Parts) -> dict[str, Any]:
    """Return the parts of the driving with what their models find, and the first that suffices.

    Raises RecordingError without held-out drives; the study then leaves this part out.
    """
    if not task.test:
        raise RecordingError("no held-out drives of the healthy vehicle (--test)")
    rows = [_found(task, part) for part in _parts(task.recordings)]
    enough = None  # from which on all longer parts suffice, too
    for row in reversed(rows):
        if not row["put_on"] or row["false"] or row["found"] < WANTED * row["put_on"]:
            break
        enough = row
    return {"parts": rows, "enough": enough, "source": source((*task.recordings, *task.test))}


def _parts(recordings: tuple[Recording, ...]) -> Iterator[list[Recording]]:
    """Yield the first recordings of ``LEAST_S``, of twice as much and so on, at last all of them.

    The last recording of a part is cut.
    """
    begins = np.cumsum([0, *(len(r.t_s) for r in recordings)]).tolist()
    n = round(LEAST_S * 1e9 / recordings[0].period_ns)
    while n < begins[-1]:
        yield [r.part(0, n - at) for r, at in zip(recordings, begins, strict=False) if at < n]
        n *= 2
    yield list(recordings)


def _found(task: Task, part: list[Recording]) -> dict[str, Any]:
    """Return length of a part, and what its model finds on the held-out drives."""
    row: dict[str, Any] = {"drives": len(part), "found": 0, "put_on": 0, "false": 0, "why": ""}
    row["minutes"] = round(sum(len(r.t_s) for r in part) * task.period_s / 60.0, 1)
    budget = BUDGET_SHARE * task.settings.budget_minutes
    options = FitOptions(budget_minutes=budget, seed=task.settings.seed)
    path = task.folder / "effort.onnx"
    try:
        result = fit(FitSource(part, task.inputs, task.output), path, options)
        card = with_limits(result.card, *result.healthy(), config.load())
    except (RecordingError, UsageError) as error:
        return row | {"why": str(error)}
    trust = trust_of([(Model.load(path), task.test)], card, config.load(), path.name)
    if not trust:
        return row | {"why": "no held-out drive has a window"}
    found, false = trust["found"], sum(trust["false"].values())
    put_on = len(found) * trust["drives"]  # those that the monitor could judge
    return row | {"found": sum(found.values()), "put_on": put_on, "false": false}
