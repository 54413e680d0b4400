"""Objective and constraints of a design problem, with exact derivatives.

An evaluation takes one pass of the regressor, dense linear algebra, and one reverse sweep.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .._types import BoolArray, FloatArray, IntArray
from ..collision.clearance_constraint import ClearanceEvaluation
from ..robot.inertial_parameters import Parameters
from . import casadi_model, criteria
from .casadi_batch import MappedFunction, PaddedFunction
from .constraint_margins import STAND
from .design_objective import SampledMotion
from .options import DesignOptions
from .problem import DesignProblem
from .stand_load import LOADS, load_function

DERIVATIVES = ("velocity", "acceleration", "jerk")
"""Kinds of limits of the derivatives of order 1 to 3."""

BOX = "box"
"""Name of the boxes among the kinds of constraints: three axes for each of them."""

NEARLY_ACTIVE = 0.98
"""Constraint value from which a constraint is named as one that leaves no room [1]."""

UNEXCITED_RATIO = 1e-20
"""Ratio of an eigenvalue of the information to the largest one below which its direction is named
as one that a motion does not show [1]."""


@dataclass(frozen=True)
class ConstraintRows:
    """Selected constraints g ≤ 1, each a quantity over its limit.

    Attributes:
        kind: Index into the `kinds` of the evaluator. Shape (m,).
        sample: Index of the sample. Shape (m,).
        joint: Index of the joint, axis or pair of bodies. Shape (m,).
        sign: Sign of the quantity, 1 or −1. Shape (m,).
    """

    kind: IntArray
    sample: IntArray
    joint: IntArray
    sign: FloatArray

    def __len__(self) -> int:
        return len(self.kind)

    def subset(self, chosen: IntArray) -> ConstraintRows:
        """Return some of the constraints. Shape of `chosen`: (k,)."""
        return ConstraintRows(
            self.kind[chosen], self.sample[chosen], self.joint[chosen], self.sign[chosen]
        )


class SearchProblem(Protocol):
    """Problem whose motion `sqp` searches."""

    @property
    def options(self) -> DesignOptions:
        """Options of the design."""
        ...

    @property
    def stopping_gain(self) -> float:
        """Decrease of the objective over ten iterations below which a search ends."""
        ...


class ConstrainedObjective(ABC):
    """Objective and constraints of a motion, with exact derivatives, as `sqp` needs them.

    Attributes:
        problem: The problem that is evaluated.
        kinds: Names of the kinds of constraints that it has.
    """

    problem: SearchProblem
    kinds: tuple[str, ...]

    @abstractmethod
    def objective(self, x: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
        """Evaluate the objective to be minimised, and its exact gradient.

        Args:
            x: Variables. Shape (size,).
            sharpness: Sharpness of the smoothed extreme eigenvalues [1].

        Returns:
            The objective, and its gradient. Shape (size,).
        """

    @abstractmethod
    def constraint_values(self, x: FloatArray) -> dict[str, FloatArray]:
        """Return the values of all constraints; the motion is feasible where they are at most 1.

        Returns:
            For each of `kinds`, in their order, an array of shape (signs, samples, joints).
        """

    @abstractmethod
    def row_gradients(self, x: FloatArray, rows: ConstraintRows) -> FloatArray:
        """Return the exact Jacobian of selected constraints. Shape (m, size)."""

    def max_constraint_value(self, x: FloatArray) -> float:
        """Return the largest value of all constraints; at most 1 where the samples are feasible."""
        return max(float(values.max()) for values in self.constraint_values(x).values())

    def rows_above(self, x: FloatArray, threshold: float) -> BoolArray:
        """Return the flat mask of the constraints above a threshold, in the order of `kinds`."""
        return np.concatenate(
            [(values > threshold).ravel() for values in self.constraint_values(x).values()]
        )

    def rows(self, x: FloatArray, mask: BoolArray) -> ConstraintRows:
        """Return the constraints that a flat mask selects."""
        parts, start = [], 0
        for number, values in enumerate(self.constraint_values(x).values()):
            chosen = np.flatnonzero(mask[start : start + values.size])
            start += values.size
            sign, sample, joint = np.unravel_index(chosen, values.shape)
            parts.append((np.full(len(chosen), number), sample, joint, 1.0 - 2.0 * sign))
        return ConstraintRows(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def row_values(self, x: FloatArray, rows: ConstraintRows) -> FloatArray:
        """Return the values of selected constraints. Shape (m,)."""
        out = np.empty(len(rows))
        for number, values in enumerate(self.constraint_values(x).values()):
            at = rows.kind == number
            out[at] = values[(rows.sign[at] < 0).astype(int), rows.sample[at], rows.joint[at]]
        return out


@dataclass
class _Point:
    """Intermediate results at one value of the variables; computed on demand."""

    x: FloatArray
    motion: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
    Y: FloatArray | None = None
    constraint_values: dict[str, FloatArray] = field(default_factory=dict)
    spread: tuple[FloatArray, FloatArray] | None = None
    clearances: ClearanceEvaluation | None = None


class Evaluator(ConstrainedObjective):
    """Evaluate a design problem; the results of the last variables are kept.

    Attributes:
        problem: The design problem.
        bases: Factors of the coefficients at the samples, for derivatives of order 0 to 3.
        kinds: Names of the kinds of constraints that this problem has.
    """

    problem: DesignProblem

    def __init__(self, problem: DesignProblem) -> None:
        self.problem = problem
        self.bases = problem.bases()
        functions, count = problem.functions, problem.options.samples
        self._regressor = MappedFunction(functions.regressor, count, functions.library)
        self._adjoint = MappedFunction(functions.adjoint, count, functions.library)
        self._row = PaddedFunction(functions.row, functions.library)
        stand = problem.limits.stand
        self._stand = None if stand is None else load_function(problem.robot, stand)
        self._frames = [
            casadi_model.frame_position(problem.robot, box.frame) for box in problem.boxes
        ]
        self._torque_bound = without_friction(problem.limits.torque, problem.parameters)
        self._nominal = _without_coulomb(problem.parameters)
        self._inverse_metric = problem.parameters.scale @ problem.parameters.scale.T
        self._point: _Point | None = None
        self.kinds = self._kinds()

    def _kinds(self) -> tuple[str, ...]:
        """Return the kinds of constraints that the problem has."""
        limits = self.problem.limits
        kinds = [
            k for k in ("position", *DERIVATIVES, "torque") if np.isfinite(getattr(limits, k)).any()
        ]
        kinds += ["braking"] * any(b is not None for b in limits.braking)
        kinds += [STAND] * (limits.stand is not None)
        kinds += ["clearance"] * (self.problem.clearance is not None)
        kinds += [BOX] * bool(self.problem.boxes)
        return tuple(kinds)

    def _stretch(self, x: FloatArray, order: int) -> float:
        """Return the factor on the columns of a and b, as derivatives scale with T^(1−order)."""
        return float((self.problem.period(x) / self.problem.options.period) ** (1 - order))

    def _basis(self, x: FloatArray, order: int) -> FloatArray:
        """Return the factors of the coefficients at the period of `x`."""
        stretch = self._stretch(x, order)
        if stretch == 1.0:
            return self.bases[order]
        out = self.bases[order] * stretch
        out[:, -1] = self.bases[order][:, -1]
        return out

    def _at(self, x: FloatArray) -> _Point:
        """Return the point of `x`, which is kept until the next one."""
        if self._point is None or not np.array_equal(self._point.x, x):
            p = self.problem
            table = x[: p.scale.size].reshape(p.scale.shape) * p.scale
            q, dq, ddq, dddq = (self._basis(x, order) @ table.T for order in range(4))
            self._point = _Point(x.copy(), (q, dq, ddq, dddq))
        return self._point

    def _regressor_at(self, point: _Point) -> FloatArray:
        """Return the regressor along the motion. Shape (N, n, P)."""
        if point.Y is None:
            q = point.motion[0]
            point.Y = self._regressor(*point.motion[:3])[0].reshape(*q.shape, -1)
        return point.Y

    def objective(self, x: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
        """Evaluate the objective and its gradient; see `ConstrainedObjective`."""
        point, problem = self._at(x), self.problem
        Y, weights = self._regressor_at(point), problem.weighting
        if problem.objective is not None:
            motion = SampledMotion(*point.motion[:3], Y, problem.period(x))
            result = problem.objective.evaluate(motion)
            value, gradients = result.value, self._adjoint(*point.motion[:3], result.by_regressor)
            if result.by_motion is not None:
                gradients = [a + b for a, b in zip(gradients, result.by_motion, strict=True)]
        else:
            rows = weights.rows(Y)
            known = problem.earlier_root
            stacked = rows if known is None else np.vstack([rows, known])
            value, slope = criteria.smooth_objective(problem.options.criterion, stacked, sharpness)
            gradients = self._adjoint(*point.motion[:3], weights.regressor_gradient(Y, slope))
        if problem.overlap_penalty is not None:
            overlap, by_q, by_dq = problem.overlap_penalty.overlap(*point.motion[:2])
            weight = problem.overlap_penalty.weight
            value += weight * overlap
            gradients = [
                gradients[0] + weight * by_q,
                gradients[1] + weight * by_dq,
                *gradients[2:],
            ]
        return value, self._pull_back(x, point, gradients)

    def spectrum_ratio(self, x: FloatArray) -> float:
        """Return the least over the largest eigenvalue of the information of a motion [1].

        Shape of `x`: (size,).
        """
        point, problem = self._at(x), self.problem
        rows = problem.weighting.rows(self._regressor_at(point))
        stacked = rows if problem.earlier_root is None else np.vstack([rows, problem.earlier_root])
        values = criteria.information_eigenvalues(stacked)
        return float(values[0] / values[-1]) if values[-1] > 0.0 else 0.0

    def _pull_back(self, x: FloatArray, point: _Point, gradients: list[FloatArray]) -> FloatArray:
        """Return the gradient by the variables from the gradients by q, q̇ and q̈."""
        p = self.problem
        table = np.zeros(p.scale.shape)
        for order, gradient in enumerate(gradients):
            table += gradient.T @ self._basis(x, order)
        out: FloatArray = (table * p.scale).ravel()
        if p.options.free_period is not None:
            slope = sum(
                float(np.sum(g * self._period_slope(x, point, order)))
                for order, g in enumerate(gradients)
            )
            out = np.append(out, slope)
        return out

    def _period_slope(self, x: FloatArray, point: _Point, order: int) -> FloatArray:
        """Return the derivative of a motion array by the last variable, the relative period."""
        p = self.problem
        array = point.motion[order]
        if order == 0:
            array = array - x[: p.scale.size].reshape(p.scale.shape)[:, -1] * p.scale[:, -1]
        return (1 - order) * array / x[-1]

    def constraint_values(self, x: FloatArray) -> dict[str, FloatArray]:
        """Return the values of all constraints; the motion is feasible where they are at most 1.

        Returns:
            For each kind an array of shape (2, N, n), first for the sign +, then −; (2, N, 3B) for
            B boxes, (1, N, 2) for the load on the stand and (1, N, pairs) for the clearance.
        """
        point = self._at(x)
        if not point.constraint_values:
            for kind in self.kinds:
                point.constraint_values[kind] = self._values(point, kind)
        return point.constraint_values

    def static_constraint_values(self, poses: FloatArray) -> dict[str, FloatArray]:
        """Return the values of all constraints for robots at rest, one pose per sample.

        Args:
            poses: Poses. Shape (N, n) with N the samples of the problem.

        Returns:
            As `constraint_values`.
        """
        self._point = None  # this call overwrites the memory of its regressor
        still = np.zeros_like(poses)
        point = _Point(np.empty(0), (poses, still, still, still))
        return {kind: self._values(point, kind) for kind in self.kinds}

    def _values(self, point: _Point, kind: str) -> FloatArray:
        """Return the values of the constraints of one kind."""
        limits, q = self.problem.limits, point.motion[0]
        if kind in ("position", BOX):
            values = q if kind == "position" else self._frame_positions(q)
            return centred(values, *self._range(kind))
        if kind in DERIVATIVES:
            ratio = point.motion[1 + DERIVATIVES.index(kind)] / getattr(limits, kind)
            return np.stack([ratio, -ratio])
        if kind == "torque":
            nominal, width = self._band(point)
            return np.stack([nominal + width, width - nominal]) / self._torque_bound
        if kind == "braking":
            return np.stack([self._braking(q, point.motion[1], sign)[0] for sign in (1.0, -1.0)])
        if kind == STAND:
            return self._stand_loads(*point.motion[:3])[0][None]
        return self._clearances(point).constraint_values()[None]

    def _range(self, kind: str) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper bounds of the positions of joints, or of the frames in boxes."""
        if kind == "position":
            return self.problem.limits.position[:, 0], self.problem.limits.position[:, 1]
        corners = np.array([(box.lower, box.upper) for box in self.problem.boxes])
        return corners[:, 0].ravel(), corners[:, 1].ravel()

    def _frame_positions(self, q: FloatArray) -> FloatArray:
        """Return the positions of the frames that have boxes. Shape (N, 3B) [m]."""
        return np.hstack([np.asarray(frame.map(len(q))(q.T)[0]).T for frame in self._frames])

    def _frame_jacobians(self, q: FloatArray) -> FloatArray:
        """Return their Jacobians. Shape (3B, N, n)."""
        parts = [np.asarray(frame.map(len(q))(q.T)[1]) for frame in self._frames]
        return np.vstack(parts).reshape(-1, *q.shape)

    def _band(self, point: _Point) -> tuple[FloatArray, FloatArray]:
        """Return nominal torque and half width of its band over all uncertain robots."""
        if point.spread is None:
            p = self.problem
            Y = self._regressor_at(point)
            nominal = Y @ self._nominal
            width = np.zeros_like(nominal)
            if p.options.uncertainty:
                width = np.sqrt(p.parameters.norms(Y.reshape(-1, Y.shape[2])) + 1e-18).reshape(
                    nominal.shape
                )
            point.spread = nominal, width
        return point.spread[0], self.problem.options.uncertainty * point.spread[1]

    def _stand_loads(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Return the loads on the stand over their limits, and their gradients.

        Returns:
            Loads, shape (N, 2), and gradients by q, q̇ and q̈, shape (N, 2, n) each.
        """
        assert self._stand is not None
        loads, *gradients = self._stand.map(len(q))(q.T, dq.T, ddq.T)
        shape = (len(LOADS), len(q), q.shape[1])
        return np.asarray(loads).T, [
            np.asarray(g).reshape(shape).transpose(1, 0, 2) for g in gradients
        ]

    def _clearances(self, point: _Point) -> ClearanceEvaluation:
        assert self.problem.clearance is not None
        if point.clearances is None:
            point.clearances = self.problem.clearance.evaluate(point.motion[0])
        return point.clearances

    def _braking(
        self, q: FloatArray, dq: FloatArray, sign: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Evaluate (s q̇ + c)₊²/rate + s q ≤ s·stop over the half range, and slopes."""
        value, by_q, by_dq = np.full_like(q, -np.inf), np.zeros_like(q), np.zeros_like(q)
        for j, brake in enumerate(self.problem.limits.braking):
            if brake is None:
                continue
            middle, half = 0.5 * sum(brake.stop), 0.5 * (brake.stop[1] - brake.stop[0])
            over = np.maximum(sign * dq[:, j] + brake.offset, 0.0)
            value[:, j] = (over**2 / brake.rate + sign * (q[:, j] - middle)) / half
            by_q[:, j], by_dq[:, j] = sign / half, 2.0 * sign * over / brake.rate / half
        return value, by_q, by_dq

    def active_constraints(self, x: FloatArray, count: int = 2) -> list[str]:
        """Name the constraints that are violated or all but active, the worst first.

        Args:
            x: Variables. Shape (size,).
            count: Number of names at most.
        """
        worst: list[tuple[float, str]] = []
        for kind, values in self.constraint_values(x).items():
            largest = values.max(axis=(0, 1))
            worst += [
                (float(largest[index]), self._constraint_name(kind, int(index)))
                for index in np.flatnonzero(largest > NEARLY_ACTIVE)
            ]
        return [name for _, name in sorted(worst, reverse=True)[:count]]

    def _constraint_name(self, kind: str, index: int) -> str:
        """Return the name of a constraint: of its pair of bodies, its frame or its joint."""
        problem = self.problem
        if kind == STAND:
            return f"the {LOADS[index]} of [stand]"
        if kind == "clearance":
            assert problem.clearance is not None
            return f"the clearance of {problem.clearance.names[index]}"
        if kind == BOX:
            return f"the box of '{problem.boxes[index // 3].frame}'"
        return f"the {kind} limit of '{problem.robot.joints[index]}'"

    def unexcited_parameters(self, x: FloatArray, count: int = 3) -> list[str]:
        """Name the parameters that a motion shows least.

        Args:
            x: Variables. Shape (size,).
            count: Number of names at most.

        Returns:
            Names, the one with the largest share of unexcited directions first.
        """
        rows = self.problem.weighting.rows(self._regressor_at(self._at(x)))
        _, singular, right = np.linalg.svd(np.linalg.qr(rows, mode="r"))
        hidden = singular**2 < UNEXCITED_RATIO * singular[0] ** 2
        hidden[-1] = True
        share = np.linalg.norm(right[hidden] @ self.problem.weighting.columns.T, axis=0)
        order = np.argsort(-share)
        names = self.problem.parameters.names
        return [names[i] for i in order[:count]]

    def row_gradients(self, x: FloatArray, rows: ConstraintRows) -> FloatArray:
        """Return the exact Jacobian of selected constraints. Shape (m, size)."""
        point, p = self._at(x), self.problem
        n, width = p.scale.shape
        out = np.zeros((len(rows), n, width))
        period = np.zeros(len(rows))
        for number, kind in enumerate(self.kinds):
            at = np.flatnonzero(rows.kind == number)
            if len(at) == 0:
                continue
            sample, joint, sign = rows.sample[at], rows.joint[at], rows.sign[at]
            for order, slope in self._slopes(point, kind, sample, joint, sign):
                # slope: derivative by the motion array, of all joints (m, n) or its own joint (m,)
                factor = self._basis(x, order)[sample]
                if slope.ndim == 1:
                    out[at, joint] += slope[:, None] * factor
                else:
                    out[at] += slope[:, :, None] * factor[:, None, :]
                if p.options.free_period is not None:
                    change = self._period_slope(x, point, order)[sample]
                    period[at] += (
                        slope * change[np.arange(len(at)), joint]
                        if slope.ndim == 1
                        else np.sum(slope * change, axis=1)
                    )
        jacobian: FloatArray = (out * p.scale).reshape(len(rows), p.scale.size)
        return (
            np.column_stack([jacobian, period]) if p.options.free_period is not None else jacobian
        )

    def _slopes(
        self, point: _Point, kind: str, sample: IntArray, joint: IntArray, sign: FloatArray
    ) -> list[tuple[int, FloatArray]]:
        """Return (order, slope by the motion array of that order) of constraints of one kind."""
        limits = self.problem.limits
        each = np.arange(len(sample))
        if kind in ("position", BOX):
            lower, upper = self._range(kind)
            slope = sign / (0.5 * (upper - lower))[joint]
            if kind == BOX:
                jacobian = self._frame_jacobians(point.motion[0][sample])
                slope = slope[:, None] * jacobian[joint, each]
            return [(0, slope)]
        if kind in DERIVATIVES:
            return [(1 + DERIVATIVES.index(kind), sign / getattr(limits, kind)[joint])]
        if kind == "torque":
            return self._torque_slopes(point, sample, joint, sign)
        if kind == "braking":
            both = [self._braking(point.motion[0], point.motion[1], s) for s in (1.0, -1.0)]
            pick = (sign < 0).astype(int)
            return [
                (order, np.stack([b[order + 1] for b in both])[pick, sample, joint])
                for order in (0, 1)
            ]
        if kind == STAND:
            _, gradients = self._stand_loads(*(array[sample] for array in point.motion[:3]))
            return [(order, gradient[each, joint]) for order, gradient in enumerate(gradients)]
        return [(0, self._clearances(point).gradients(sample, joint))]

    def _torque_slopes(
        self, point: _Point, sample: IntArray, joint: IntArray, sign: FloatArray
    ) -> list[tuple[int, FloatArray]]:
        """Return the slopes of torque constraints by one weighted reverse sweep for each.

        d(±Y_jψ₀ + r|Y_j|_G⁻¹) = dY_j · (±ψ₀ + r G₀⁻¹Y_jᵀ/|Y_j|)
        """
        p = self.problem
        n, radius = p.robot.n, p.options.uncertainty
        q, dq, ddq, _ = point.motion
        Y = self._regressor_at(point)[sample, joint]
        weight = sign[:, None] * self._nominal
        if radius:
            self._band(point)
            assert point.spread is not None
            weight = (
                weight
                + radius * (Y @ self._inverse_metric) / point.spread[1][sample, joint][:, None]
            )
        pick = np.zeros((len(sample), n))
        pick[np.arange(len(sample)), joint] = 1.0 / self._torque_bound[joint]
        return list(enumerate(self._row(q[sample], dq[sample], ddq[sample], weight, pick)))


def without_friction(torque: FloatArray, parameters: Parameters) -> FloatArray:
    """Return torque limits less Coulomb friction. Shape (n,) [N m].

    Coulomb friction jumps between two samples wherever the velocity changes its sign. It is
    therefore assumed to act against the actuator at all times: it is left out of the nominal torque
    and subtracted from the limit, of which a thousandth remains.
    """
    return np.maximum(torque - parameters.coulomb(), 1e-3 * torque)


def _without_coulomb(parameters: Parameters) -> FloatArray:
    """Return the nominal parameters without Coulomb friction. Shape (P,)."""
    nominal = parameters.nominal.copy()
    if "coulomb" in parameters.drive:
        nominal[parameters.block("coulomb")] = 0.0
    return nominal


def centred(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return ±(distance from the middle of a range) over its half width; −inf where unbounded."""
    bounded = np.isfinite(lower) & np.isfinite(upper)
    middle = np.where(
        bounded, 0.5 * (np.where(bounded, lower, 0.0) + np.where(bounded, upper, 0.0)), 0.0
    )
    half = np.where(
        bounded, 0.5 * (np.where(bounded, upper, 0.0) - np.where(bounded, lower, 0.0)), 1.0
    )
    ratio = (values - middle) / half
    return np.where(bounded, np.stack([ratio, -ratio]), -np.inf)
