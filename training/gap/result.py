"""The result of the gap workflow for one vehicle, and its form in ``gap.json``.

The JSON's names are a contract: DESIGN, section 4.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from monitor.base.outputs import write_text
from monitor.model.card import TrainingRecording
from monitor.model.step import Model
from training.gap.config import CONFIG
from training.gap.name.ranking import RIVAL_SCORE, WIN
from training.gap.name.verdict import Candidate, Naming, Verdict
from training.gap.verify.evidence import Verification
from training.gap.where.findings import Findings
from training.greybox.chain import Constants
from training.greybox.effects.model_effect import ModelEffect
from training.jobs.json_tree import plain
from training.recordings.recording import sha256

SCHEMA: Final = "o2train.gap/1"
HELD_OUT_DRIVES: Final = "recordings that no fit saw"
HELD_OUT_BLOCKS: Final = "blocks held out of the recordings"
NOTHING_FITTED: Final = "recordings to which nothing was fitted"


@dataclass(frozen=True, slots=True)
class ModelFile:
    """A model file with its hash and kind."""

    path: Path
    sha256: str
    kind: str  # "narx", "greybox"

    @classmethod
    def of(cls, path: Path) -> "ModelFile":
        """Return the model in ``path``; raises ModelError if it is none."""
        return cls(path, sha256(path), Model.load(path).card.kind)


@dataclass(frozen=True, slots=True)
class Step:
    """One round of adding: the effect, the error after it and the ranking it came from."""

    added: str  # the effect, "" for the model as it came
    rmse: float  # phi, outside fuel cut, after it was added
    ranking: tuple[Candidate, ...] = ()  # out of which it was chosen, best first


@dataclass(frozen=True, slots=True)
class Result:
    """Findings, naming, new model and verification of one run."""

    model: ModelFile
    recordings: tuple[TrainingRecording, ...]  # in which the effect was looked for
    healthy: tuple[TrainingRecording, ...]
    held_out: tuple[TrainingRecording, ...]  # for verifying; no parameter of the new model saw them
    findings: Findings | None
    naming: Naming
    added: tuple[ModelEffect, ...] = ()  # as in the new model
    form: str = ""  # how it was added, a sentence
    verified: Verification | None = None
    new_model: Path | None = None
    steps: tuple[Step, ...] = ()
    unknown: str | None = None  # description of an effect that is not in the library, sentences
    warnings: tuple[str, ...] = ()  # beside those of the naming
    sensor_known_good: bool = False
    seconds: float | None = None
    withdrawn: str | None = None  # why a new model was not kept: what the monitor loses by it

    @property
    def verdict(self) -> Verdict:
        """Return the naming's verdict."""
        return self.naming.verdict

    @property
    def effects(self) -> tuple[Candidate, ...]:
        """Return the named effects, or the ambiguous set, at most three."""
        found = self.naming.effects if self.verdict in ("named", "ambiguous") else ()
        return found[: CONFIG.inputs.effects_max]

    @property
    def tried(self) -> bool:
        """Return whether any effect could be tried; without fuel and air none can."""
        return self.naming.base is not None

    @property
    def simulated(self) -> tuple[bool, ...]:
        """Return for every recording whether it says that it is simulated."""
        used = (*self.recordings, *self.healthy, *self.held_out)
        return tuple("simulated" in r.source for r in used)

    @property
    def rmse(self) -> tuple[float, float | None, float, str]:
        """Return RMSE before and after, the floor, all in phi, and the samples they are of."""
        naming, verified = self.naming, self.verified
        if verified is not None and verified.overall.floor is not None:
            whole = verified.overall
            after = whole.after if self.added else None
            return whole.before, after, verified.overall.floor, HELD_OUT_DRIVES
        after = naming.rmse_after if self.added else None
        measured_on = HELD_OUT_BLOCKS if self.tried else NOTHING_FITTED
        return naming.rmse_before, after, naming.noise_floor, measured_on

    @property
    def all_warnings(self) -> tuple[str, ...]:
        """Return the warnings of naming, adding and verifying without repetition."""
        worse = [
            f"worse beyond confidence with the new model: {e.regime}, "
            f"RMSE {e.before:.4f} before and {e.after:.4f} after, in phi"
            for e in (self.verified.worse if self.verified else ())
        ]
        return tuple(dict.fromkeys((*self.naming.warnings, *self.warnings, *worse)))

    def ranking_of(self, name: str) -> tuple[Candidate, ...]:
        """Return the ranking out of which an effect was chosen, best first."""
        chosen = next((s.ranking for s in self.steps if s.added == name and s.ranking), ())
        return chosen or self.naming.ranking


def steps_of(naming: Naming) -> tuple[Step, ...]:
    """Return the model as it came, then each round of a naming."""
    first = Step("", naming.rmse_before)
    return (first, *(Step(r.effect.name, r.rmse, r.ranking) for r in naming.rounds))


def runner_up(result: Result, effect: Candidate) -> Candidate | None:
    """Return the best other candidate of the ranking out of which an effect was chosen."""
    others = [c for c in result.ranking_of(effect.name) if c.name != effect.name]
    return max(others, key=lambda c: c.score, default=None)


def separated(result: Result, effect: Candidate) -> bool:
    """Return whether an effect beats every rival outside its class.

    A rival is a candidate with at least half of its score. ``win`` of a ranking is how often
    resampled blocks prefer the best to the candidate.
    """
    if result.verdict != "named":
        return False
    return all(
        c.win is None or c.win >= WIN
        for c in result.ranking_of(effect.name)
        if c.name not in (effect.name, *effect.like) and c.score >= RIVAL_SCORE * effect.score
    )


def as_json(result: Result) -> dict[str, Any]:
    """Return ``gap.json``; every number is finite or null."""
    naming, verified = result.naming, result.verified
    before, after, floor, measured_on = result.rmse
    found: dict[str, Any] = {
        "schema": SCHEMA,
        "verdict": result.verdict,
        "where": [] if result.findings is None else result.findings.where(),
        "effects": [_effect(result, c) for c in result.effects],
        "rmse_before": before,
        "rmse_after": after,
        "noise_floor": floor,
        "rmse_unit": "phi = 1 / lambda, outside fuel cut",
        "measured_on": measured_on,
        "detection_before": None if verified is None else verified.rate_before,
        "detection_after": None if verified is None else verified.rate_after,
        "experiment": None if naming.experiment is None else str(naming.experiment),
        "model": None if result.new_model is None else str(result.new_model),
        "form": result.form or None,
        "withdrawn": result.withdrawn,
        "suspected": naming.suspected,
        "indistinguishable": [c.name for c in naming.indistinguishable],
        "unknown_effect": result.unknown,
        "explained_share": naming.explained_share,
        "ranking": [_candidate(c) for c in naming.ranking],
        "skipped": {name: list(signals) for name, signals in naming.skipped.items()},
        "steps": [{"added": s.added or None, "rmse": s.rmse} for s in result.steps],
        "base": _constants(naming.base),
        "reference": _constants(naming.reference),
        "base_shift": _constants(naming.base_shift),
        "verified": None if verified is None else verified.as_json(),
        "warnings": list(result.all_warnings),
        "simulated": any(result.simulated),
        "sensor_known_good": result.sensor_known_good,
        "base_model": {
            "path": str(result.model.path),
            "sha256": result.model.sha256,
            "kind": result.model.kind,
        },
        **{
            role: [_recording(r) for r in used]
            for role, used in (
                ("recordings", result.recordings),
                ("healthy", result.healthy),
                ("held_out", result.held_out),
            )
        },
        "seconds": result.seconds,
    }
    tree: dict[str, Any] = plain(found, digits=None)
    return tree


def save(result: Result, path: Path) -> None:
    """Write ``gap.json``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(as_json(result), indent=1, allow_nan=False) + "\n")


def _effect(result: Result, chosen: Candidate) -> dict[str, Any]:
    """Return an entry of ``effects``; its parameters are those in the model."""
    second = runner_up(result, chosen)
    entry = _candidate(chosen)
    own = next((a for a in result.added if a.name == chosen.name), None)
    if own is not None:
        entry |= {
            "parameters": dict(own.parameters),
            "standard_errors": dict(own.standard_errors),
        }
    return entry | {
        "runner_up": None if second is None else second.name,
        "runner_up_score": None if second is None else second.score,
        "runner_up_win": None if second is None else second.win,
        "separated": separated(result, chosen),
        "added": own is not None,
    }


def _candidate(c: Candidate) -> dict[str, Any]:
    return {
        "name": c.name,
        "kind": c.kind,
        "class": list(c.like),
        "tag": c.tag,
        "says": c.says,
        "parameters": dict(c.parameters),
        "standard_errors": dict(c.standard_errors),
        "units": dict(c.units),
        "score": c.score,
        "score_needed": c.needed,
        "physical": c.physical,
        "t": c.t,
        "adequacy": c.adequacy,
        "win": c.win,
    }


def _recording(r: TrainingRecording) -> dict[str, Any]:
    return {"path": r.path, "sha256": r.sha256, "samples": r.samples, "source": r.source or None}


def _constants(values: Constants | None) -> dict[str, float] | None:
    return None if values is None else values._asdict()
