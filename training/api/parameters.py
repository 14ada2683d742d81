"""Parameters that the functions of the API and the commands of ``o2train`` share."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

from monitor.base.command_line import option_paths as paths
from monitor.base.command_line.parameters import Number

LoadAxis = Literal["kpa", "mg"]
LOADS: Final = {"kpa": "manifold_pressure_kpa", "mg": "air_mass_mg", None: None}


@dataclass(frozen=True, kw_only=True)
class TableParameters:
    """The car whose tables ``estimate_tables`` estimates.

    axes : TunerStudio tune whose axes of speed and load are used (default: fixed axes)
    load : load axis: manifold pressure in kPa or air in mg per stroke (default: kPa if the
        recordings have it)
    displacement_l : displacement in litres of all cylinders; without it speed density does not tell
        the injectors' flow, the sensor's lag and the air per stroke
    cylinders : number of cylinders, which turn displacement and air meter into the charge of one
    """

    axes: Annotated[Path | None, paths.read, "FILE.msq"] = None
    load: LoadAxis | None = None
    displacement_l: Annotated[float | None, "L"] = None
    cylinders: Number = 4
