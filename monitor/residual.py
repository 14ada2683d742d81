"""Step 6: measured against predicted.

The residual is measured minus predicted in the output's unit. The response rule works on signals
oriented like phi = 1/lambda, for which rising is lean to rich.
"""


def oriented(value: float, transform: str) -> float:
    """Return a value oriented like phi.

    transform : "phi" for lambda, which becomes 1/lambda; "none" for an output that rises towards
        lean as lambda does, which is negated
    """
    if transform == "phi":
        return 1.0 / value if value > 0.0 else float("nan")
    return -value
