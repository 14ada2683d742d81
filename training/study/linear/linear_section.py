"""The section about linear baselines, from the stored result."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from training.pages.numbers import p_value, short
from training.pages.page import part
from training.study.linear import linear_figures
from training.study.linear.linear_figures import TITLES, Result


def section(result: Result) -> str:
    """Return the section as HTML."""
    regime = result["regime"]
    return part(
        "study/linear.html",
        result=result,
        models=result["models"],
        ranges=[_range(a, b, regime["unit"]) for a, b in regime["ranges"]] if regime else [],
        titles=TITLES,
        at_edge=_at_edge(result),
        starts=sorted(result["output_error"]["starts"], key=_validation)[:8],
        delays=_delays,
        verdicts=_verdicts,
        draw=linear_figures,
    )


def _range(low: float | None, high: float | None, unit: str) -> str:
    unit = f" {unit}" if unit else ""
    if low is None:
        return "all" if high is None else f"below {short(high)}{unit}"
    return f"from {short(low)}{unit}" if high is None else f"{short(low)} to {short(high)}{unit}"


def _at_edge(result: Result) -> list[str]:
    """Return the ARX models whose orders are the largest that were tried."""
    most = result["largest_order"]
    return [
        TITLES[name]
        for name, c in result["arx"]["choices"].items()
        if c["na"] >= most or c["nb"] >= (2 * most if name == "arx_free_run" else most)
    ]


def _validation(start: dict[str, Any]) -> float:
    rmse = start["validation_rmse"]
    return float("inf") if rmse is None else float(rmse)


def _delays(delays: Sequence[int]) -> str:
    return str(delays[0]) if len(set(delays)) == 1 else " ".join(map(str, delays))


def _verdicts(tests: dict[str, Any]) -> list[str]:
    """Return the cells of one model: whiteness, p, lags, independence, correlation, feedback."""
    white, each = tests["whiteness"], tests["independence"]
    sizes = [max(abs(c) for c in t["correlation"][len(t["lags"]) // 2 :]) for t in each]
    worst = int(np.argmax(sizes))
    return [
        "rejected" if white["rejected"] else "not rejected",
        p_value(white["p_value"]),
        f"{white['outside']} of {white['lags']}",
        _named("rejected", [t["input"] for t in each if t["rejected"]], len(each)),
        f"{sizes[worst]:.2f}, {each[worst]['input']}",
        _named("", [t["input"] for t in each if t["feedback"]], len(each)),
    ]


def _named(word: str, names: Sequence[str], total: int) -> str:
    if not names:
        return f"not {word}" if word else "none"
    named = ", ".join(names) if len(names) < 3 else f"{len(names)} of {total}"
    return f"{word} for {named}" if word else named
