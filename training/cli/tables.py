"""The command ``o2train tables``: lambda delay, wall film and injector tables from recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from monitor.base.command_line import option_paths as paths
from monitor.base.counts import plain
from training.api.parameters import LOADS, TableParameters
from training.cli.options import Folder, GridOptions, load_all

WIDENED = 1.05  # of which a line is worth telling
NAMES = (  # of the tables' files
    *("lambda_delay.*", "lambda_delay_cycles.*", "lambda_lag.*", "wall_film_*degc.*"),
    *("injector_dead_time.*", "injector_flow_scale.*", "sensor_lag.*"),
)

if TYPE_CHECKING:
    from training.pages.heat import Heat
    from training.recordings.ecu_table import EcuTable

EXAMPLES = """examples:
  o2train tables drive.csv --out tables
  o2train tables monday.csv tuesday.csv --out tables --axes CurrentTune.msq
  o2train tables drive.csv --out tables --displacement-l 1.8 --period 0.07

Needs engine_speed_rpm, lambda_measured, injector_pulse_width_ms or fuel_mass_mg, and one of
air_mass_mg, manifold_pressure_kpa, maf_kg_h. Cells that the recordings do not tell stay blank."""


@dataclass(frozen=True, kw_only=True)
class TablesCommand(TableParameters, GridOptions):
    """Options of an estimate.

    recordings : recordings of one car
    out : folder to write
    rough : also write cells whose 90 % interval is wider than an ECU needs: a delay beyond 22 ms,
        an injector dead time beyond 0.05 ms
    """

    recordings: Annotated[Sequence[Path], paths.recording] = field(kw_only=False)
    out: Folder
    rough: bool = False


def also_written(args: TablesCommand) -> list[Path]:
    """Return the files that the command writes, but for the tables of an earlier run."""
    from training.ecu_tables.files import earlier

    there = {path for name in NAMES for path in args.out.glob(name)}
    own = [args.out / "report.html", args.out / "tables.json"]
    return [*own, *sorted(there - earlier(args.out))]


def run(args: TablesCommand) -> int:
    """Estimate lambda delay and lag, wall film, injector dead time and flow, and the sensor's own
    lag from recordings of one car. Each cell has an estimate, a 90 % interval and its number of
    samples. Written are tables.json, CSV and TunerStudio files, and a page.

    Raises RecordingError or UsageError (exit code 2).
    """
    from training.cli.progress import Share
    from training.ecu_tables import balance, config, files, fit, msq, page, signals, tables
    from training.recordings.ecu_table import axes_of
    from training.recordings.recording import check_each_once
    from training.recordings.start import start_of

    recordings = load_all(args, args.recordings, args.period, one_grid=True)
    check_each_once(recordings)
    subject = signals.subject_of(recordings, LOADS[args.load], args.displacement_l, args.cylinders)
    own = () if args.axes is None else msq.read_axes(args.axes, subject.load)
    args.out.mkdir(parents=True, exist_ok=True)
    with Share("tables") as bar:
        fitted = fit.fit(subject, bar.update)
    strict, rough = config.defaults(), config.rough()
    axes = axes_of(subject.load, *own)
    made = tables.tables(fitted, axes, rough if args.rough else strict)
    beside = [] if args.rough else tables.tables(fitted, axes, rough)
    sources = [
        {"path": str(r.path), "sha256": r.sha256, "start": start and start.isoformat()}
        for r, start in ((r, start_of(r.begin_ns, r.path)) for r in recordings)
    ]
    notes = {
        "the logs' steady balance": balance.balance_text(fitted.parameters),
        "the tune's injectors": msq.injectors_text(args.axes, args.displacement_l, args.cylinders)
        if args.axes is not None
        else "",
        "samples left out": signals.rejected_text(subject.drives),
    }
    notes = {what: text for what, text in notes.items() if text}
    files.write_files(args.out, made, recordings=sources, notes=notes)
    page.write_report(args.out / "report.html", fitted, made, notes)
    for line in [*summary(made, beside), *(f"{what}: {text}" for what, text in notes.items())]:
        print(line)
    for table in made:
        if text := grid(page.heading(table), page.heat(table)):
            print(text)
    period_s = recordings[0].period_ns / 1e9
    told = f"{subject.samples} usable samples of {period_s:g} s, {subject.air.value}"
    print(f"{args.out / 'report.html'}: {told}")
    return 0


def grid(title: str, heat: "Heat") -> str:
    """Return the rows and columns with a filled cell as lines: estimate, half of its interval."""
    rows = [(name, cells) for name, cells in heat.rows if any(c.half for c in cells)]
    filled = [i for i in range(len(heat.columns)) if any(cells[i].half for _, cells in rows)]
    lines = [("", [heat.columns[i] for i in filled])]
    for name, cells in rows:
        shown = (cells[i] for i in filled)
        lines.append((name, [f"{c.value} {c.half}" if c.half else "" for c in shown]))
    text = (f"{name:>8}" + "".join(f"{cell:>11}" for cell in cells) for name, cells in lines)
    return "\n".join([f"{title}, {heat.corner}", *map(str.rstrip, text)]) if rows else ""


def summary(made: "list[EcuTable]", rough: "list[EcuTable]") -> list[str]:
    """Return filled cells and the range of the estimates; tables alike share a line.

    rough : the same tables with the cells that ``--rough`` writes, none if it was given
    """
    import numpy as np

    from training.ecu_tables.page import SHOWN

    more = {t.key: int(np.isfinite(t.estimate).sum()) for t in rough}
    lines: dict[str, list[str]] = {}
    for table in made:
        per, unit, _ = SHOWN[table.unit]
        good = per * table.estimate[np.isfinite(table.estimate)]
        told = f"{len(good)} of {table.estimate.size} cells"
        if len(good):
            told += f", {plain(good.min(), 3)} to {plain(good.max(), 3)} {unit}"
        left = more.get(table.key, 0) - len(good)
        told += f"; {left} more with wide intervals: --rough" if left > 0 else ""
        if table.widened > WIDENED:
            told += f"; the logs disagree: intervals {plain(table.widened, 2)} times as wide"
        told += "" if len(good) else f"; {table.reasons()}"
        lines.setdefault(told, []).append(table.key)
    return [f"{', '.join(keys)}: {told}" for told, keys in lines.items()]
