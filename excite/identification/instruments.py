"""Instruments for IDIM-IV: regressors along a motion that has no noise of the encoders in it (Janot, Vandanjon & Gautier 2014).

Z is Γ along the motion of the auxiliary model, which is the identified robot under the identified controller, tracking q_ref; or along
q_ref itself. Either may be told q_ref as much later (or earlier: clocks differ) as brings it closest to the recorded motion, joint by
joint: commands are interpolated and filtered before a controller follows them. All of this knows of the recording's noise only through
a few parameters. What is taken is the motion closest to the recorded one, by the geometric mean over the joints of RMS distances
below the band.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import UnusableInput
from ..recordings import Recording
from . import controller_model, forward_dynamics, regression, segments
from .controller_model import ControllerModel
from .forward_dynamics import RobotDynamics
from .lowpass import Grid
from .regression import IdentificationModel, TorqueEquations
from .segments import Segment

Array = np.ndarray


class InstrumentMotion(enum.Enum):
    """Along which motion instruments are computed."""

    AUXILIARY = "auxiliary model"
    REFERENCE = "reference motion"


@dataclass(frozen=True)
class Instruments:
    """equations: those along the motion, row by row with the recorded ones; Z is their regressor, and what is computed of them as
    nuisance is its instrument. pieces: the motion. kind: which.

    law: of the controller. delay: of the reference, as taken. Shape (n,) [s]. strayed: RMS distance of the auxiliary motion from the
    recorded one, inf where it was lost; behind: that of the reference. Shapes (n,) [rad or m], below the band. asked: the kind was.
    """

    equations: TorqueEquations
    pieces: tuple[Segment, ...]
    kind: InstrumentMotion
    law: ControllerModel
    delay: Array
    strayed: Array
    behind: Array
    asked: bool = False

    @property
    def rows(self) -> Array:
        """Z. Shape (N, n, p)."""
        return self.equations.regressor

    @property
    def words(self) -> str:
        """Which motion, and why."""
        if self.asked:
            why = "as asked"
        elif not np.isfinite(self.strayed).all():
            why = "the model loses it under the controller that the recording suggests"
        else:
            why = f"the auxiliary one is off the recorded one by {_mean(self.strayed) / _mean(self.behind):.2g} of what the reference is"
        return f"instruments along the {self.kind.value}: {why}"


def build_instruments(
    model: IdentificationModel,
    recordings: Sequence[Recording],
    hertz: float,
    psi: Array,
    kind: InstrumentMotion | None = None,
    *,
    average: bool = True,
) -> Instruments:
    """Z with the filter, the grid and the mean periods of `equations.build(model, signals.pieces(recordings, average=average), hertz)`.

    psi: a first, physically consistent estimate, such as one by least squares. Shape (P,). kind: which motion; None: by the rule above.
    Raises UnusableInput, naming file and joint, where there is no q_ref, and where the auxiliary model was asked for and is lost.
    """
    for recording in recordings:
        _require_reference(recording)
    measured = list(segments.extract_segments(recordings, average=average))
    told = list(
        segments.extract_segments(
            [dataclasses.replace(r, q=r.qref) for r in recordings if r.qref is not None],
            average=average,
        )
    )
    body, best = forward_dynamics.build_dynamics(model, psi), None
    for delay in (np.zeros(model.robot.n), _delay(measured, told, hertz)):
        late = [_later(piece, delay) for piece in told]
        trial = _trial(body, measured, late, hertz, kind, delay)
        if trial is not None and (best is None or trial.distance < best.distance):
            best = trial
    if best is None:
        raise UnusableInput(
            f"{recordings[0].source}: the model loses qref under the controller found; take the reference motion as instrument"
        )
    rows = regression.build_equations(model, best.pieces, hertz)
    return Instruments(
        rows,
        tuple(best.pieces),
        best.kind,
        best.law,
        best.delay,
        best.strayed,
        best.behind,
        kind is not None,
    )


@dataclass(frozen=True)
class _Trial:
    pieces: Sequence[Segment]
    kind: InstrumentMotion
    law: ControllerModel
    delay: Array
    strayed: Array
    behind: Array

    @property
    def distance(self) -> float:
        return _mean(self.strayed if self.kind is InstrumentMotion.AUXILIARY else self.behind)


def _trial(
    body: RobotDynamics,
    measured: Sequence[Segment],
    told: Sequence[Segment],
    hertz: float,
    kind: InstrumentMotion | None,
    delay: Array,
) -> _Trial | None:
    """The better motion of one reference; None where the auxiliary one was asked for and is lost."""
    commands = [controller_model.controller_command(body, piece, hertz) for piece in told]
    law = controller_model.identify_controller(commands, measured, hertz)
    behind = _distance(measured, told, hertz)
    moved = [] if kind is InstrumentMotion.REFERENCE else _auxiliary(body, law, commands, told)
    strayed = _distance(measured, moved, hertz) if moved else np.full(len(behind), np.inf)
    if kind is InstrumentMotion.AUXILIARY and not moved:
        return None
    chosen = kind or (InstrumentMotion.AUXILIARY if _mean(strayed) < _mean(behind) else InstrumentMotion.REFERENCE)
    return _Trial(moved if chosen is InstrumentMotion.AUXILIARY else told, chosen, law, delay, strayed, behind)


def _delay(measured: Sequence[Segment], told: Sequence[Segment], hertz: float) -> Array:
    """How much later q_ref(t − d) is closest to q, to first order and improved once. Shape (n,) [s]."""
    delay = np.zeros(measured[0].q.shape[1])
    for _ in range(3):
        up, down = np.zeros_like(delay), np.zeros_like(delay)
        for piece, reference in zip(measured, told, strict=True):
            band, late = piece.band(hertz), _later(reference, delay)
            speed = band.low(late.q, Grid.KEPT, 1)
            up += np.sum(speed * band.low(late.q - piece.q, Grid.KEPT), axis=0)
            down += np.sum(speed**2, axis=0)
        delay = delay + up / np.maximum(down, 1e-300)
    return delay


def _later(piece: Segment, delay: Array) -> Segment:
    """The piece with each joint's position so much later, held beyond its ends."""
    if not delay.any():
        return piece
    from scipy.interpolate import CubicSpline  # slow to import

    t, length = np.arange(len(piece)) / piece.rate, len(piece) / piece.rate
    q = np.vstack([piece.q, piece.q[:1]]) if piece.periodic else piece.q
    splines = CubicSpline(
        np.arange(len(q)) / piece.rate, q, bc_type="periodic" if piece.periodic else "not-a-knot"
    )
    times = [(t - d) % length if piece.periodic else np.clip(t - d, 0.0, t[-1]) for d in delay]
    return dataclasses.replace(
        piece, q=np.column_stack([splines(time)[:, j] for j, time in enumerate(times)])
    )


def _require_reference(recording: Recording) -> None:
    for i, joint in enumerate(recording.joints):
        if recording.qref is None or not np.isfinite(recording.qref[:, i]).all():
            lack = "has rows without" if recording.has("qref", joint) else "has no"
            raise UnusableInput(
                f"{recording.source}: joint '{joint}' {lack} commanded position, which instruments come from; record qref.{joint}, "
                "or take another estimator"
            )


def _auxiliary(
    body: RobotDynamics, law: ControllerModel, commands: Sequence[controller_model.ControllerCommand], told: Sequence[Segment]
) -> list[Segment]:
    """The pieces as the model under the law moves; none where it is lost in any."""
    out = []
    for k, (command, piece) in enumerate(zip(commands, told, strict=True)):
        q = controller_model.simulate_tracking(body, law, command, k)
        if q is None:
            return []
        out.append(dataclasses.replace(piece, q=q))
    return out


def _distance(measured: Sequence[Segment], others: Sequence[Segment], hertz: float) -> Array:
    """RMS of the difference of positions below the band. Shape (n,)."""
    parts = []
    for piece, other in zip(measured, others, strict=True):
        band = piece.band(hertz)
        parts.append(band.low(piece.q - other.q, Grid.KEPT))
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0))


def _mean(distances: Array) -> float:
    """Geometric mean over joints, none of which counts as closer than a nanoradian."""
    return float(np.exp(np.mean(np.log(np.maximum(distances, 1e-9)))))
