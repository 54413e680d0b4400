"""Course of a diagnosis: from the equations of two folds to findings, with a decreasing scale."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from .._types import BoolArray, FloatArray
from ..effects import EFFECTS, recorded_motion
from ..effects.recorded_motion import RecordedMotion
from ..identification.identification import Identification
from . import equations, held_out_test, judge, late, noise, once, search, session_changes
from .judge import Verdict
from .noise import NoiseEstimate
from .search import EffectRegression
from .session_changes import Halves

Progress = Callable[[str], None]
MISFIT = {"periods": 0.1, "differences": 0.3}
"""Share of the residual taken for a form that is not quite the catalogue's, by how the noise is
known."""
AGAIN, COARSE = 2, 0.7
"""Times that all is looked at again over what is left, and from which share of its scale on that is
not worth it."""

CLEAR = 0.3
"""Of what is left with drives that are the same in all recordings, what others must leave, to be
told before anything is taken for late."""


@dataclass(frozen=True)
class Course:
    """State of a diagnosis.

    Attributes:
        one: The effect regression.
        verdict: The verdict.
        noisy: The noise estimate.
        scale: Scale by which torque is divided [N m], shape (n,).
        differing: Whether every recording after the first has its own actuator parameters.
    """

    one: EffectRegression
    verdict: Verdict
    noisy: NoiseEstimate
    scale: FloatArray
    differing: bool = False

    @property
    def shapes(self) -> tuple[int, ...]:
        """Indices of the accepted candidate models."""
        return () if self.verdict.together is None else self.verdict.together.shapes

    @property
    def residual(self) -> FloatArray:
        """Mean square residual of all recordings over that of a right model, shape (n,)."""
        return search.level(self.one, self.shapes) * (self.scale / self.noisy.noise_rms) ** 2

    @property
    def later(self) -> FloatArray:
        """Residual of the held-out torque over the scale, shape (N, n)."""
        return held_out_test.residuals(self.one, self.verdict.together, np.ones(len(self.scale)))[1]

    def explained(self, moves: BoolArray) -> bool:
        """Return True if no residual exceeds the noise, on all and on held-out recordings."""
        most = 1.0 + session_changes.MIN_EXCESS
        return bool(
            (self.residual < most).all()
            and (search.mean_square(self.later, moves) < most * self._expected).all()
        )

    def otherwise(
        self,
        other: Callable[[], EffectRegression],
        scale: FloatArray,
        every: Sequence[RecordedMotion],
        moves: BoolArray,
    ) -> bool:
        """Return True if the residual says that actuators differ between recordings."""
        if session_changes.differs(
            self.one, self.shapes, every, (self.noisy.noise_rms / self.scale) ** 2
        ):
            return True
        left, by = self.later, self.scale / scale
        return session_changes.differs_later(
            left, held_out_test.levelled(other(), left * by) / by, moves, self._expected
        )

    @property
    def _expected(self) -> FloatArray:
        """Mean square over the scale of a right model's held-out residual, shape (n,)."""
        return np.asarray(
            (self.noisy.noise_rms / self.scale) ** 2
            + held_out_test.reach(self.one, np.ones(len(self.scale))) ** 2
        )


def run(
    identified: Identification,
    halves: Halves,
    noisy: NoiseEstimate,
    trusted: Mapping[int, float],
    names: Collection[str],
    progress: Progress,
) -> Course:
    """Search with common actuator parameters, and where these do not suffice with separate ones.

    Effects come first: over speed they may look like a change of friction if each recording has its
    own speed. For `trusted` and `names` see `diagnosis.DiagnosisOptions`.
    """
    every, scale = (
        [*halves[0], *halves[1]],
        _scale(noisy, np.sqrt(np.mean(identified.data.residual**2, axis=0))),
    )
    listed = equations.shapes(halves, bool(trusted), noisy.floor, names)
    build = equations.builder(halves, scale, listed)

    def bare(differing: Halves | None) -> EffectRegression:
        first, second = (
            equations.half(half, identified, trusted, scale, differing) for half in halves
        )
        return search.bare((first, second), build)

    @cache
    def with_own_drives() -> Course | None:
        progress("drives may differ between the recordings: beside drives of their own")
        found = replace(
            _followed(_begun(search.filled(bare(halves), listed), noisy, scale), every),
            differing=True,
        )
        return (
            found
            if any(
                change.is_significant
                for change in session_changes.changes(found.one, found.shapes, halves)
            )
            else None
        )

    def differs(found: Course) -> bool:
        return not (at_first or found.explained(moves)) and found.otherwise(
            lambda: bare(halves), scale, every, moves
        )

    one, moves = search.filled(bare(None), listed), np.concatenate([t.moving for t in halves[1]])
    at_first = session_changes.differs_at_first(one, every, (noisy.noise_rms / scale) ** 2)
    if at_first and (other := with_own_drives()) is not None:
        return other
    progress(f"{len(listed)} shapes of {len(EFFECTS)} effects, alone and together")
    begun = _begun(one, noisy, scale)
    if (
        differs(begun)
        and (other := with_own_drives()) is not None
        and float(other.residual.sum()) < CLEAR * float(begun.residual.sum())
    ):
        return other  # whatever is late, it is not that
    found = _followed(begun, every)
    if not differs(found) or (other := with_own_drives()) is None:
        return found
    return found if float(other.residual.sum()) > float(found.residual.sum()) else other


def _begun(one: EffectRegression, noisy: NoiseEstimate, scale: FloatArray) -> Course:
    """The result of a search with the initial scale, then with the residual's."""
    one, verdict = judge.judged(_warned(one, noisy, scale))
    one, verdict, scale = _sharper(one, verdict, noisy, scale)
    return Course(one, verdict, noisy, scale)


def _followed(begun: Course, every: Sequence[RecordedMotion]) -> Course:
    """The same with delayed effects, and with the noise re-estimated without contacts."""
    noisy = begun.noisy
    one, verdict, scale = _sharper(*late.followed(begun.one, begun.verdict), noisy, begun.scale)
    for _ in range(AGAIN):
        if verdict.together is None or all(
            one.shapes[i].interval is None for i in verdict.together.shapes
        ):
            break
        left = search.remaining(one, verdict.together.shapes) * scale
        noisy = noise.refine_by_repetition(
            noisy, every, recorded_motion.split_by_motion(left, every)
        )
        one, verdict, scale = _sharper(one, verdict, noisy, scale)
    return Course(one, once.kept(one, verdict, every, noisy.periods), noisy, scale)


def _scale(noisy: NoiseEstimate, left: FloatArray) -> FloatArray:
    """Noise plus a share of the RMS residual for inexact forms of effects [N m], shape (n,)."""
    return np.asarray(np.sqrt(noisy.floor**2 + (MISFIT[noisy.method] * left) ** 2))


def _warned(one: EffectRegression, noisy: NoiseEstimate, scale: FloatArray) -> EffectRegression:
    """The regression with the gains that measurement artefacts mimic."""
    steps, sharpened = (
        [((a / scale).ravel(), (b / scale).ravel()) for a, b in own]
        for own in (noisy.quantization_draws, [noisy.sharpened])
    )
    stepped = float(np.mean((noisy.steps / noisy.floor) ** 2))
    return judge.warned(
        one,
        steps,
        sharpened[0],
        stepped,
        (noisy.floor / scale) ** 2 if noisy.method == "periods" else None,
    )


def _sharper(
    one: EffectRegression, verdict: Verdict, noisy: NoiseEstimate, scale: FloatArray
) -> tuple[EffectRegression, Verdict, FloatArray]:
    """Search again with the scale of the residual, so that weak effects become visible."""
    for _ in range(AGAIN):
        if verdict.together is None:
            break
        finer = np.minimum(_scale(noisy, rms(one, verdict.together.shapes, scale)), scale)
        if (finer > COARSE * scale).all():
            break
        one = _warned(search.rescaled(one, scale / finer), noisy, finer)
        one, verdict = judge.judged(one, verdict.together.shapes)
        scale = finer
    return one, verdict, scale


def rms(one: EffectRegression, shapes: Sequence[int], scale: FloatArray) -> FloatArray:
    """Return the RMS residual of a fit to all recordings [N m], shape (n,)."""
    return np.asarray(np.sqrt(search.level(one, shapes)) * scale)
