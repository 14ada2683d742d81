"""The section about input selection: principal components, choice, free runs, transparency."""

from typing import Any

from training.pages.page import part
from training.study.selection import selection_figures

LARGE_INFLATION = 10.0  # the other variables explain 90 % of it
VERDICTS = {
    "better": "better than the chosen set, in every start and beyond the interval",
    "worse": "worse than the chosen set, in every start and beyond the interval",
    "as good": "as good as the chosen set, within 10 %",
    "not told apart": "not told apart from the chosen set by these test blocks and starts",
}


def section(result: dict[str, Any]) -> str:
    """Return the section from the result of ``selection``."""
    own = result["transparency"]
    return part(
        "study/selection.html",
        result=result,
        pca=result["pca"],
        reason=_reason,
        unit="phi" if result["transform"] == "phi" else result["output"],
        changes={c["name"]: _change(c) for c in result["comparisons"]},
        verdicts=VERDICTS,
        short_trainings=sum(s["stopped_by_budget"] for s in result["sets"]),
        own=own,
        balance=_balance(result) if own and own["controller"] else "",
        draw=selection_figures,
    )


def _reason(variable: dict[str, Any]) -> str:
    """Return why a variable is in or out, from its physics and from its numbers."""
    redundant = variable["inflation"] > LARGE_INFLATION
    share = 100 * (1.0 - 1.0 / variable["inflation"])
    numbers = (
        f"the others explain {share:.1f} % of it"
        if redundant
        else f"{100 - share:.0f} % of it is its own"
    )
    physical = f"{variable['reason']}; " if variable["reason"] else ""
    numbers += f", correlation with the output {variable['correlation']:.2f}"
    if variable["chosen"]:
        inside = variable["inflation_chosen"]
        kept = inside is not None and inside > LARGE_INFLATION
        note = ", redundant even among the chosen, kept for its physics" if kept else ""
        return f"In: {physical}{numbers}{note}."
    return f"Out: {physical}{numbers}."


def _change(found: dict[str, Any]) -> str:
    """Return the change of the error against the chosen set in percent, with its interval."""
    change, low, high = (100 * found[k] / found["rmse"] for k in ("difference", "low", "high"))
    return f"{change:+.0f} ({low:+.0f} to {high:+.0f})"


def _balance(result: dict[str, Any]) -> str:
    """Return the cost and the gain of leaving the controller out in words."""
    rmse = {s["name"]: s["rmse"] for s in result["sets"]}
    reach = result["transparency"]["reach"]
    worst = {
        name: max((abs(r["gain"]) for r in reach if r["set"] == name), default=0.0)
        for name in ("chosen", "controller exact")
    }
    cost = ""
    if "without the controller" in rmse:
        change = {n: 100 * (rmse["without the controller"] / rmse[n] - 1) for n in worst}
        cost = (
            f"Leaving lambda_controller out changes the free-run RMSE on healthy test samples by "
            f"{change['chosen']:+.0f} % against the chosen set, whose controller is blurred by "
            f"noise of 0.03 in training, and by {change['controller exact']:+.0f} % against a "
            "network that sees it exactly. "
        )
    return (
        f"{cost}It gains a prediction that no fault reaches through the controller. A network that "
        f"sees it exactly follows up to {100 * worst['controller exact']:.0f} % of a fault, the "
        f"blurred one up to {100 * worst['chosen']:.0f} %."
    )
