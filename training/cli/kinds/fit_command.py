"""Options of ``o2train fit``."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from monitor.base.command_line.parameters import Number
from training.cli.options import (
    GridOptions,
    Minutes,
    NewModel,
    Page,
    SeedOption,
    SignalOptions,
    SomeRecordings,
)


@dataclass(frozen=True, kw_only=True)
class FitCommand(SignalOptions, SeedOption, GridOptions):
    """Options of a fit.

    out : model file to write
    kind : narx: a network; greybox: the physical chain of charge and fuel, transport, mixing and
        sensor with a few constants
    lags : longest lag in samples (default: chosen from the data; 5 with --hidden)
    lag_zero : let the network also read the inputs of the predicted tick (without --lags and
        --hidden the data choose the lags)
    hidden : neurons per hidden layer (default: chosen from the data; 8 8 with --lags)
    starts : number of trainings from random weights (default: 3 of a shape that is given, of which
        the best is the model; about 4 after a search, whose mean is)
    budget : work of the training, in minutes of one core of a 2.1 GHz Xeon; the same seed, data
        and budget give the same file on every machine of a kind
    wall : minutes after which the training ends early, whatever is left of its work
    report : report to write (default: beside the model file)
    """

    recordings: SomeRecordings = field(kw_only=False)
    out: NewModel
    kind: Literal["narx", "greybox"] = "narx"
    lags: Number | None = None
    lag_zero: bool = False
    hidden: Annotated[Sequence[int] | None, "N"] = None
    starts: Number | None = None
    budget: Minutes = 10.0
    wall: Minutes | None = None
    report: Page = None
