"""What is decided about one recording, one happening after the other, as ``pipeline.Monitor`` does.

Here everything comes together that remembers: decisions, fault memory, the vehicle's reference.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from monitor.base.config import BiasConfig
from monitor.base.types import SampleBlock
from monitor.judge.decisions import Change, Decisions, DtcChanged, Facts, WindowJudged
from monitor.judge.limits import Limits
from monitor.judge.plausibility import TickResult
from monitor.judge.window import Window
from monitor.memory.cycles import Moment
from monitor.memory.dtc import DtcStore, Status
from monitor.memory.obd_records import FreezeFrame
from monitor.memory.reference import Reference, Seen
from monitor.pipeline.stream import CycleStarted


class Vehicle:
    """What is known of a recording's vehicle, and the limits that follow.

    limits : of the model
    reference : learns from each driving cycle that ends; None is a vehicle of which nothing is kept
    """

    def __init__(self, limits: Limits, config: BiasConfig, reference: Reference | None) -> None:
        self._model_limits, self._config = limits, config
        self._learns = reference is not None
        self.reference = reference or Reference()
        self.limits = limits.of_vehicle(self.reference, config)

    def learn(self, seen: Seen | None) -> None:
        """Take what a driving cycle shows."""
        if self._learns and seen is not None:
            self.reference = self.reference.learn(seen, self._config)
            self.limits = self._model_limits.of_vehicle(self.reference, self._config)


class Course:
    """The decisions on one recording, driving cycle by driving cycle.

    decide : makes the decisions of a driving cycle
    store : fault memory, in which the first driving cycle has begun
    """

    def __init__(
        self,
        block: SampleBlock,
        names: Sequence[str],
        decide: Callable[[Limits], Decisions],
        store: DtcStore,
        vehicle: Vehicle,
    ) -> None:
        self._block, self._names, self._decide, self._vehicle = block, names, decide, vehicle
        self.store = store
        self.decisions: Decisions  # from the first ``begin`` on
        self._facts: Iterator[Facts] = iter(())
        self.windows: list[WindowJudged] = []
        self.changes: list[DtcChanged] = []
        self.cycles: list[CycleStarted] = []

    def clear(self, t_ns: int) -> None:
        """Let a tester clear the codes; what was found is forgotten with the next sample."""
        self.changes += [DtcChanged(t_ns, dtc) for dtc in self.store.clear()]

    def begin(self, windows: Sequence[Window]) -> None:
        """Begin the decisions anew; the windows are those that come until they end."""
        self.decisions = self._decide(self._vehicle.limits)
        self._facts = iter(self.decisions.facts(windows) if windows else ())

    def count(self, moment: Moment, k: int) -> None:
        """Let the fault memory count at sample k; begin the next driving cycle."""
        match moment:
            case "driving_cycle":
                self._next_cycle(int(self._block.t_ns[k]))
            case "ignition_cycle":
                self.store.count_ignition_cycle()
            case "warm_up":
                self.store.count_warm_up()
            case "general_denominator":
                self.store.count_general_denominator()

    def _next_cycle(self, t_ns: int) -> None:
        started = CycleStarted(t_ns, self.decisions.seen)
        were_active = {dtc.code for dtc in self.store.active}
        changed = self.store.start_driving_cycle()
        self.cycles.append(started)
        self._vehicle.learn(started.seen)
        self.changes += [DtcChanged(t_ns, dtc) for dtc in changed if dtc.code in were_active]

    def matured(self, result: TickResult, k: int) -> None:
        """Take a test's result on sample k that matures."""
        self._take(self.decisions.matured(result, int(self._block.t_ns[k])), k)

    def activity(self, failed: bool, fault: str, k: int) -> None:
        """Take a judged stretch of the activity test that ends with sample k."""
        self._take(self.decisions.activity(failed, fault, int(self._block.t_ns[k])), k)

    def window(self, window: Window, k: int) -> None:
        """Take a window that sample k completes."""
        self._take(self.decisions.window(window, next(self._facts)), k)

    def _take(self, events: Iterable[WindowJudged | Change], k: int) -> None:
        for event in events:
            if isinstance(event, WindowJudged):
                self.windows.append(event)
            elif isinstance(event, DtcChanged):
                self.changes.append(event)
                if event.dtc.status & Status.TEST_FAILED:
                    self._freeze(event, k)

    def _freeze(self, event: DtcChanged, k: int) -> None:
        """Keep with a code that fails what the signals were."""
        values = self._block.values[k]
        read = zip(self._names, values.tolist(), (~np.isnan(values)).tolist(), strict=True)
        signals = {name: value for name, value, is_good in read if is_good}
        self.store.freeze(FreezeFrame(event.dtc.code, event.t_ns, signals))
