"""Selection of rare effects, one at a time, on top of the joint model.

Every candidate is scored by the evidence that it adds for the whole robot, jointly with all that
the model has. The best enters, its nonlinear parameters optimised, and is judged after the weights
of the rows are renewed: an effect that is left out makes its own residual look correlated, and so
hides itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ..effects import EFFECTS
from ..effects.effect import CandidateModel
from ..effects.recorded_motion import RecordedMotion
from ..identification.identification import Identification
from . import joint_model, posterior
from .joint_model import JointModel
from .regression import CandidateFit, Columns

MAX_RARE_EFFECTS = 8
"""Rare effects that are added at most."""
RARE_LOG_ODDS = -4.0
"""Prior log odds that a joint has a certain rare effect: about 2 %."""
MIN_SEVERITY = 0.3
"""Growth of the residual without an effect, over the noise, from which it counts."""
OPTIMISED_CANDIDATES = 4
"""Candidates whose nonlinear parameters are optimised before the best is chosen."""
MAX_REJECTIONS = 3
"""Candidates that are tried in vain before the search ends."""
DENSE_NAMES = ("stribeck", "nonlinear_viscous", "hysteresis", "load_friction", "torque_ripple")
"""Effects that the joint model has from the start."""


@dataclass(frozen=True)
class Candidate:
    """A candidate model with its columns and its fit on top of a joint model."""

    model: CandidateModel
    columns: Columns
    fit: CandidateFit

    @property
    def evidence(self) -> float:
        """Log Bayes factor for the candidate, before the choice among its shapes."""
        precision = 1.0 / self.columns.prior_std**2
        occam = np.linalg.slogdet(self.fit.information / np.sqrt(np.outer(precision, precision)))[1]
        return self.fit.gain - 0.5 * float(occam)


class CandidateColumns:
    """Columns of all candidates over the motions of a joint model, computed once."""

    def __init__(self, model: JointModel, trusted: bool, names: Collection[str] = ()) -> None:
        self.shapes: dict[tuple[str, int | None], list[tuple[CandidateModel, Columns]]] = {}
        for effect in EFFECTS:
            if effect.name in DENSE_NAMES or (effect.prior_only and not trusted):
                continue
            if names and effect.name not in names:
                continue
            for shape in effect.candidates(model.motions):
                columns = model.columns(shape)
                if columns is not None:
                    self.shapes.setdefault((effect.name, shape.joint), []).append((shape, columns))

    def best(
        self, model: JointModel, key: tuple[str, int | None]
    ) -> tuple[float, Candidate] | None:
        """Return the best plausible candidate of an effect at a joint and its evidence.

        The evidence is that of one effect whose shape is one of those tried, each as likely.
        """
        scored = []
        for shape, columns in self.shapes[key]:
            fit = model.regression.candidate(columns)
            if shape.is_plausible(fit.coefficients):
                scored.append(Candidate(shape, columns, fit))
        if not scored:
            return None
        best = max(scored, key=lambda c: c.evidence)
        others = np.array([c.evidence for c in scored])
        mean = best.evidence + float(np.log(np.mean(np.exp(others - best.evidence))))
        mean += float(np.log(len(scored) / len(self.shapes[key])))
        return mean, best


def optimised(model: JointModel, candidate: Candidate) -> Candidate:
    """Return a candidate with its nonlinear parameters optimised."""
    if candidate.model.nonlinear is None:
        return candidate

    def gain(shape: CandidateModel) -> float:
        columns = model.columns(shape)
        if columns is None:
            return -np.inf
        fit = model.regression.candidate(columns)
        return fit.gain if shape.is_plausible(fit.coefficients) else -np.inf

    shape = candidate.model.nonlinear.optimised(gain)
    columns = model.columns(shape)
    if columns is None:
        return candidate
    fit = model.regression.candidate(columns)
    if not shape.is_plausible(fit.coefficients) or fit.gain < candidate.fit.gain:
        return candidate
    return Candidate(shape, columns, fit)


def find_rare_effects(
    identified: Identification,
    motions: Sequence[RecordedMotion],
    trusted: bool = False,
    names: Collection[str] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[JointModel, tuple[CandidateModel, ...]]:
    """Fit the joint model, and add rare effects while there is evidence for one.

    Args:
        identified: The base model.
        motions: The motions to fit.
        trusted: Whether the base model is a trusted prior, so that effects that a refit absorbs can
            be found as well.
        names: Effects to look for; all when empty.
        progress: Called with a line of text for each candidate.

    Returns:
        The joint model and its rare effects.
    """
    rare: tuple[CandidateModel, ...] = ()
    model = joint_model.fit(identified, motions)
    rejected: set[tuple[str, int | None]] = set()
    while len(rare) < MAX_RARE_EFFECTS and len(rejected) < MAX_REJECTIONS:
        candidates = CandidateColumns(model, trusted, names)
        scored = []
        for key in candidates.shapes:
            if key in rejected:
                continue
            best = candidates.best(model, key)
            if best is not None and best[0] + RARE_LOG_ODDS > 0.0:
                scored.append((best[0], key, best[1]))
        if not scored:
            break
        scored.sort(key=lambda entry: -entry[0])
        # a shape between two grid points may explain more than another effect's best grid point
        tuned = [(key, optimised(model, c)) for _, key, c in scored[:OPTIMISED_CANDIDATES]]
        tuned.sort(key=lambda entry: -entry[1].evidence)
        accepted = False
        for key, candidate in tuned[: MAX_REJECTIONS - len(rejected)]:
            chosen = candidate.model
            extended = joint_model.fit(identified, motions, (*rare, chosen))
            groups = posterior.effect_groups(extended)
            if key not in groups:
                rejected.add(key)
                continue
            result = posterior.evidence_of(extended, key, groups[key], (), extended.solution)
            severity = float((result.severity / extended.regression.sigma).max())
            progress(
                f"{key}: log Bayes factor {result.log_bayes_factor:.1f}, severity {severity:.2f}"
            )
            if result.log_bayes_factor + RARE_LOG_ODDS > 0.0 and severity > MIN_SEVERITY:
                model, rare, accepted = extended, (*rare, chosen), True
                break
            rejected.add(key)
        if not accepted:
            break
    return model, rare
