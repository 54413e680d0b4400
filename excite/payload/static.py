"""Payload from poses at rest: the mean torques of rests with and without it.

At rest τ = G(q) θ + A(q) (m, m c) + o + s (F + μ |τ_L|): base parameters of the robot, mass and
first moments of the payload, offsets, and friction in the direction s of the arrival. Offsets and
friction may differ between recordings with and without payload. What this leaves, such as
friction at rest of another size, is the noise, independent between rests, with a variance for each
joint. The moments of inertia do not act at rest; theirs are the prior's.

An identified model may stand for the rests without payload: θ is then θ̂ + S z of its estimate θ̂
and the root S of its covariance, with z of unit variance, as all its errors at rest are those of
θ̂ and common to all rests.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._types import BoolArray, FloatArray
from ..designer.static_poses import GRAVITY_PARAMETERS, SETTLING_TIME
from ..errors import UnusableInput
from ..identification.identified_model import IdentifiedModel
from ..identification.regression import IdentificationModel
from ..recordings import Recording
from ..robot.dynamics import regressor
from ..robot.samples import Samples
from .equations import LINK_PARAMETERS, PayloadPlace
from .estimate import PayloadData, PayloadEstimate, physical_payload
from .shape import PayloadShape

WINDOW = 0.2
"""Time over which the range of positions decides whether the robot is at rest [s]."""
REST_RANGE = 2e-3
"""Largest range of a position within `WINDOW` at rest [rad or m]."""
QUANTIZATION_RANGE = 12.0
"""The same over the standard deviation of the quantisation error: between three and four steps."""
ARRIVAL_DISTANCE = 2.5
"""Distance from a pose at which the direction of the arrival is taken, over the largest range."""
SHORTEST_REST = 0.3
"""Shortest rest without its settling time [s]."""
FEWEST_RESTS = 3
"""Fewest poses that show mass and centre of mass."""
ITERATIONS = 4
"""Number of times that variances and the load in the friction are computed from the estimate."""
FEWEST_RESTS_FOR_LOAD = 10
"""Rests from which load friction is fitted: twice the columns of a joint, its offsets and frictions
with and without payload and load friction."""


@dataclass(frozen=True)
class Rests:
    """Rests of a recording.

    Attributes:
        source: Name of the recording.
        q: Mean positions. Shape (R, n) [rad or m].
        torque: Mean torques. Shape (R, n) [N m or N].
        arrival: Sign of the direction in which each joint arrived; 0: unknown. Shape (R, n).
    """

    source: str
    q: FloatArray
    torque: FloatArray
    arrival: FloatArray

    def __len__(self) -> int:
        return len(self.q)


def find_rests(recording: Recording) -> Rests:
    """Find the rests of a recording.

    Args:
        recording: The recording.

    Raises:
        UnusableInput: A joint has no torque.
    """
    torque = recording.torque
    tolerance = np.maximum(REST_RANGE, QUANTIZATION_RANGE * recording.quantization_noise)
    still = _is_still(recording, tolerance)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    q, mean, arrival = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for begin, end in edges.reshape(-1, 2):
        first = int(np.searchsorted(recording.t, recording.t[begin] + SETTLING_TIME))
        if first >= end or recording.t[end - 1] - recording.t[first] < SHORTEST_REST:
            continue
        rows = slice(first, end)
        if not np.isfinite(torque[rows]).all():
            continue
        q.append(recording.q[rows].mean(axis=0))
        mean.append(torque[rows].mean(axis=0))
        arrival.append(_arrival(recording.q[:begin], q[-1], ARRIVAL_DISTANCE * tolerance))
    shape = (-1, len(recording.joints))
    return Rests(recording.source, *(np.array(rows).reshape(shape) for rows in (q, mean, arrival)))


def _is_still(recording: Recording, tolerance: FloatArray) -> BoolArray:
    """True for rows at which all joints rest, within a window about them. Shape (N,)."""
    from scipy import ndimage  # slow to import

    size = max(2, round(WINDOW / recording.step)) | 1
    spread = ndimage.maximum_filter1d(recording.q, size, axis=0) - ndimage.minimum_filter1d(
        recording.q, size, axis=0
    )
    is_gap = np.append(np.diff(recording.t) > 2.0 * recording.step, False)
    return np.asarray((spread <= tolerance).all(axis=1) & ~is_gap)


def _arrival(before: FloatArray, pose: FloatArray, distance: FloatArray) -> FloatArray:
    """Direction in which each joint arrived at a pose, by the rows before. Shape (n,)."""
    out = np.zeros(len(pose))
    for j in range(len(pose)):
        away = np.flatnonzero(np.abs(before[:, j] - pose[j]) > distance[j])
        if len(away):
            out[j] = np.sign(pose[j] - before[away[-1], j])
    return out


@dataclass(frozen=True)
class _StaticRows:
    """Equations of all rests.

    Attributes:
        torque: Mean torques. Shape (R, n).
        predicted: Torque of an identified model, 0 without one. Shape (R, n).
        robot: Columns of the base parameters, or of z. Shape (R, n, p).
        robot_is_known: True if `robot` are the columns of z, of unit variance.
        payload: Columns of mass and first moments in the link's frame, also without payload. Shape
            (R, n, 4).
        arrival: Directions of the arrivals. Shape (R, n).
        recording: Index of the recording with payload; -1 without. Shape (R,).
    """

    torque: FloatArray
    predicted: FloatArray
    robot: FloatArray
    robot_is_known: bool
    payload: FloatArray
    arrival: FloatArray
    recording: FloatArray

    @property
    def carries(self) -> BoolArray:
        """True for rests with the payload. Shape (R,)."""
        return np.asarray(self.recording >= 0)

    @property
    def known(self) -> BoolArray:
        """True for the columns of `nuisance` with coefficients of unit variance. Shape (p,)."""
        return np.full(self.robot.shape[2], self.robot_is_known)

    def payload_columns(self, recording: int | None = None) -> FloatArray:
        """Return the columns of the payload, 0 without it, or of one recording alone."""
        inside = self.carries if recording is None else self.recording == recording
        return np.where(inside[:, None, None], self.payload, 0.0)

    def nuisance(self, load: FloatArray | None) -> FloatArray:
        """Return the columns of the robot, of offsets and of friction. Shape (R, n, k).

        Args:
            load: Torque of the links, of which friction grows. Shape (R, n); None: not fitted.
        """
        carries = self.carries[:, None] * np.ones_like(self.torque)
        parts = [carries, self.arrival, self.arrival * carries]
        if load is not None:
            parts.append(self.arrival * np.abs(load))
        return np.concatenate([self.robot, *(_diagonal(part) for part in parts)], axis=2)


def _diagonal(columns: FloatArray) -> FloatArray:
    """A column of each joint that acts on it alone. Shape (R, n) -> (R, n, n)."""
    return np.asarray(columns[:, :, None] * np.eye(columns.shape[1]))


def estimate_static_payload(
    model: IdentificationModel,
    place: PayloadPlace,
    carrying: Sequence[Rests],
    empty: Sequence[Rests],
    shape: PayloadShape | None = None,
    mass: float | None = None,
    identified: IdentifiedModel | None = None,
) -> PayloadEstimate:
    """Estimate a payload from rests.

    Args:
        model: Model of the robot.
        place: Where the payload is attached.
        carrying: Rests with the payload, by recording.
        empty: Rests without it.
        shape: Its shape; None: unknown.
        mass: Its mass, if it was weighed [kg].
        identified: Identified robot without the payload, in addition to `empty` or in their place;
            exact if its file states no covariance.

    Raises:
        UnusableInput: There are too few rests.
    """
    for group, word in ((carrying, "with"), (empty, "without")):
        if group is empty and identified is not None:
            continue
        if sum(len(rests) for rests in group) < FEWEST_RESTS:
            raise UnusableInput(
                f"{group[0].source}: has fewer than {FEWEST_RESTS} poses at rest {word} the "
                f"payload, of {SETTLING_TIME + SHORTEST_REST:.2g} s or longer; record the motion "
                "of 'excite design --for-payload LINK --static'"
            )
    rows = _rows(model, place, carrying, empty, identified)
    n = rows.torque.shape[1]
    deviation, load = np.ones(n), None
    fits_load = len(rows.torque) >= FEWEST_RESTS_FOR_LOAD
    for _ in range(ITERATIONS):
        fit = _fit(rows.torque, rows.payload_columns(), rows.nuisance(load), deviation, rows.known)
        deviation = fit.deviation
        if fits_load:
            load = (
                rows.predicted
                + rows.robot @ fit.nuisance[: rows.robot.shape[2]]
                + rows.payload_columns() @ fit.theta
            )
    fit = _fit(rows.torque, rows.payload_columns(), rows.nuisance(load), deviation, rows.known)
    information = np.zeros((LINK_PARAMETERS, LINK_PARAMETERS))
    information[:GRAVITY_PARAMETERS, :GRAVITY_PARAMETERS] = fit.information
    theta = np.append(fit.theta, np.zeros(LINK_PARAMETERS - GRAVITY_PARAMETERS))
    body = physical_payload(PayloadData(theta, information, fit.freedom), shape, mass)
    return dataclasses.replace(
        body,
        load_friction=None if load is None else fit.nuisance[-n:],
        residual=np.asarray(np.sqrt(np.mean(fit.residual**2, axis=0)), float),
        mounting=_mounting_p_value(rows, load, deviation, len(carrying)),
    )


def _rows(
    model: IdentificationModel,
    place: PayloadPlace,
    carrying: Sequence[Rests],
    empty: Sequence[Rests],
    identified: IdentifiedModel | None,
) -> _StaticRows:
    """Build the equations of all rests; their torque is that beyond an identified model."""
    together = [*carrying, *empty]
    q = np.concatenate([rests.q for rests in together])
    zero = np.zeros_like(q)
    motion = Samples(q, zero, zero)
    Y = regressor(model.robot, model.parameters, motion)
    start = LINK_PARAMETERS * place.body
    payload = Y[:, :, start : start + LINK_PARAMETERS] @ place.frame
    owners = [np.full(len(rests), float(k)) for k, rests in enumerate(carrying)]
    owners += [np.full(len(rests), -1.0) for rests in empty]
    robot, predicted = Y[:, :, np.asarray(model.base.independent)], zero
    if identified is not None:
        predicted, stated = identified.torque(motion, zero), identified.base_covariance
        robot = Y[:, :, :0]
        if stated is not None:
            of_model = regressor(identified.robot, identified.layout, motion)
            robot = of_model[:, :, stated.columns] @ stated.root
    return _StaticRows(
        np.concatenate([rests.torque for rests in together]) - predicted,
        predicted,
        robot,
        identified is not None,
        payload[:, :, :GRAVITY_PARAMETERS],
        np.concatenate([rests.arrival for rests in together]),
        np.concatenate(owners),
    )


@dataclass(frozen=True)
class _Fit:
    """Weighted least squares with nuisance columns integrated out.

    Attributes:
        theta: Parameters, 0 in directions that the data do not show. Shape (p,).
        information: Inverse of their covariance. Shape (p, p).
        nuisance: Coefficients of the nuisance columns, of least norm. Shape (k,).
        residual: Remaining torque. Shape (R, n).
        deviation: Its standard deviation by joint. Shape (n,).
        freedom: Degrees of freedom of the least of the variances of the joints: one joint may
            decide a quantity (the lower bound of Welch and Satterthwaite's).
    """

    theta: FloatArray
    information: FloatArray
    nuisance: FloatArray
    residual: FloatArray
    deviation: FloatArray
    freedom: float


RANK_TOLERANCE = 1e-9
"""Relative singular value below which a direction counts as not shown."""


def _fit(
    torque: FloatArray,
    columns: FloatArray,
    others: FloatArray,
    deviation: FloatArray,
    known: BoolArray,
) -> _Fit:
    """Fit the torque by columns of interest and nuisance columns, weighted by 1/deviation².

    Args:
        torque: Shape (R, n).
        columns: Columns of the parameters. Shape (R, n, p).
        others: Nuisance columns. Shape (R, n, k).
        deviation: Standard deviations. Shape (n,).
        known: True for nuisance columns whose coefficients are 0 ± 1, of the first p. Shape (p,).
    """
    weighted = [x / deviation[:, None] for x in (columns, others)]
    prior = np.eye(others.shape[2])[np.flatnonzero(known)]
    A, B = (
        np.vstack([x.reshape(-1, x.shape[2]), below])
        for x, below in zip(
            weighted, (np.zeros((len(prior), columns.shape[2])), prior), strict=True
        )
    )
    y = np.append(torque / deviation, np.zeros(len(prior)))
    basis = _range(B)
    free = A - basis @ (basis.T @ A)
    size = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    theta = np.linalg.lstsq(free / size, y - basis @ (basis.T @ y), rcond=RANK_TOLERANCE)[0] / size
    nuisance = np.linalg.lstsq(B, y - A @ theta, rcond=RANK_TOLERANCE)[0]
    residual = torque - columns @ theta - others @ nuisance
    hat = np.concatenate([basis, _range(free, size)], axis=1)
    leverage = np.sum(hat[: torque.size].reshape(*torque.shape, -1) ** 2, axis=(0, 2))
    freedom = np.maximum(len(torque) - leverage, 1.0)
    return _Fit(
        theta,
        free.T @ free,
        nuisance,
        residual,
        np.sqrt(np.maximum(np.sum(residual**2, axis=0) / freedom, 1e-300)),
        float(freedom.min()),
    )


def _range(columns: FloatArray, size: FloatArray | None = None) -> FloatArray:
    """Return an orthonormal basis of the range of columns. Shape (m, r)."""
    norms = np.linalg.norm(columns, axis=0) if size is None else size
    scaled = columns[:, norms > 0.0] / norms[norms > 0.0]
    if not scaled.shape[1]:
        return np.zeros((len(columns), 0))
    U, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(U[:, s > RANK_TOLERANCE * max(float(s[0]), 1.0)])


def _mounting_p_value(
    rows: _StaticRows, load: FloatArray | None, deviation: FloatArray, count: int
) -> float | None:
    """p-value of the same payload in all recordings (Wald); None for one recording."""
    from scipy import stats  # slow to import

    if count < 2:
        return None
    differences = np.concatenate([rows.payload_columns(k) for k in range(1, count)], axis=2)
    common = rows.payload_columns()
    nuisance = np.concatenate([common, rows.nuisance(load)], axis=2)
    known = np.append(np.zeros(common.shape[2], bool), rows.known)
    fit = _fit(rows.torque, differences, nuisance, deviation, known)
    statistic = float(fit.theta @ fit.information @ fit.theta)
    return float(stats.chi2.sf(statistic, len(fit.theta)))
