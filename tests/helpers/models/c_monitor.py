"""The exported C monitor, compiled and run, beside the Python monitor on the same samples."""

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from monitor.base.signals import plausible_range
from monitor.base.types import FloatArray, Quality, SampleBlock
from monitor.controller.tables import CODES_INSIDE, ExportSource
from monitor.judge.limits import Limits
from monitor.pipeline.replay import Setup
from training.limits.judging import Judged, RecordingJudge

DRIVER = Path(__file__).with_name("c_driver.c")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror")
OUTCOMES = ("passed", "failed", "inconclusive")
KINDS = ("", "window", "cut")
ANY = ("-0.065", "0.065", "1", "0")  # offsets and gain of any vehicle, in a recording
TOLERANCE = 0.05  # of the evidence, a sum in single precision over all windows


class Verdict(NamedTuple):
    k: int  # last sample
    kind: str
    outcome: str
    fault: str
    evidence: float


NO_VERDICT = Verdict(0, "", "", "", 0.0)


class Said(NamedTuple):
    """What a monitor says of one drive."""

    verdicts: list[Verdict]
    codes: list[tuple[int, str, str, int]]  # sample, code, fault that set it, status byte
    enabled: int  # samples
    predicted: float  # sum over the samples
    fault_flag: bool


def compiled(
    folder: Path,
    out: Path,
    compiler: str = "gcc",
    options: Sequence[str] = (),
    program: Sequence[Path] = (DRIVER,),
) -> Path:
    """Return a program, the driver unless another is named, compiled with an exported monitor."""
    files = [*sorted(folder.glob("o2_*.c")), *program]
    call = [compiler, *STRICT, *(options or ("-O2",)), f"-I{folder}", "-o", out, *files, "-lm"]
    subprocess.run(call, check=True)
    return out


def predicted(folder: Path, scratch: Path, u: FloatArray) -> FloatArray:
    """Return what the exported network predicts from inputs (n, k), from an empty state on."""
    main, out = scratch / "main.c", scratch / "step"
    main.write_text(
        '#include "o2_tables.h"\n#include <stdio.h>\nint main(void) { float u[O2_N_INPUTS], y;\n'
        "  static float s[O2_N_STATE]; while (fread(u, sizeof(u), 1U, stdin) == 1U) {\n"
        "    o2_model_step(u, s, &y); (void)fwrite(&y, sizeof(y), 1U, stdout); } return 0; }\n"
    )
    files = [main, folder / "o2_model.c"]
    subprocess.run(["gcc", *STRICT, f"-I{folder}", "-o", out, *files, "-lm"], check=True)
    given = u.astype(np.float32).tobytes()
    done = subprocess.run([out], input=given, capture_output=True, check=True)
    return np.frombuffer(done.stdout, np.float32).astype(np.float64)


def source_of(setup: Setup) -> ExportSource:
    return ExportSource(setup.model.card, setup.limits, setup.config)


def rows(block: SampleBlock, names: Sequence[str], source: ExportSource) -> FloatArray:
    """Return samples as the C monitor takes them, the quality as the last column."""
    found = np.full((len(block.t_ns), len(source.names) + 1), np.nan, dtype=np.float32)
    for i, name in enumerate(source.names):
        if name in names:
            found[:, i] = block.values[:, names.index(name)]
    found[:, -1] = block.quality[:, names.index(source.card.output.name)]
    return found


def samples(drive: FloatArray, source: ExportSource) -> SampleBlock:
    """Return rows as the samples that a grid makes of them: only plausible values are valid."""
    values, quality = drive[:, :-1].astype(np.float64), np.zeros((len(drive), drive.shape[1] - 1))
    quality[:, len(source.card.inputs)] = drive[:, -1]
    for i, name in enumerate(source.names):
        low, high = plausible_range(name)
        outside = ~((values[:, i] >= low) & (values[:, i] <= high))
        told = np.isin(quality[:, i], (Quality.GOOD, Quality.PINNED))
        bad = np.where(np.isnan(values[:, i]), Quality.INVALID, Quality.OUT_OF_RANGE)
        quality[:, i] = np.where(outside & told, bad, quality[:, i])
        values[outside, i] = np.nan
    index = np.arange(len(drive), dtype=np.int64)
    return SampleBlock(index, index * source.card.period_ns, values, quality.astype(np.uint8))


def in_c(program: Sequence[Path | str], drives: Sequence[FloatArray]) -> list[Said]:
    """Return the C monitor's verdicts on drives, rows of ``rows``."""
    done = subprocess.run(program, input=content_of(drives), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return said_by(done.stdout.decode())


def content_of(drives: Sequence[FloatArray]) -> bytes:
    parts = [np.uint32(len(d)).tobytes() + d.astype("<f4").tobytes() for d in drives]
    return b"".join(parts) + bytes(4)


def said_by(text: str) -> list[Said]:
    found, verdicts, codes = list[Said](), list[Verdict](), []
    for kind, *words in map(str.split, text.splitlines()):
        if kind == "w":
            k, which, outcome, fault, evidence = words
            fault = "" if fault == "sound" else fault
            own = KINDS[int(which)], OUTCOMES[int(outcome)], fault, float(evidence)
            verdicts.append(Verdict(int(k), *own))
        elif kind == "c":
            k, code, fault, status = words
            codes.append((int(k), code, "" if fault == "sound" else fault, int(status)))
        else:
            enabled, predicted, flag = words
            own_codes = sorted(codes)
            found.append(Said(verdicts, own_codes, int(enabled), float(predicted), flag == "1"))
            verdicts, codes = [], []
    return found


def in_python(
    blocks: Sequence[SampleBlock], names: Sequence[str], setup: Setup, limits: Limits | None = None
) -> list[Said]:
    """Return the Python monitor's verdicts on recordings."""
    own = limits or setup.limits
    judged = RecordingJudge(names, setup.model, own, setup.config, keep_banks=False).judge(blocks)
    return [_said(block, each) for block, each in zip(blocks, judged, strict=True)]


def _said(block: SampleBlock, judged: Judged) -> Said:
    at = {t_ns: k for k, t_ns in enumerate(block.t_ns.tolist())}
    found = [(at[w.window.t_end_ns], "window", w, w.response) for w in judged.windows]
    found += [(at[c.window.t_end_ns], "cut", c, c.response) for c in judged.cuts]
    verdicts = [
        Verdict(k, kind, each.outcome, each.fault or "", own.evidence)
        for k, kind, each, own in found
    ]
    codes = {  # what a sample leaves behind
        (at[c.t_ns], c.dtc.code): (c.dtc.fault, int(c.dtc.status))
        for c in judged.changes
        if c.dtc.code in CODES_INSIDE
    }
    before: dict[str, tuple[str | None, int]] = {}
    for (k, code), told in list(codes.items()):
        if before.get(code) == told:  # only the faults beside it changed, which C does not tell
            del codes[k, code]
        before[code] = told
    flag = any(dtc.code in CODES_INSIDE for dtc in judged.dtcs)
    enabled, predicted = int(judged.enabled.sum()), float(np.nansum(judged.predicted))
    return Said(
        sorted(verdicts), sorted((*k, *v) for k, v in codes.items()), enabled, predicted, flag
    )


def differences(python: Said, c: Said) -> list[str]:
    """Return in words where two monitors say different things; [] where they agree."""
    found = [
        f"window {a}, in C {b}"
        for a, b in zip(python.verdicts, c.verdicts, strict=False)
        if a[:4] != b[:4] or not abs(a.evidence - b.evidence) <= TOLERANCE
    ]
    found += [
        f"{what} {getattr(python, what)}, in C {getattr(c, what)}"
        for what in ("codes", "enabled", "fault_flag")
        if getattr(python, what) != getattr(c, what)
    ]
    n, n_c = len(python.verdicts), len(c.verdicts)
    return found if n == n_c else [*found, f"{n} windows, in C {n_c}"]


def differs_by_rounding(python: Said, c: Said, setup: Setup) -> bool:
    """Return whether the first window that differs does so by a name or by a limit's last digits.

    The name is one that its data do not tell apart; a limit lies between the two evidences.
    """
    pairs = zip(python.verdicts, c.verdicts, strict=False)
    a, b = next(((a, b) for a, b in pairs if a[:4] != b[:4]), (NO_VERDICT, NO_VERDICT))
    low, high = sorted((a.evidence, b.evidence))
    response = setup.config.response
    limits = (-response.evidence_pass, response.evidence_fail)
    is_name = a[:3] == b[:3] and a.evidence >= 11.0
    is_limit = a[:2] == b[:2] and any(low <= limit <= high for limit in limits)
    return high - low <= TOLERANCE and (is_name or is_limit)
