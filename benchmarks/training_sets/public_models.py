"""The models of the public scoreboard: each trains on a plant and returns free runs of its tests.

All models see only the training records; the last seventh of each chooses where something has to
be chosen. A free run begins with the plant's ``washout`` measured samples and gets only inputs from
then on. Only the networks depend on the seed.
"""

import contextlib
import io
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed.training_packages import package
from benchmarks.training_sets.public_data import Plant, PlantRecord
from monitor.model.step import Model
from training.narx.fit import FitOptions, FitSource, fit
from training.narx.linear.arx import arx_delays, best_in_free_run, largest_order, triangle
from training.narx.network import describe
from training.recordings.prediction import predict
from training.recordings.recording import of_columns

FROLS_LAGS, FROLS_DEGREES, FROLS_INFO_VALUES = (2, 3, 5), (1, 2, 3), 30
FROLS_VALUES = 5e6  # numbers in the largest matrix of regressors; a fit then takes minutes
STATES, NEURONS, EPOCHS = 4, 8, 1000  # of jax-sysid; epochs of Adam, then of L-BFGS, as its guide


@dataclass(frozen=True, slots=True)
class Work:
    """What a model may use."""

    budget_minutes: float
    seed: int
    epochs: int = EPOCHS


FreeRuns = tuple[dict[str, np.ndarray], str]  # outputs (n,) of every test, and the shape in words


def narx(plant: Plant, work: Work) -> FreeRuns:
    """Return the free runs of ``fit`` with its defaults."""
    names = [f"u{k}" for k in range(plant.train[0].u.shape[1])]

    def recording(name: str, record: PlantRecord) -> Any:
        columns = dict(zip(names, record.u.T, strict=True)) | {"y": record.y}
        t_s = np.arange(len(record.y)) * plant.period_s
        return of_columns({"time_s": t_s} | columns, name)

    own = [recording(f"train{i}", record) for i, record in enumerate(plant.train)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        options = FitOptions(budget_minutes=work.budget_minutes, seed=work.seed)
        fitted = fit(FitSource(own, names, "y"), path, options)
        shape = describe(fitted.chosen.model.spec)
        model = Model.load(path)
        return {
            name: predict(model, recording(name, record), plant.washout)[1]
            for name, record in plant.tests.items()
        }, shape


def halves(plant: Plant) -> tuple[list[PlantRecord], list[PlantRecord]]:
    """Return six sevenths of every training record, and the last seventh of each."""
    cuts = [(record, 6 * len(record.y) // 7) for record in plant.train]
    return [r[:cut] for r, cut in cuts], [r[cut:] for r, cut in cuts]


def begun(record: PlantRecord, washout: int, lags: int) -> tuple[PlantRecord, int]:
    """Return the record with its first sample repeated if ``lags`` exceed the washout."""
    extra = max(0, lags - washout)
    u = np.concatenate([np.repeat(record.u[:1], extra, axis=0), record.u])
    return PlantRecord(u, np.concatenate([np.repeat(record.y[:1], extra), record.y])), extra


def arx(plant: Plant, work: Work) -> FreeRuns:
    """Return the free runs of the best ARX in free run of all orders up to 20."""
    fitted, held_out = ([(r.u, r.y) for r in part] for part in halves(plant))
    order = largest_order(fitted)
    data = triangle(fitted, order, 2 * order)
    model = best_in_free_run(data, held_out, order, arx_delays(data, order))
    runs = {}
    for name, test in plant.tests.items():
        record, extra = begun(test, plant.washout, model.lags)
        start = record.y[: extra + plant.washout]
        runs[name] = model.simulate(record.u, start)[extra:]
    return runs, f"na {len(model.a)}, nb {model.b.shape[1]}"


def frols(plant: Plant, work: Work) -> FreeRuns:
    """Return the free runs of SysIdentPy's FROLS; lags and degree are the best in free run.

    It takes one record only, the longest of the plant.
    """
    selection = package("sysidentpy.model_structure_selection").FROLS
    polynomial = package("sysidentpy.basis_function").Polynomial
    least_squares = package("sysidentpy.parameter_estimation").LeastSquares
    record = max(plant.train, key=lambda r: len(r.y))
    cut = 6 * len(record.y) // 7

    def trained(part: PlantRecord, lags: int, degree: int) -> Any:
        n_inputs = part.u.shape[1]
        each = list(range(1, lags + 1))
        model = selection(
            ylag=lags,
            xlag=lags if n_inputs == 1 else [each] * n_inputs,
            n_info_values=FROLS_INFO_VALUES,
            basis_function=polynomial(degree=degree),
            estimator=least_squares(),
        )
        model.fit(X=part.u, y=part.y[:, None])
        return model

    def run(model: Any, part: PlantRecord) -> np.ndarray:
        first = plant.washout - model.max_lag
        free = model.predict(X=part.u[first:], y=part.y[first : plant.washout, None])
        return np.concatenate([part.y[:first], free.ravel()])

    best: tuple[float, int, int] = (np.inf, FROLS_LAGS[0], 1)
    with _quiet():
        for lags, degree in product(FROLS_LAGS, FROLS_DEGREES):
            if not 0 < _terms(lags, record.u.shape[1], degree) * len(record.y) < FROLS_VALUES:
                continue
            error = rmse(
                record[cut:], run(trained(record[:cut], lags, degree), record[cut:]), plant
            )
            best = min(best, (error, lags, degree))
        model = trained(record, *best[1:])
        runs = {name: run(model, test) for name, test in plant.tests.items()}
    return runs, f"lags {best[1]}, degree {best[2]}, {len(model.theta)} terms"


def _terms(lags: int, n_inputs: int, degree: int) -> int:
    variables, terms = lags * (1 + n_inputs), 1
    for power in range(1, degree + 1):
        terms = terms * (variables + power) // power
    return terms


def jax_sysid(plant: Plant, work: Work) -> FreeRuns:
    """Return the free runs of jax-sysid's residual recurrent network, trained as its guide does.

    The first ``washout`` samples of a test give its initial state.
    """
    jax, jnp = package("jax"), package("jax.numpy")
    model_of = package("jax_sysid.models").Model
    jax.config.update("jax_enable_x64", True)
    every = PlantRecord(
        np.concatenate([r.u for r in plant.train]), np.concatenate([r.y for r in plant.train])
    )
    u_mean, u_std, y_mean, y_std = every.u.mean(0), every.u.std(0), every.y.mean(), every.y.std()

    def state(x: Any, u: Any, params: Sequence[Any]) -> Any:
        w = params
        return w[0] @ x + w[1] @ u + w[5] @ jax.nn.sigmoid(w[3] @ x + w[4] @ u + w[6]) + w[7]

    def output(x: Any, u: Any, params: Sequence[Any]) -> Any:
        w = params
        return w[2] @ x + w[9] @ jax.nn.sigmoid(w[8] @ x + w[10]) + w[11]

    def scaled(record: PlantRecord) -> tuple[np.ndarray, np.ndarray]:
        return (record.u - u_mean) / u_std, ((record.y - y_mean) / y_std)[:, None]

    draw, k = np.random.default_rng(work.seed).standard_normal, every.u.shape[1]
    h, n = NEURONS, STATES
    weights = [
        *(0.5 * np.eye(n), 0.1 * draw((n, k)), 0.1 * draw((1, n))),
        *(0.1 * draw((h, n)), 0.5 * draw((h, k)), 0.5 * draw((n, h)), np.zeros(h), np.zeros(n)),
        *(0.5 * draw((h, n)), 0.5 * draw((1, h)), np.zeros(h), np.zeros(1)),
    ]
    model = model_of(n, 1, k, state_fcn=jax.jit(state), output_fcn=jax.jit(output))
    model.init(params=[jnp.array(w) for w in weights], x0=[np.zeros(n) for _ in plant.train])
    model.loss(rho_x0=1e-4, rho_th=1e-4)
    model.optimization(adam_epochs=work.epochs, lbfgs_epochs=work.epochs, iprint=-1)
    pairs = [scaled(record) for record in plant.train]
    runs = {}
    with _quiet():
        model.fit([y for _, y in pairs], [u for u, _ in pairs])
        for name, test in plant.tests.items():
            u, y = scaled(test)
            first = slice(plant.washout)
            x0 = model.learn_x0(u[first], y[first], verbosity=False, LBFGS_refinement=True)
            free, _ = model.predict(x0, u)
            runs[name] = np.asarray(free).ravel() * y_std + y_mean
    return runs, f"{n} states, {h} neurons"


@contextlib.contextmanager
def _quiet() -> Any:
    with (
        warnings.catch_warnings(),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(io.StringIO()),
        np.errstate(all="ignore"),
    ):
        warnings.simplefilter("ignore")
        yield


def rmse(test: PlantRecord, free: np.ndarray, plant: Plant) -> float:
    """Return the root mean square error in the table's unit behind the washout, or infinity."""
    error = test.y[plant.washout :] - free[plant.washout : len(test.y)]
    finite = len(error) == len(test.y) - plant.washout and bool(np.isfinite(error).all())
    with np.errstate(over="ignore"):
        return plant.per_unit * float(np.sqrt(np.mean(error**2))) if finite else np.inf


MODELS: dict[str, tuple[Callable[[Plant, Work], FreeRuns], bool]] = {  # and whether seeds matter
    "NARX": (narx, True),
    "ARX": (arx, False),
    "FROLS": (frols, False),
    "jax-sysid": (jax_sysid, True),
}
