"""Settings and model card as C: sizes and limits as macros, claims and limits as tables.

Each number is computed as the Python rule computes it; the tests compare the verdicts of both.
"""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from monitor.base.config import Config
from monitor.base.signals import BY_NAME, plausible_range, unit_of
from monitor.controller.network import literal, vector
from monitor.judge import bias, enable
from monitor.judge.counters import ticks_to_mature
from monitor.judge.decision.window_facts import LAMBDA_LEAST
from monitor.judge.electrical import suite
from monitor.judge.electrical.plausibility import DUTY, ENGINE, READY
from monitor.judge.enable import CONDITIONS, NO_CUT, Enable
from monitor.judge.limits import Limits
from monitor.judge.response.bank import claims
from monitor.judge.response.rule import GAIN_FOLLOWS, GAIN_KNOWN
from monitor.judge.trust import OF_MODEL
from monitor.memory.codes import CODES, TEST_OF, TESTS
from monitor.model.card import ModelCard
from monitor.model.step import PHI_MAX

TESTS_INSIDE: Final = ("response", "bias", "activity", "communication", "range", "ready")
# signals beside the model's that rules look at, where the controller has them
FURTHER: Final = tuple(dict.fromkeys((*enable.SIGNALS, ENGINE, READY, DUTY)))
FAULTS_INSIDE: Final = ("", *(fault for test in TESTS_INSIDE for fault in TESTS[test]))
CODES_INSIDE: Final = tuple(
    dict.fromkeys(code for fault in FAULTS_INSIDE[1:] for code in CODES[fault])
)
_KINDS: Final = ("SURELY", "BARELY", "FAULTY", "UNTESTED")  # of claims


@dataclass(frozen=True, slots=True)
class ExportSource:
    """All that the tables are made from.

    without : signals that the controller does not have
    """

    card: ModelCard
    limits: Limits
    config: Config
    without: Sequence[str] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the signals of a sample: the model's inputs, its output, then the others."""
        own = (*self.card.input_names, self.card.output.name)
        return (*own, *(n for n in FURTHER if n not in own and n not in self.without))

    def macro(self, name: str) -> str:
        """Return the macro of a signal's number; a column of one's own may be no name in C."""
        return f"O2_{name.upper() if name in BY_NAME else f'SIGNAL_{self.names.index(name)}'}"

    @property
    def period_s(self) -> float:
        """Return the sample period in s."""
        return self.card.period_ns * 1e-9

    def samples(self, seconds: float) -> int:
        """Return a time in samples."""
        return round(seconds / self.period_s)


def header(source: ExportSource) -> str:
    """Return ``o2_tables.h``."""
    lines = [
        '/* Sizes, names, settings and limits, generated from settings and card by "o2-monitor". */'
    ]
    lines += ["#ifndef O2_TABLES_H", "#define O2_TABLES_H", "", "#include <stdbool.h>"]
    lines += ["#include <stdint.h>", "", "/* signals of a sample */"]
    for i, name in enumerate(source.names):
        lines.append(f"#define {source.macro(name)} {i}U /* {unit_of(name) or '-'} */")
    lines.append(f"#define O2_N_SIGNALS {len(source.names)}U")
    lines.append(f"#define O2_OUTPUT {len(source.card.inputs)}U")
    lines += _numbered("enable conditions", "OK", CONDITIONS, is_bit=True)
    lines += _numbered("tests", "TEST", TESTS_INSIDE)
    lines += _numbered("faults", "FAULT", FAULTS_INSIDE[1:], first=1)
    lines += ["#define O2_SOUND 0U", f"#define O2_N_FAULTS {len(FAULTS_INSIDE)}U"]
    lines += _numbered("codes", "CODE", CODES_INSIDE)
    lines += [f"#define O2_{kind} {i}U" for i, kind in enumerate(_KINDS)]
    lines += ["", "/* sizes */"]
    lines += [f"#define O2_{name} {value}U" for name, value in _sizes(source).items()]
    lines += ["", "/* settings and limits */"]
    lines += [f"#define O2_{n} {_shown(v)} /* {unit} */" for n, v, unit in _numbers(source)]
    return "\n".join([*lines, "", '#include "o2_types.h"', "#endif", ""])


def _numbered(
    what: str, prefix: str, names: Sequence[str], *, first: int = 0, is_bit: bool = False
) -> list[str]:
    places = enumerate(names, first)
    lines = [
        f"#define O2_{prefix}_{n.upper()} {f'0x{1 << i:04X}' if is_bit else i}U" for i, n in places
    ]
    return ["", f"/* {what} */", *lines]


def _shown(value: float | bool) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value}U" if isinstance(value, int) else literal(value)


def _sizes(source: ExportSource) -> dict[str, int]:
    card, response = source.card, source.config.response
    period_s = source.period_s
    return {
        "N_INPUTS": len(card.inputs),
        "N_STATE": card.state.size,
        "N_LAGS": card.lags,
        "STATE_OUTPUT": card.state.output_start,
        "N_WINDOW": source.config.window.n_samples,
        "N_CUT_WINDOW": source.config.window.n_samples // 2,
        "N_LAG": len(response.lags_s),
        "N_DELAY": len(response.delays_s),
        "N_COLUMNS": claims(response)[-1].column + 1,
        "N_CLAIMS": len(claims(response)),
        "N_GAINS": len(_gains(source)),
        "N_PAST": int(max(_steps(s, period_s) for s in response.delays_s)) + 1,
        "N_RANGES": len(_conditions(source).ranges),
        "N_RECOVERIES": len(_recoveries(source)),
        "SECOND": max(round(1.0 / period_s), 1),
        "N_TESTS": len(TESTS_INSIDE),
        "N_CODES": len(CODES_INSIDE),
        "N_COURSE": bias.MOST,
        "AHEAD": math.ceil(response.lead_s / period_s),
        "AHEAD_BACK": int(response.lead_s > 0.0),
    }


def _numbers(source: ExportSource) -> Iterator[tuple[str, float | bool, str]]:
    """Yield name, value and unit of each setting and limit."""
    card, limits, config = source.card, source.limits, source.config
    yield "PERIOD_NS", card.period_ns, "ns"
    yield "PHI", int(card.transform == "phi"), "1: the model works on phi = 1/lambda"
    yield "PHI_MOST", PHI_MAX, "phi"
    yield "OUTPUT_LOW", card.output_limits[0], "model unit"
    yield "OUTPUT_HIGH", card.output_limits[1], "model unit"
    yield from _of_conditions(source)
    yield from _of_response(source)
    yield from _of_movement(source)
    yield from _of_bias(limits, config)
    yield from _of_electrical(source)
    yield "LEAST_EXPLAINED", limits.trust.least_explained, "share of the reading by the model"
    for test in OF_MODEL:
        yield f"BLIND_{test.upper()}", limits.trust.is_blind(test), "excludes none of its faults"
    yield "COUNT_FAIL", config.debounce.response_fail, "steps of a counter for a failed window"
    yield "COUNT_PASS", config.debounce.response_pass, "steps for a passed one"
    fail, passed = ticks_to_mature(config.debounce, source.period_s)
    yield "TICKS_FAIL", fail, "samples"
    yield "TICKS_PASS", passed, "samples"


def _of_conditions(source: ExportSource) -> Iterator[tuple[str, float | bool, str]]:
    yield "ENABLED", enable.ENABLED, "conditions"
    yield "BURNING", enable.BURNING, "conditions with which a live sensor moves"
    yield "AROUND_CUT", enable.AROUND_FUEL_CUT, "conditions that no fuel cut breaks"
    yield "NO_CUT", NO_CUT, "share of a tick with fuel cut"
    yield "PURGE_OPEN", source.config.enable.purge_open_percent, "%"
    yield "PURGE_STEP", source.config.enable.purge_step_percent, "%"


def _of_response(source: ExportSource) -> Iterator[tuple[str, float | bool, str]]:
    limits, response = source.limits, source.config.response
    lead = response.lead_s / source.period_s
    yield "AHEAD_PART", math.ceil(lead) - lead, "of a sample"
    yield "LEAST_MEASURED", LAMBDA_LEAST, "output's unit"
    yield "NOISE_MEMORY", limits.noise_memory, "correlation of neighbouring samples"
    yield "GAIN_MODEL", limits.gain_model, "measurement over prediction"
    new = limits.innovation_var
    yield "NOISE_VAR", limits.noise**2, "phi squared, of the healthy residual"
    yield "INNOVATION_VAR", new, "phi squared, of what is new in a sample"
    yield "LEAST_VAR", response.noise_least * new, "phi squared, of an error in a window"
    yield "WEIGHT", limits.evidence, "of what the edges say"
    yield "WEIGHT_GAIN", limits.evidence_gain, "of what the amplitude says"
    yield "GAIN_KNOWN", GAIN_KNOWN, "information on the gain"
    yield "GAIN_FOLLOWS", GAIN_FOLLOWS, "least gain of the timing"
    yield "GAIN_MEMORY", response.gain_memory, "kept per window"
    yield "EVIDENCE_FAIL", response.evidence_fail, "log odds"
    yield "EVIDENCE_PASS", response.evidence_pass, "log odds"
    yield "EVIDENCE_MOST", response.evidence_most, "log odds"
    yield "EVIDENCE_WINDOW", response.evidence_window, "log odds"


def _of_movement(source: ExportSource) -> Iterator[tuple[str, float | bool, str]]:
    limits, movement, output = source.limits, source.config.movement, source.card.output
    needed, memory = source.config.response.evidence_fail, limits.noise_memory
    yield "MOVEMENT_GAIN", movement.gain_least, "gain of the weakest live sensor"
    yield "ERROR_SHARE", movement.error_share, "healthy residual variances"
    yield "QUANTUM_VAR", (0.5 * source.config.plausibility.stuck_range) ** 2, "phi squared"
    yield "STILL_SHARE", movement.still_share, "healthy residual variances"
    yield "MOVEMENT_BOUND", movement.bound, "decisions"
    yield "MOVEMENT_DOUBT", movement.doubt / needed, "decisions"
    yield "INDEPENDENT", (1.0 - memory) / (1.0 + memory), "part of the samples"
    yield "HOLD", max(source.samples(movement.hold_s), movement.hold_samples) - 1, "neighbours"
    yield "NO_HOLD", movement.no_hold, "log odds"
    yield "RANGE_END", output.maximum, "output's unit"


def _of_bias(limits: Limits, config: Config) -> Iterator[tuple[str, float | bool, str]]:
    own = config.bias
    yield "BIAS_CERTAINTY", own.certainty, "standard deviations"
    yield "BIAS_MEMORY", own.memory, "kept per window"
    yield "BIAS_WINDOWS", int(own.n_windows), "windows"
    yield "OFFSET_STD", limits.offset_std, "output's unit"
    yield "SHARED", own.variance_shared, "part of the variance"
    yield "COURSE_LEAST", bias.LEAST, "means"
    yield "COURSE_EDGE", bias.EDGE, "means"
    yield "COURSE_RISE", bias.RISE, "standard deviations"


def _of_electrical(source: ExportSource) -> Iterator[tuple[str, float | bool, str]]:
    own, output, limits = source.config.plausibility, source.card.output, source.limits
    names, samples = source.names, source.samples
    is_phi = source.card.transform == "phi"
    yield "STEP_MOST", source.config.bias.fuel_span_lambda if is_phi else math.inf, "output's unit"
    still = max(samples(own.stuck_s), 2)
    dwelt = output.percentile_0_1 - output.minimum <= own.stuck_range
    may_be_cold = dwelt and not {ENGINE, READY} & set(names)
    yield "STUCK_RANGE", own.stuck_range, "output's unit"
    yield "STUCK_BAND", own.stuck_band_at_one, "output's unit"
    yield "JUMP", max(limits.noise, own.stuck_band_at_one), "output's unit"
    yield "VISITS", own.visits, "to one value"
    yield "VISIT_LEAST", suite.LEAST, "readings of a visit"
    yield "STILL", int(still), "samples"
    yield "RESTS", math.ceil(own.fuel_cut_most_s / (still * source.period_s)), "stretches"
    yield "COLD", output.minimum if may_be_cold else -math.inf, "output's unit"
    yield "SATURATED", math.inf if "fuel_cut" in names else output.maximum, "output's unit"
    yield "RUNNING_RPM", own.engine_running_rpm, "1/min"
    yield "FIRST_MOVE", samples(own.first_move_s), "samples"
    yield "START_PATIENCE", samples(own.start_patience_s), "samples"
    patience_s = own.not_ready_s if READY in names else own.first_move_s
    yield "NOT_READY_PATIENCE", samples(patience_s), "samples"
    yield "HEATER_FULL_PERCENT", own.heater_full_percent, "%"
    yield "HEATER_FULL", samples(own.heater_full_s), "samples"
    yield "HEATER_REGULATED", samples(own.heater_regulated_s), "samples"


def _conditions(source: ExportSource) -> Enable:
    return Enable.of(source.config.enable, source.names, source.card)


def _recoveries(source: ExportSource) -> list[tuple[int, int]]:
    """Return the bit of each condition that recovers, and its samples; least first."""
    settings = enable.settings_for(source.config.enable, source.card)
    return [
        (1 << i, enable._samples(settings, each.recovery, source.period_s))
        for i, each in enumerate(enable.TABLE)
        if each.recovery
    ]


def _steps(seconds: float, period_s: float) -> float:
    return round(seconds / period_s, 9)


def tables(source: ExportSource) -> str:
    """Return ``o2_tables.c``."""
    limits, response = source.limits, source.config.response
    late = [_steps(s, source.period_s) for s in response.delays_s]
    share = [literal(1.0 - math.exp(-source.period_s / s)) for s in response.lags_s]
    untold = limits.trust.untold
    offsets = f"{literal(limits.offset_low)}, {literal(limits.offset_high)}"
    texts = {
        "signal": [json.dumps(name, ensure_ascii=False) for name in source.names],
        "fault": [f'"{name or "sound"}"' for name in FAULTS_INSIDE],
        "code": [f'"{name}"' for name in CODES_INSIDE],
    }
    own = {
        "float o2_lag_share[O2_N_LAG]": share,
        "uint16_t o2_late_steps[O2_N_DELAY]": [f"{int(n)}U" for n in late],
        "float o2_late_part[O2_N_DELAY]": [literal(n - int(n)) for n in late],
        "o2_claim o2_claims[O2_N_CLAIMS]": _claims(source),
        "o2_bounds o2_gains[O2_N_GAINS]": [
            f"{{{literal(low)}, {literal(high)}}}" for low, high in _gains(source)
        ],
        "o2_range o2_ranges[O2_N_RANGES]": [
            f"{{O2_OK_{r.condition.upper()}, {source.macro(r.signal)}, "
            f"{literal(r.low)}, {_bound(r.high)}}}"
            for r in _conditions(source).ranges
        ],
        "o2_bounds o2_plausible[O2_N_SIGNALS]": [
            f"{{{literal(low)}, {literal(high)}}}"
            for low, high in map(plausible_range, source.names)
        ],
        "o2_recovery o2_recoveries[O2_N_RECOVERIES]": [
            f"{{0x{bit:04X}U, {n}U}}" for bit, n in _recoveries(source)
        ],
        "o2_fault o2_faults[O2_N_FAULTS]": [_fault(name, name in untold) for name in FAULTS_INSIDE],
        "uint8_t o2_code_tests[O2_N_CODES]": [
            f"0x{sum(1 << i for i, t in enumerate(TESTS_INSIDE) if _can_set(t, code)):02X}U"
            for code in CODES_INSIDE
        ],
    }
    parts = [
        '/* Generated from settings and model card by "o2-monitor". */\n#include "o2_monitor.h"\n'
    ]
    parts.append("#include <math.h>\n")
    for declaration, values in own.items():
        kind, name = declaration.split(" ")
        parts.append(vector(kind, name, values, is_shared=True))
    for what, values in texts.items():
        parts.append(vector("char *const", f"o2_{what}_names[]", values, is_shared=True))
    parts.append(f"const o2_vehicle o2_any_vehicle = {{{offsets}, 1.0f, true}};\n")
    return "\n".join(parts)


def _bound(high: float) -> str:
    """Return an upper bound; the largest number below a limit stays below it as a float."""
    is_below = high < NO_CUT == np.nextafter(high, np.inf)
    return literal(float(np.nextafter(np.float32(NO_CUT), np.float32(0.0))) if is_below else high)


def _can_set(test: str, code: str) -> bool:
    return any(code in CODES[fault] for fault in TESTS[test])


def _fault(name: str, is_untold: bool) -> str:
    codes = sum(1 << CODES_INSIDE.index(code) for code in CODES[name]) if name else 0
    test = f"O2_TEST_{TEST_OF[name].upper()}" if name else "255U"
    return f"{{0x{codes:04X}UL, {test}, {_shown(is_untold)}}}"


def _gains(source: ExportSource) -> list[tuple[float, float]]:
    """Return the ranges of gains that claims have."""
    found = claims(source.config.response)
    return sorted({(each.gain_low, each.gain_high) for each in found})


def _claims(source: ExportSource) -> list[str]:
    response, untested = source.config.response, source.limits.trust.untested
    found, ranges = [], _gains(source)
    for each in claims(response):
        kind = "UNTESTED" if each.fault in untested else "FAULTY"
        if not each.fault:
            kind = "BARELY" if each.hypothesis.near_limit else "SURELY"
        name = f"O2_FAULT_{each.fault.upper()}" if each.fault else "O2_SOUND"
        at = ranges.index((each.gain_low, each.gain_high))
        found.append(f"{{{each.column}U, O2_{kind}, {name}, {at}U}}")
    return found
