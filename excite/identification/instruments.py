"""Instruments for IDIM-IV: regressors along a motion free of encoder noise.

Janot, Vandanjon & Gautier, "A generic instrumental variable approach for industrial robot
identification", IEEE Trans. Control Systems Technology 22(1), 2014. Z is Γ along the motion of an
auxiliary model, the identified robot under its identified controllers that track q_ref, or along
q_ref itself. In either case q_ref may be shifted in time, joint by joint, to be closest to the
recorded motion, because commands are interpolated and filtered before a controller follows them and
clocks differ. Only these few parameters depend on the noise of the recording. Of the motions, the
one closest to the recorded motion is used, by the geometric mean over the joints of RMS distances
below the band.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray
from ..errors import UnusableInput
from ..recordings import Recording
from .controller_model import (
    ControllerCommand,
    ControllerModel,
    controller_command,
    identify_controller,
    simulate_tracking,
)
from .forward_dynamics import RobotDynamics, build_dynamics
from .lowpass import Grid
from .regression import IdentificationModel, TorqueEquations, build_equations
from .segments import RecordingSegment, extract_segments

DELAY_ITERATIONS = 3
"""Number of Gauss-Newton steps for the delay of the reference."""
MIN_DISTANCE = 1e-9
"""Distance from the recorded motion below which motions count as equally close [rad or m]."""


class InstrumentMotion(enum.Enum):
    """Motions along which instruments are computed."""

    AUXILIARY = "auxiliary model"
    REFERENCE = "reference motion"


@dataclass(frozen=True)
class Instruments:
    """Instruments and the motion that they come from.

    Attributes:
        equations: Equations along the motion, row by row with the recorded ones. Their regressor is
            Z; nuisance columns computed from them are the instruments of the recorded ones.
        segments: The motion.
        motion: Kind of motion.
        controller: The identified controllers.
        delay: Delay given to the reference. Shape (n,) [s].
        auxiliary_distance: RMS distance below the band of the auxiliary motion from the recorded
            one, ∞ if it loses the reference. Shape (n,) [rad or m].
        reference_distance: RMS distance of the reference from the recorded motion. Shape (n,).
        is_requested: True if the caller requested this kind of motion.
    """

    equations: TorqueEquations
    segments: tuple[RecordingSegment, ...]
    motion: InstrumentMotion
    controller: ControllerModel
    delay: FloatArray
    auxiliary_distance: FloatArray
    reference_distance: FloatArray
    is_requested: bool = False

    @property
    def rows(self) -> FloatArray:
        """Z. Shape (N, n, p)."""
        return self.equations.regressor

    @property
    def summary(self) -> str:
        """The kind of motion and the reason for it in one line."""
        if self.is_requested:
            reason = "as requested"
        elif not np.isfinite(self.auxiliary_distance).all():
            reason = "the auxiliary model loses the reference under the identified controllers"
        else:
            ratio = _geometric_mean(self.auxiliary_distance) / _geometric_mean(
                self.reference_distance
            )
            reason = (
                f"the distance of the auxiliary motion over that of the reference is {ratio:.2g}"
            )
        return f"instruments along the {self.motion.value}: {reason}"


def build_instruments(
    model: IdentificationModel,
    recordings: Sequence[Recording],
    hertz: float,
    psi: FloatArray,
    motion: InstrumentMotion | None = None,
    *,
    average: bool = True,
) -> Instruments:
    """Compute instruments, row by row with the equations of the recordings.

    The rows are those of
    `build_equations(model, extract_segments(recordings, average=average), hertz)`.

    Args:
        model: The model.
        recordings: Recordings with commanded positions.
        hertz: Cutoff frequency [Hz].
        psi: A first, physically consistent estimate, as by least squares. Shape (P,).
        motion: Kind of motion; by default the one closest to the recorded motion.
        average: Average whole periods.

    Raises:
        UnusableInput: Commanded positions are missing, or the auxiliary model was requested and
            loses the reference.
    """
    for recording in recordings:
        _require_reference(recording)
    measured = list(extract_segments(recordings, average=average))
    commanded = list(
        extract_segments(
            [dataclasses.replace(r, q=r.qref) for r in recordings if r.qref is not None],
            average=average,
        )
    )
    dynamics, best = build_dynamics(model, psi), None
    for delay in (np.zeros(model.robot.n), _reference_delay(measured, commanded, hertz)):
        delayed = [_delayed(segment, delay) for segment in commanded]
        candidate = _candidate(dynamics, measured, delayed, hertz, motion, delay)
        if candidate is not None and (best is None or candidate.distance < best.distance):
            best = candidate
    if best is None:
        raise UnusableInput(
            f"{recordings[0].source}: the auxiliary model loses qref under the identified "
            "controllers; use the reference motion as instrument"
        )
    equations = build_equations(model, best.segments, hertz)
    return Instruments(
        equations,
        tuple(best.segments),
        best.motion,
        best.controller,
        best.delay,
        best.auxiliary_distance,
        best.reference_distance,
        motion is not None,
    )


@dataclass(frozen=True)
class _Candidate:
    """A motion for instruments; attributes as of `Instruments`."""

    segments: Sequence[RecordingSegment]
    motion: InstrumentMotion
    controller: ControllerModel
    delay: FloatArray
    auxiliary_distance: FloatArray
    reference_distance: FloatArray

    @property
    def distance(self) -> float:
        """Distance from the recorded motion."""
        return _geometric_mean(
            self.auxiliary_distance
            if self.motion is InstrumentMotion.AUXILIARY
            else self.reference_distance
        )


def _candidate(
    dynamics: RobotDynamics,
    measured: Sequence[RecordingSegment],
    commanded: Sequence[RecordingSegment],
    hertz: float,
    motion: InstrumentMotion | None,
    delay: FloatArray,
) -> _Candidate | None:
    """The better motion for one delay; None if the auxiliary model was requested and is lost."""
    commands = [controller_command(dynamics, segment, hertz) for segment in commanded]
    controller = identify_controller(commands, measured, hertz)
    reference_distance = _distance(measured, commanded, hertz)
    auxiliary = (
        []
        if motion is InstrumentMotion.REFERENCE
        else _auxiliary_motion(dynamics, controller, commands, commanded)
    )
    auxiliary_distance = (
        _distance(measured, auxiliary, hertz)
        if auxiliary
        else np.full(len(reference_distance), np.inf)
    )
    if motion is InstrumentMotion.AUXILIARY and not auxiliary:
        return None
    chosen = motion or (
        InstrumentMotion.AUXILIARY
        if _geometric_mean(auxiliary_distance) < _geometric_mean(reference_distance)
        else InstrumentMotion.REFERENCE
    )
    return _Candidate(
        auxiliary if chosen is InstrumentMotion.AUXILIARY else commanded,
        chosen,
        controller,
        delay,
        auxiliary_distance,
        reference_distance,
    )


def _reference_delay(
    measured: Sequence[RecordingSegment], commanded: Sequence[RecordingSegment], hertz: float
) -> FloatArray:
    """Delay d for which q_ref(t − d) is closest to q, by Gauss-Newton steps. Shape (n,) [s]."""
    delay = np.zeros(measured[0].q.shape[1])
    for _ in range(DELAY_ITERATIONS):
        product, square = np.zeros_like(delay), np.zeros_like(delay)
        for segment, reference in zip(measured, commanded, strict=True):
            band, delayed = segment.band(hertz), _delayed(reference, delay)
            speed = band.filter(delayed.q, Grid.KEPT, 1)
            product += np.sum(speed * band.filter(delayed.q - segment.q, Grid.KEPT), axis=0)
            square += np.sum(speed**2, axis=0)
        delay = delay + product / np.maximum(square, 1e-300)
    return delay


def _delayed(segment: RecordingSegment, delay: FloatArray) -> RecordingSegment:
    """The segment with each joint's position delayed, constant beyond its ends."""
    if not delay.any():
        return segment
    from scipy.interpolate import CubicSpline  # slow to import

    t, length = np.arange(len(segment)) / segment.rate, len(segment) / segment.rate
    q = np.vstack([segment.q, segment.q[:1]]) if segment.periodic else segment.q
    splines = CubicSpline(
        np.arange(len(q)) / segment.rate,
        q,
        bc_type="periodic" if segment.periodic else "not-a-knot",
    )
    times = [(t - d) % length if segment.periodic else np.clip(t - d, 0.0, t[-1]) for d in delay]
    return dataclasses.replace(
        segment, q=np.column_stack([splines(time)[:, j] for j, time in enumerate(times)])
    )


def _require_reference(recording: Recording) -> None:
    """Refuse a recording without the commanded position of a joint."""
    for i, joint in enumerate(recording.joints):
        if recording.qref is None or not np.isfinite(recording.qref[:, i]).all():
            problem = (
                "lacks the commanded position in some rows"
                if recording.has("qref", joint)
                else "has no commanded position"
            )
            raise UnusableInput(
                f"{recording.source}: joint '{joint}' {problem}, from which instruments are "
                f"computed; record qref.{joint} or use another --estimator"
            )


def _auxiliary_motion(
    dynamics: RobotDynamics,
    controller: ControllerModel,
    commands: Sequence[ControllerCommand],
    commanded: Sequence[RecordingSegment],
) -> list[RecordingSegment]:
    """The segments as the model moves under its controllers; empty if it is lost in any of them."""
    out = []
    for k, (command, segment) in enumerate(zip(commands, commanded, strict=True)):
        q = simulate_tracking(dynamics, controller, command, k)
        if q is None:
            return []
        out.append(dataclasses.replace(segment, q=q))
    return out


def _distance(
    measured: Sequence[RecordingSegment], others: Sequence[RecordingSegment], hertz: float
) -> FloatArray:
    """RMS difference of positions below the band. Shape (n,) [rad or m]."""
    parts = []
    for segment, other in zip(measured, others, strict=True):
        band = segment.band(hertz)
        parts.append(band.filter(segment.q - other.q, Grid.KEPT))
    return np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0))


def _geometric_mean(distances: FloatArray) -> float:
    """Geometric mean over the joints of distances, each at least MIN_DISTANCE."""
    return float(np.exp(np.mean(np.log(np.maximum(distances, MIN_DISTANCE)))))
