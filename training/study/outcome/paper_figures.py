"""Figures reported by *Model Based Diagnosis of Oxygen Sensors*, beside those of the study."""

from collections.abc import Mapping
from typing import Any, Final

LAYERS: Final = (8, 8)
LAGS: Final = 5
RATE: Final = 0.2
MSE: Final = 0.002
R: Final = {"training": 0.961, "validation": 0.952, "test": 0.905}
MODELS: Final = 29
NOISE_HZ: Final = (2.4, 2.5)
WINDOW: Final = 50

Row = tuple[str, str, str]


def beside_ours(parts: Mapping[str, Any]) -> list[Row]:
    """Return rows of quantity, the paper's value and the study's value."""
    choice = parts["choice"]
    chosen = choice["candidates"][choice["chosen"]]
    sensor = parts["sensor"]
    rows: list[Row] = [
        ("inputs", "7, chosen from 11 with PCA", _inputs(parts)),
        ("disturbance", f"{NOISE_HZ[0]}–{NOISE_HZ[1]} Hz", _band(parts)),
        ("models compared", str(MODELS), _compared(parts)),
        (
            "chosen",
            f"{LAGS} lags, layers {LAYERS[0]}-{LAYERS[1]}, Levenberg–Marquardt, rate {RATE}",
            f"{chosen['name']}: {chosen['structure']}",
        ),
        (
            "how its figures are taken",
            "not said: one step ahead or free run",
            "free run, on enabled samples, in the output's unit",
        ),
        ("MSE", f"{MSE}, unit not said", _mse(sensor)),
    ]
    for view in sensor["views"][:3]:
        name = view["title"].split()[0]
        rows.append((f"R, {name}", f"{R[name]:.3f}", _r(view)))
    rows += [(f"R, {v['title']}", "–", _r(v)) for v in sensor["views"][3:]]
    rows.append(("window", f"{WINDOW} residuals", f"{WINDOW} residuals"))
    limits = parts["shipped"]["limits"]
    if "j_mu_z" in limits:
        unit = f" {sensor['unit']}" if sensor["unit"] not in ("", "-") else ""
        for key, paper in (("j_mu", "0.05 and −0.5"), ("j_sigma", "0.25 and 0.85")):
            own, z = limits[key]["value"], limits[f"{key}_z"]["value"]
            rows.append(
                (
                    f"limit {'Jμ' if key == 'j_mu' else 'Jσ'}",
                    f"{paper}, z-scored by all appearance",
                    f"{own:.3g}{unit}, z-scored {z:.3g}",
                )
            )
    return rows


def same_structure(parts: Mapping[str, Any]) -> Row | None:
    """Return a row on the paper's structure trained here: R one step ahead and in free run."""
    models = parts["narx"].get("models", [])
    own = next((m for m in models if m["origin"] == "paper"), None)
    if own is None:
        return None
    start = own["starts"][own["best_start"]]
    text = []
    for mode, words in (("one_step", "one step ahead"), ("free_run", "free run")):
        values = [start[mode][role]["enabled"]["r"] for role in ("train", "validate", "test")]
        shown = "/".join("–" if r is None else f"{r:.3f}" for r in values)
        text.append(f"{shown} {words}")
    return (
        "the paper's structure, trained here one-step only: R training/validation/test",
        "/".join(f"{r:.3f}" for r in R.values()),
        "; ".join(text),
    )


def _inputs(parts: Mapping[str, Any]) -> str:
    sets = parts["selection"]
    if "candidates" not in sets:
        return "as given"
    return f"{len(sets['chosen'])} of {len(sets['candidates'])} candidates"


def _band(parts: Mapping[str, Any]) -> str:
    band = parts["preparation"]["band_hz"]
    if band:
        return f"{band[0]:.2f}–{band[1]:.2f} Hz, filtered for the linear baselines"
    lines = parts["preparation"]["lines"]
    words = [f"{x['low_hz']:.2f}–{x['high_hz']:.2f} Hz in {x['signal']}" for x in lines]
    return f"{', '.join(words)}; not filtered" if words else "none found"


def _compared(parts: Mapping[str, Any]) -> str:
    trained = len(parts["narx"].get("models", []))
    tries = len(parts["free"].get("tries", []))
    return f"{trained}, and {tries} structures of free memory and size"


def _mse(sensor: Mapping[str, Any]) -> str:
    values = []
    for view in sensor["views"]:
        rmse = view["enabled"].get("rmse")
        if rmse is not None:
            values.append(f"{rmse**2:.2g} {view['title']}")
    return ", ".join(values)


def _r(view: Mapping[str, Any]) -> str:
    r = view["enabled"].get("correlation")
    return f"{'–' if r is None else f'{r:.3f}'} ({view['source']})"
