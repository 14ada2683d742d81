"""The result of the gap workflow for one vehicle, and its form in ``gap.json``.

The JSON's names are a contract: DESIGN, section 4.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from monitor.base.files.manifest import sha256_of
from monitor.base.files.outputs import write_text
from monitor.model.card import TrainingRecording
from training.gap.add.addition import Addition
from training.gap.config import CONFIG
from training.gap.name.verdict import Base, Candidate, Naming, Verdict
from training.gap.response.difference import Difference
from training.gap.verify.evidence import Verification
from training.greybox.effects.empirical import formula
from training.jobs.json_tree import json_tree
from training.recordings.recording import Recording, training_recording

SCHEMA: Final = "o2train.gap/1"
HELD_OUT_DRIVES: Final = "recordings that no fit saw"
UNSEEN_DRIVES: Final = "recordings that the constants have not seen"
WHOLE: Final = "the recordings"
HELD_OUT_BLOCKS: Final = "blocks held out of the recordings"
PHI: Final = "phi = 1 / lambda, outside fuel cut"


@dataclass(frozen=True, slots=True)
class Inputs:
    """The model under study and the recordings that were read."""

    model: Path
    sha256: str  # of the model's file
    kind: str  # "narx", "greybox"
    recordings: tuple[TrainingRecording, ...]  # in which the effect was looked for
    healthy: tuple[TrainingRecording, ...]
    verify: tuple[TrainingRecording, ...]  # seen by no fit
    sensor_known_good: bool = False
    unit: str = "phi"  # of errors

    @classmethod
    def of(
        cls,
        model: Path,
        kind: str,
        roles: Iterable[Sequence[Recording]],
        sensor_known_good: bool,
        unit: str = "phi",
    ) -> "Inputs":
        """Return the inputs with hashes; roles : recordings, healthy ones, those that verify."""
        new, healthy, verify = (tuple(map(training_recording, each)) for each in roles)
        return cls(model, sha256_of(model), kind, new, healthy, verify, sensor_known_good, unit)

    @property
    def simulated(self) -> tuple[bool, ...]:
        """Return for every recording whether it says that it is simulated."""
        used = (*self.recordings, *self.healthy, *self.verify)
        return tuple("simulated" in r.source for r in used)


@dataclass(frozen=True, slots=True)
class Result:
    """Naming, new model and verification of one run."""

    inputs: Inputs
    naming: Naming
    difference: Difference | None = None  # from healthy runs, where no effect can be tried
    addition: Addition = field(default_factory=Addition)
    verified: Verification | None = None
    unknown: str | None = None  # description of an effect that is not in the library, sentences
    warnings: tuple[str, ...] = ()  # beside those of the naming
    seconds: float | None = None

    @property
    def verdict(self) -> Verdict:
        """Return the naming's verdict."""
        return self.naming.verdict

    @property
    def effects(self) -> tuple[Candidate, ...]:
        """Return the named effects, the ambiguous set or the terms of a formula, at most three."""
        with_effects = self.verdict in ("named", "ambiguous", "unknown_effect")
        found = self.naming.answer.effects if with_effects else ()
        return found[: CONFIG.inputs.effects_max]

    @property
    def tried(self) -> bool:
        """Return whether any effect could be tried; without fuel and air none can."""
        return self.naming.base is not None

    @property
    def rmse(self) -> tuple[float, float | None, float, str]:
        """Return RMSE before and after, the floor, all in phi, and the samples they are of."""
        error, verified = self.naming.error, self.verified
        added = bool(self.addition.effects)
        if verified is not None and verified.overall.floor is not None:
            whole = verified.overall
            after = whole.after if added else None
            unseen = UNSEEN_DRIVES if added else WHOLE
            measured_on = HELD_OUT_DRIVES if self.inputs.verify else unseen
            return whole.before, after, verified.overall.floor, measured_on
        after = error.after if added else None
        measured_on = HELD_OUT_BLOCKS if self.tried else WHOLE
        return error.before, after, error.floor, measured_on

    @property
    def all_warnings(self) -> tuple[str, ...]:
        """Return the warnings of naming, adding and verifying without repetition."""
        worse = [
            f"worse beyond confidence with the new model: {e.regime}, "
            f"RMSE {e.before:.4f} before and {e.after:.4f} after, in phi"
            for e in (self.verified.worse if self.verified else ())
        ]
        return tuple(dict.fromkeys((*self.naming.warnings, *self.warnings, *worse)))


def runner_up(result: Result, effect: Candidate) -> Candidate | None:
    """Return the best other candidate of the ranking out of which an effect was chosen."""
    trials = result.naming.trials
    rankings = [r.ranking for r in trials.rounds if r.effect.name == effect.name]
    others = [c for c in (*rankings, trials.ranking)[0] if c.name != effect.name]
    return max(others, key=lambda c: c.merit.score, default=None)


def as_json(result: Result) -> dict[str, Any]:
    """Return ``gap.json``; every number is finite or null."""
    inputs, addition, verified = result.inputs, result.addition, result.verified
    answer, trials = result.naming.answer, result.naming.trials
    before, after, floor, measured_on = result.rmse
    found: dict[str, Any] = {
        "schema": SCHEMA,
        "verdict": result.verdict,
        "where": _where(result),
        "effects": [_effect(result, c) for c in result.effects],
        "rmse_before": before,
        "rmse_after": after,
        "noise_floor": floor,
        "rmse_unit": PHI if inputs.unit == "phi" else inputs.unit,
        "measured_on": measured_on,
        "detection_before": None if verified is None else verified.rates[0],
        "detection_after": None if verified is None else verified.rates[1],
        "experiment": answer.experiment and str(answer.experiment),
        "model": None if addition.path is None else str(addition.path),
        "form": addition.form or None,
        "offer": None if addition.offer is None else str(addition.offer),
        "withdrawn": addition.withdrawn,
        "suspected": answer.suspected,
        "indistinguishable": [c.name for c in answer.indistinguishable],
        "beside": [c.name for c in answer.beside],
        "unknown_effect": result.unknown,
        "explained_share": result.naming.error.explained_share,
        "posterior": dict(result.naming.posterior),
        "ranking": [_candidate(c) for c in trials.ranking],
        "skipped": {name: list(signals) for name, signals in trials.skipped.items()},
        "steps": _steps(result),
        **_base(result.naming.base),
        "verified": None if verified is None else verified.as_json(),
        "warnings": list(result.all_warnings),
        "simulated": any(inputs.simulated),
        "sensor_known_good": inputs.sensor_known_good,
        "base_model": {"path": str(inputs.model), "sha256": inputs.sha256, "kind": inputs.kind},
        "recordings": [*map(_recording, inputs.recordings)],
        "healthy": [*map(_recording, inputs.healthy)],
        "held_out": [*map(_recording, inputs.verify)],
        "seconds": result.seconds,
    }
    tree: dict[str, Any] = json_tree(found, digits=None)
    return tree


def _steps(result: Result) -> list[dict[str, Any]]:
    """Return the error of the model as it came and with each effect; none if none was tried."""
    steps: list[tuple[str | None, float]] = [(None, result.naming.error.before)]
    steps += [(r.effect.name, r.rmse) for r in result.naming.trials.rounds]
    added = [each.name for each in result.addition.effects if result.addition.path]
    told = [{"named": n, "added": n if n in added else None, "rmse": rmse} for n, rmse in steps]
    return told if result.tried else []


def _where(result: Result) -> list[dict[str, Any]]:
    """Return the answers of the comparison of runs, else the regimes that hold the excess."""
    if result.difference is not None:
        return [
            {
                "kind": "regime",
                "regime": f.sentence,
                "driver": f.driver or "everywhere",
                "point": f.kind,
                "p_value": f.p_value,
                "separated": f is result.difference.best,
            }
            for f in result.difference.findings
            if f.significant
        ]
    return [] if result.verified is None else result.verified.where()


def save(result: Result, path: Path) -> None:
    """Write ``gap.json``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(as_json(result), indent=1, allow_nan=False) + "\n")


def _effect(result: Result, chosen: Candidate) -> dict[str, Any]:
    """Return an entry of ``effects``; its parameters are those in the model."""
    second = runner_up(result, chosen)
    entry = _candidate(chosen)
    own = next((a for a in result.addition.effects if a.name == chosen.name), None)
    if own is not None:
        entry |= {"parameters": dict(own.parameters), "standard_errors": dict(own.standard_errors)}
    if chosen.kind == "empirical":
        values = own.parameters if own is not None else chosen.parameters
        entry["formula"] = formula(chosen.name, list(values.values()))
    return entry | {
        "runner_up": None if second is None else second.name,
        "runner_up_score": None if second is None else second.merit.score,
        "separated": result.verdict == "named",  # it alone holds 95 % of the probability
        "added": own is not None and result.addition.path is not None,
    }


def _candidate(c: Candidate) -> dict[str, Any]:
    merit = c.merit
    return {
        "name": c.name,
        "hypothesis": c.label,
        "kind": c.kind,
        "class": list(c.like),
        "tag": c.tag,
        "says": c.term.says,
        "parameters": c.parameters,
        "standard_errors": c.standard_errors,
        "units": {p.name: p.unit for p in c.term.parameters},
        "score": merit.score,
        "score_needed": merit.needed,
        "physical": merit.physical,
        "t": merit.t,
    }


def _recording(r: TrainingRecording) -> dict[str, Any]:
    return {"path": r.path, "sha256": r.sha256, "samples": r.samples, "source": r.source or None}


def _base(base: Base | None) -> dict[str, dict[str, float] | None]:
    """Return base, reference and shift by the JSON's names."""
    values = (base.constants, base.reference, base.shift) if base else (None, None, None)
    names = ("base", "reference", "base_shift")
    return {n: v and v._asdict() for n, v in zip(names, values, strict=True)}
