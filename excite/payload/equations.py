"""Torque equations of recordings with and without a payload.

τ = Γ θ + f + Y_L A φ: base parameters of the robot, friction, and the ten parameters φ of the
payload, through the columns Y_L of the link that carries it and the change A of the frame. Friction
that grows with the load has two columns per joint, sgn(q̇) |τ_L| and sgn(q̇) τ_L², τ_L the torque
of the links with the payload (Hamon, Gautier & Garrec 2010), as in a diagnosis: left out, it is
taken for mass, as it is largest where the load is; with the first column alone, a friction that is
not linear in the load remains in the residual and widens all intervals. τ_L depends on the
estimate, so that the columns are computed again with it. Base parameters hold sums of inertias of
links and rotors, of which gears transmit the links' alone: they are divided by the URDF, as the
most probable parameters ψ = ψ₀ + S Bᵀ (B S Bᵀ)⁺ (θ − B ψ₀) of the prior covariance S.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import FloatArray, IntArray
from ..identification.friction_width import fit_widths
from ..identification.lowpass import MOTION_BANDWIDTH_RATIO, Grid, LowPassFilter, friction_speed
from ..identification.prior_weight import (
    USUAL_INERTIAL_DISTANCE,
    USUAL_JOINT_DISTANCE,
    joint_parameter_scales,
)
from ..identification.regression import (
    IdentificationModel,
    TorqueEquations,
    build_equations,
    kept_rows,
)
from ..identification.segments import RecordingSegment
from ..robot.dynamics import regressor
from ..robot.inertial_parameters import frame_map
from ..robot.robot import Robot
from ..robot.samples import Samples

LINK_PARAMETERS = 10
"""Inertial parameters of a body."""
LOAD_SHAPES = 2
"""Columns of friction that grows with the load, of each joint."""
SPEED_SHAPES = 2
"""Columns of friction over the speed beyond Coulomb and viscous friction, of each joint."""
RANK_TOLERANCE = 1e-9
"""Relative singular value below which a combination of base parameters counts as redundant."""
STRIBECK_SHARE = 0.1
"""Speed of the falling one of these, over the largest speed of the joint."""


@dataclass(frozen=True)
class PayloadPlace:
    """Where a payload is attached.

    Attributes:
        link: Name of the link.
        body: Index of the body of the model that the link belongs to.
        frame: Map A from parameters in the link's frame to those at the body's joint. Shape
            (10, 10).
    """

    link: str
    body: int
    frame: FloatArray


def payload_place(robot: Robot, link: str) -> PayloadPlace:
    """Return where a payload of a link acts.

    Args:
        robot: The robot.
        link: Name of a link or of a frame that is fixed to one.

    Raises:
        UnusableInput: There is no such link, or it does not move.
    """
    body, placement = robot.carrying_body(link, "--link")
    return PayloadPlace(link, body, frame_map(placement.homogeneous))


@dataclass(frozen=True)
class _Chunk:
    """A chunk of a segment.

    Attributes:
        band: Its filter.
        kept: Its rows on the kept grid.
        loads: Columns of the torque of the links on the coarse grid. Shape (C, n, 10 bodies).
        speed: Speed in friction at every sample. Shape (M, n).
        carries: Whether the payload was attached.
    """

    band: LowPassFilter
    kept: slice
    loads: FloatArray
    speed: FloatArray
    carries: bool


@dataclass(frozen=True)
class PayloadEquations:
    """The equations, and what the columns of friction are made of.

    Attributes:
        equations: Torque and the columns of θ and of the carrying link, at all rows.
        base_count: Number of columns of θ, which come first.
        link_columns: Indices of the ten columns of the carrying link.
        model: Model whose base lists these columns.
        place: Where the payload is attached.
        recording: Index of the recording with payload of each row; -1 without. Shape (N,).
        chunks: Chunks of the segments, in the order of the rows.
    """

    equations: TorqueEquations
    base_count: int
    link_columns: IntArray
    model: IdentificationModel
    place: PayloadPlace
    recording: IntArray
    chunks: tuple[_Chunk, ...]

    def payload_columns(self, recording: int | None = None) -> FloatArray:
        """Return the torque per unit of φ, zero without payload.

        Args:
            recording: Only in this recording; None: in all with payload.

        Returns:
            Shape (N, n, 10).
        """
        columns = self.equations.regressor[:, :, self.link_columns] @ self.place.frame
        inside = self.recording >= 0 if recording is None else self.recording == recording
        return np.where(inside[:, None, None], columns, 0.0)

    def robot_columns(self) -> FloatArray:
        """Return the columns of the robot: θ, other friction and offset with payload, widths.

        Shape (N, n, k).
        """
        base = self.equations.regressor[:, :, : self.base_count]
        columns = [base]
        if (self.recording < 0).any():
            # friction and offset may differ between the sessions
            joint_columns = self._joint_parameters()
            columns.append(
                np.where((self.recording >= 0)[:, None, None], base[:, :, joint_columns], 0.0)
            )
        return np.concatenate([*columns, self._diagonal(self.equations.slopes)], axis=2)

    def _joint_parameters(self) -> IntArray:
        """Indices of the columns of viscous and Coulomb friction and offset."""
        parameters, independent = self.model.parameters, self.model.base.independent
        out = []
        for kind in ("viscous", "coulomb", "offset"):
            if kind in parameters.drive:
                block = parameters.block(kind)
                inside = (independent[: self.base_count] >= block.start) & (
                    independent[: self.base_count] < block.stop
                )
                out.append(np.flatnonzero(inside))
        return np.concatenate([*out, np.zeros(0, int)]).astype(int)

    def _diagonal(self, columns: FloatArray) -> FloatArray:
        """A column of each joint that acts on it alone. Shape (N, n) -> (N, n, n)."""
        out = np.zeros((*columns.shape, columns.shape[1]))
        joints = np.arange(columns.shape[1])
        out[:, joints, joints] = columns
        return out

    def friction_columns(self, theta: FloatArray, phi: FloatArray) -> FloatArray:
        """Return friction that grows with the load, and shapes of friction over the speed.

        Args:
            theta: Parameters of the robot's columns, of which the first are θ.
            phi: Parameters of the payload in the link's frame. Shape (10,).

        Returns:
            Shape (N, n, n (LOAD_SHAPES + SPEED_SHAPES)).
        """
        loads = self._loads(theta, phi)
        fastest = np.max([np.abs(chunk.speed).max(axis=0) for chunk in self.chunks], axis=0)
        fastest = np.maximum(fastest, 1e-9)
        largest = _largest(loads)
        rows = [
            self._chunk_columns(chunk, load, largest, fastest)
            for chunk, load in zip(self.chunks, loads, strict=True)
        ]
        return np.concatenate(rows)

    def load_coefficients(
        self, theta: FloatArray, phi: FloatArray, columns: FloatArray
    ) -> FloatArray:
        """Return friction over load at the mean load of each joint. Shape (n,) [1].

        Args:
            theta: Parameters of the robot's columns, of which the first are θ.
            phi: Parameters of the payload in the link's frame. Shape (10,).
            columns: Coefficients of `friction_columns`.
        """
        linear, quadratic = columns.reshape(-1, self.equations.n)[:LOAD_SHAPES]
        loads = self._loads(theta, phi)
        mean = np.abs(np.concatenate(loads)).mean(axis=0)
        return np.asarray(linear + quadratic * mean / _largest(loads))

    def _loads(self, theta: FloatArray, phi: FloatArray) -> list[FloatArray]:
        """Torque of the links in each chunk, on the coarse grid. Shapes (C, n)."""
        psi = self._link_parameters(theta[: self.base_count])
        carrying, start = psi.copy(), LINK_PARAMETERS * self.place.body
        carrying[start : start + LINK_PARAMETERS] += self.place.frame @ phi
        return [chunk.loads @ (carrying if chunk.carries else psi) for chunk in self.chunks]

    def _link_parameters(self, theta: FloatArray) -> FloatArray:
        """Most probable inertial parameters of the links for base parameters θ. Shape (10 bodies,).

        Args:
            theta: θ. Shape (base_count,).
        """
        parameters, B = self.model.parameters, self.model.base.matrix
        edge = LINK_PARAMETERS * parameters.bodies
        scale = USUAL_INERTIAL_DISTANCE * parameters.scale
        scale[edge:, edge:] = np.diag(USUAL_JOINT_DISTANCE * joint_parameter_scales(parameters))
        half = B @ scale
        size = np.linalg.norm(half, axis=1)
        misfit = (theta - B @ parameters.nominal) / size
        change = scale @ np.linalg.lstsq(half / size[:, None], misfit, rcond=RANK_TOLERANCE)[0]
        return np.asarray((parameters.nominal + change)[:edge])

    def _chunk_columns(
        self, chunk: _Chunk, load: FloatArray, largest: FloatArray, fastest: FloatArray
    ) -> FloatArray:
        """Columns of a chunk; see `friction_columns`.

        Args:
            chunk: The chunk.
            load: Torque of the links. Shape (C, n).
            largest: Largest load in all recordings. Shape (n,).
            fastest: Largest speed in all recordings. Shape (n,).
        """
        samples = len(chunk.speed)
        coarse = np.arange(len(load)) / chunk.band.rate_of(Grid.COARSE)
        fine = np.arange(samples) / chunk.band.rate
        sign, share = np.tanh(chunk.speed / self.model.widths), np.abs(chunk.speed) / fastest
        carried = np.column_stack([np.interp(fine, coarse, column) for column in load.T])
        parts = [
            sign * np.abs(carried),
            sign * carried**2 / largest,
            sign * np.exp(-share / STRIBECK_SHARE),
            sign * np.sqrt(share),
        ]
        low = chunk.band.filter(np.hstack(parts), Grid.KEPT)[chunk.kept]
        return np.concatenate(
            [self._diagonal(part) for part in np.split(low, LOAD_SHAPES + SPEED_SHAPES, axis=1)],
            axis=2,
        )


def _largest(loads: Sequence[FloatArray]) -> FloatArray:
    """Largest absolute value of each joint. Shapes (C, n) -> (n,)."""
    return np.maximum(np.max([np.abs(load).max(axis=0) for load in loads], axis=0), 1e-9)


def build_payload_equations(
    model: IdentificationModel,
    place: PayloadPlace,
    carrying: Sequence[Sequence[RecordingSegment]],
    empty: Sequence[RecordingSegment],
    hertz: float,
) -> PayloadEquations:
    """Build the equations of all recordings.

    Args:
        model: Model of the robot.
        place: Where the payload is attached.
        carrying: Segments of each recording with payload.
        empty: Segments without.
        hertz: Cutoff frequency [Hz].

    Raises:
        UnusableInput: All segments are shorter than the margins that the filter discards.
    """
    together = [*(segment for group in carrying for segment in group), *empty]
    plain = build_equations(model, together, hertz)
    model = fit_widths(model, plain, together)
    link = np.arange(LINK_PARAMETERS) + LINK_PARAMETERS * place.body
    independent = np.asarray(model.base.independent)
    added = [column for column in link.tolist() if column not in set(independent.tolist())]
    columns = np.concatenate([independent, added]).astype(int)
    wide = dataclasses.replace(model, base=dataclasses.replace(model.base, independent=columns))
    order = {int(column): k for k, column in enumerate(columns)}
    groups = [*((i, segment) for i, group in enumerate(carrying) for segment in group)]
    groups += [(-1, segment) for segment in empty]
    # a joint may stand still throughout a segment: all are built together
    usable = [
        (owner, segment)
        for owner, segment in groups
        if any(True for _ in kept_rows(segment, segment.band(hertz)))
    ]
    equations = build_equations(wide, [segment for _, segment in usable], hertz)
    counts = [part.stop - part.start for part in equations.stretches()]
    chunks = [
        chunk for owner, segment in usable for chunk in _chunks(wide, segment, hertz, owner >= 0)
    ]
    return PayloadEquations(
        equations,
        len(independent),
        np.array([order[int(column)] for column in link]),
        wide,
        place,
        np.repeat([owner for owner, _ in usable], counts),
        tuple(chunks),
    )


def _chunks(
    model: IdentificationModel,
    segment: RecordingSegment,
    hertz: float,
    carries: bool,
) -> list[_Chunk]:
    """Chunks of a segment with the regressor of its links on the coarse grid."""
    edge = LINK_PARAMETERS * model.parameters.bodies
    band, out = segment.band(hertz), list[_Chunk]()
    for samples, kept in kept_rows(segment, band):
        part = dataclasses.replace(band, count=samples.stop - samples.start)
        q = segment.q[samples]
        position = part.transform(q)
        motion = Samples(
            *(position.filter(Grid.COARSE, order, MOTION_BANDWIDTH_RATIO) for order in range(3))
        )
        loads = regressor(model.robot, model.parameters, motion)[:, :, :edge]
        out.append(_Chunk(part, kept, loads, friction_speed(q, part, position), carries))
    return out
