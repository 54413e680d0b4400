"""Objective and constraints of a motion in single or double support, with exact derivatives.

The joints of the support legs are an implicit function of the base coordinates. With the chain
equations C = (c, ċ, c̈) of the base y = (b, ḃ, b̈) and the leg z = (l, l̇, l̈), a gradient g by z
adds −(C_z⁻¹ C_y)ᵀ g to the gradient by y (implicit function theorem).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .._types import FloatArray, IntArray
from ..collision.clearance_constraint import ClearanceEvaluation
from . import criteria
from .casadi_batch import MappedFunction, PaddedFunction
from .evaluator import ConstrainedObjective, ConstraintRows, centred
from .support_model import BODY_STATE, WRENCH_SIZE, LegFunctions
from .support_problem import SupportProblem, motion_duration
from .support_stance import BASE_COORDINATES, MAX_CLOSURE_ERROR, MAX_NEWTON_STEP

NEWTON_ITERATIONS = 12
"""Iterations of Newton's method for a leg at most [1]: it begins at a solution nearby."""

CLOSURE_TOLERANCE = 1e-12
"""Error of a foot's pose at which Newton's method ends [m and rad]."""

CLEARANCE_STRIDE = 3
"""Samples of the constraints for each sample of the distances [1]: these vary with the motion, not
with its second derivative, and the certificate has every distance in between."""

INFORMATION_STRIDE = 2
"""Samples of the constraints for each sample of the information [1]: forces between samples exceed
their limits, while a sum over samples converges fast."""


@dataclass
class _Point:
    """Intermediate results at one value of the variables; computed on demand.

    Attributes:
        x: Variables.
        motion: Positions, velocities and accelerations of (b, q). Shape (N, 6 + n) each.
        slopes: For each leg ∂z/∂y. Shape (N, 18, 18).
        is_reachable: Whether all feet can be reached at all samples.
        states: States of the bodies. Shape (N, n + 1, BODY_STATE).
        clearances: Distances of the bodies.
        constraint_values: Values of the constraints.
    """

    x: FloatArray
    motion: tuple[FloatArray, FloatArray, FloatArray]
    slopes: list[FloatArray]
    is_reachable: bool
    states: FloatArray | None = None
    clearances: ClearanceEvaluation | None = None
    constraint_values: dict[str, FloatArray] = field(default_factory=dict)


class _Leg:
    """Closed chain of one support leg at all samples; it remembers the last solution."""

    def __init__(self, problem: SupportProblem, functions: LegFunctions) -> None:
        count, library = problem.options.samples, problem.functions.library
        self.joints = functions.joints
        self._closure = MappedFunction(functions.closure, count, library)
        self._rates = MappedFunction(functions.rates, count, library)
        self._jets = MappedFunction(functions.jets, count, library)
        self._last = np.tile(problem.stance.pose[self.joints], (count, 1))

    def solve(
        self, b: FloatArray, db: FloatArray, ddb: FloatArray
    ) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray, bool]:
        """Return the motion of the leg, its derivative ∂z/∂y and whether it is reachable.

        Args:
            b: Base coordinates. Shape (N, 6).
            db: Their velocities. Shape (N, 6).
            ddb: Their accelerations. Shape (N, 6).
        """
        leg, error = self._last.copy(), np.inf
        for _ in range(NEWTON_ITERATIONS):
            values, by_leg, _ = self._closure(b, leg)
            error = float(np.abs(values).max())
            if error < CLOSURE_TOLERANCE:
                break
            step = -_solve(by_leg, values)
            longest = np.abs(step).max(axis=1, keepdims=True)
            leg += step * np.minimum(1.0, MAX_NEWTON_STEP / np.maximum(longest, 1e-12))
        is_reachable = error < MAX_CLOSURE_ERROR
        if is_reachable:
            self._last = leg
        by_leg = self._closure(b, leg)[1].copy()
        still = np.zeros_like(leg)
        dleg = -_solve(by_leg, self._rates(b, db, ddb, leg, still)[0])
        ddleg = -_solve(by_leg, self._rates(b, db, ddb, leg, dleg)[1])
        by_y, by_z = self._jets(b, db, ddb, leg, dleg, ddleg)
        return (leg, dleg, ddleg), -_solve_matrix(by_z, by_y), is_reachable


class SupportEvaluator(ConstrainedObjective):
    """Evaluate a support problem; the results of the last variables are kept.

    Attributes:
        problem: The design problem.
        bases: Factors of the coefficients at the samples, for derivatives of order 0 to 2.
        kinds: Names of the kinds of constraints that this problem has.
    """

    problem: SupportProblem

    def __init__(self, problem: SupportProblem) -> None:
        """Allocate the functions at all samples."""
        self.problem, self.bases = problem, problem.bases()
        functions, count = problem.functions, problem.options.samples
        library = functions.library
        self._informative = np.arange(0, count, INFORMATION_STRIDE)
        self._clear = np.arange(0, count, CLEARANCE_STRIDE)
        some = len(self._informative)
        bodies = some * (problem.robot.n + 1)
        self._bodies = MappedFunction(functions.bodies, some, library)
        self._bodies_adjoint = MappedFunction(functions.bodies_adjoint, some, library)
        self._block = MappedFunction(functions.regressor, bodies, library)
        self._block_adjoint = MappedFunction(functions.regressor_adjoint, bodies, library)
        self._rows = MappedFunction(functions.rows, count, library)
        self._rows_adjoint = PaddedFunction(functions.rows_adjoint, library)
        self._legs = [_Leg(problem, leg) for leg in functions.legs]
        limits = problem.limits
        self.kinds = (
            "position",
            "velocity",
            *["acceleration"] * bool(np.isfinite(limits.acceleration).any()),
            "torque",
            "contact",
            *["clearance"] * (problem.clearance is not None),
        )
        self._independent, self._home = problem.stance.independent, problem.stance.home
        self._row_scale = np.sqrt(
            problem.options.rate * motion_duration(problem.options.period) / some
        ) / np.asarray(problem.wrench_noise)
        self._point: _Point | None = None

    def _at(self, x: FloatArray) -> _Point:
        """Return the point of `x`, which is kept until the next one."""
        if self._point is None or not np.array_equal(self._point.x, x):
            p = self.problem
            table = x.reshape(p.scale.shape) * p.scale
            count, size = p.options.samples, BASE_COORDINATES + p.robot.n
            motion = (np.zeros((count, size)), np.zeros((count, size)), np.zeros((count, size)))
            for order in range(3):
                motion[order][:, self._independent] = self.bases[order] @ table.T
            motion[0][:, self._independent] += self._home
            slopes, is_reachable = [], True
            base = [array[:, :BASE_COORDINATES] for array in motion]
            for leg in self._legs:
                solution, slope, reached = leg.solve(*base)
                for array, values in zip(motion, solution, strict=True):
                    array[:, BASE_COORDINATES + leg.joints] = values
                slopes.append(slope)
                is_reachable &= reached
            self._point = _Point(x.copy(), motion, slopes, is_reachable)
        return self._point

    def motion(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, velocities and accelerations of (b, q). Shape (N, 6 + n) each."""
        return self._at(x).motion

    def _regressor(self, point: _Point) -> tuple[FloatArray, FloatArray]:
        """Return the states of the bodies and the regressor of the base rows, weighted.

        Every `INFORMATION_STRIDE`-th sample counts. Shapes (M·(n + 1), BODY_STATE) and
        (M·6, 10·(n + 1)).
        """
        count, bodies = len(self._informative), self.problem.robot.n + 1
        if point.states is None:
            motion = (array[self._informative] for array in point.motion)
            point.states = self._bodies(*motion)[0].reshape(-1, BODY_STATE).copy()
        blocks = self._block(point.states)[0].reshape(count, bodies, WRENCH_SIZE, 10)
        rows = blocks.transpose(0, 2, 1, 3) * self._row_scale[:, None, None]
        return point.states, rows.reshape(count * WRENCH_SIZE, 10 * bodies)

    def objective(self, x: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
        """Evaluate the objective and its gradient; A and D are smooth, so sharpness is not used."""
        point, p = self._at(x), self.problem
        states, Y = self._regressor(point)
        rows = Y @ p.columns
        information = rows.T @ rows + p.earlier_information
        value, slope = criteria.regularised_objective(p.options.criterion, information)
        by_rows = 2.0 * Y @ (p.columns @ slope @ p.columns.T)
        count, bodies = len(self._informative), p.robot.n + 1
        by_blocks = by_rows.reshape(count, WRENCH_SIZE, bodies, 10) * self._row_scale[:, None, None]
        seed = by_blocks.transpose(0, 2, 1, 3).reshape(-1, WRENCH_SIZE, 10)
        by_states = self._block_adjoint(states, seed)[0].reshape(count, bodies, BODY_STATE)
        motion = (array[self._informative] for array in point.motion)
        gradients = [g.copy() for g in self._bodies_adjoint(*motion, by_states)]
        table = self._by_independent(point, self._informative, gradients)
        out = np.zeros(p.scale.shape)
        for gradient, basis in zip(table, self.bases, strict=True):
            out += gradient.T @ basis[self._informative]
        return value, np.asarray((out * p.scale).ravel())

    def _by_independent(
        self, point: _Point, samples: IntArray, gradients: list[FloatArray]
    ) -> list[FloatArray]:
        """Return gradients by the independent coordinates from gradients by all coordinates.

        Args:
            point: The point.
            samples: Sample that each row belongs to. Shape (m,).
            gradients: Gradients by (b, q) and its derivatives. Shape (m, 6 + n) each.

        Returns:
            Gradients by the independent coordinates and their derivatives.
        """
        by_base = np.concatenate([g[:, :BASE_COORDINATES] for g in gradients], axis=1)
        for leg, slope in zip(self._legs, point.slopes, strict=True):
            places = BASE_COORDINATES + leg.joints
            by_leg = np.concatenate([g[:, places] for g in gradients], axis=1)
            by_base = by_base + np.einsum("mz,mzy->my", by_leg, slope[samples])
        out = []
        for order, gradient in enumerate(gradients):
            part = gradient.copy()
            part[:, :BASE_COORDINATES] = by_base[
                :, BASE_COORDINATES * order : BASE_COORDINATES * (order + 1)
            ]
            out.append(part[:, self._independent])
        return out

    def constraint_values(self, x: FloatArray) -> dict[str, FloatArray]:
        """Return the values of all constraints; the motion is feasible where they are at most 1.

        Returns:
            For each kind an array of shape (2, N, n), first for the sign +, then −; (1, N, rows)
            for the contact, and (1, M, pairs) for the clearance, of every `CLEARANCE_STRIDE`-th
            sample.
        """
        point, limits = self._at(x), self.problem.limits
        if not point.constraint_values:
            q, dq, ddq = (array[:, BASE_COORDINATES:] for array in point.motion)
            rows = self._rows(*point.motion)[0]
            torque = rows[:, : self.problem.robot.n] / (1.0 - self.problem.torque_reserve)
            ratios = {
                "velocity": dq / limits.velocity,
                "acceleration": ddq / limits.acceleration,
                "torque": torque,
            }
            values = {"position": centred(q, limits.position[:, 0], limits.position[:, 1])}
            values |= {
                kind: np.stack([ratio, -ratio])
                for kind, ratio in ratios.items()
                if kind in self.kinds
            }
            values["contact"] = rows[None, :, self.problem.robot.n :] + self.problem.contact_reserve
            if self.problem.clearance is not None:
                values["clearance"] = self._clearances(point).constraint_values()[None]
            point.constraint_values = values
        return point.constraint_values

    def clearance_poses(self, x: FloatArray) -> FloatArray:
        """Return the poses (b, q) at which distances are constrained. Shape (M, 6 + n)."""
        return self._at(x).motion[0][self._clear]

    def _clearances(self, point: _Point) -> ClearanceEvaluation:
        """Return the distances of all bodies at a point."""
        assert self.problem.clearance is not None
        if point.clearances is None:
            point.clearances = self.problem.clearance.evaluate(point.motion[0][self._clear])
        return point.clearances

    def max_constraint_value(self, x: FloatArray) -> float:
        """Return the largest value of all constraints; infinite where a foot is out of reach."""
        if not self._at(x).is_reachable:
            return float("inf")
        return super().max_constraint_value(x)

    def row_gradients(self, x: FloatArray, rows: ConstraintRows) -> FloatArray:
        """Return the exact Jacobian of selected constraints. Shape (m, size)."""
        point, p = self._at(x), self.problem
        size = BASE_COORDINATES + p.robot.n
        gradients = [np.zeros((len(rows), size)) for _ in range(3)]
        samples = rows.sample.copy()
        half = 0.5 * (p.limits.position[:, 1] - p.limits.position[:, 0])
        bounds = {
            "position": (0, half),
            "velocity": (1, p.limits.velocity),
            "acceleration": (2, p.limits.acceleration),
        }
        for number, kind in enumerate(self.kinds):
            at = np.flatnonzero(rows.kind == number)
            if len(at) == 0:
                continue
            sample, joint, sign = rows.sample[at], rows.joint[at], rows.sign[at]
            if kind in bounds:
                order, bound = bounds[kind]
                gradients[order][at, BASE_COORDINATES + joint] = sign / bound[joint]
                continue
            if kind == "clearance":
                samples[at] = self._clear[sample]
                gradients[0][at] = self._clearances(point).gradients(sample, joint)
                continue
            weights = np.zeros((len(at), p.functions.rows.size1_out(0)))
            if kind == "contact":
                weights[np.arange(len(at)), joint + p.robot.n] = sign
            else:
                weights[np.arange(len(at)), joint] = sign / (1.0 - p.torque_reserve)
            motion = [array[sample] for array in point.motion]
            for gradient, part in zip(gradients, self._rows_adjoint(*motion, weights), strict=True):
                gradient[at] = part
        table = self._by_independent(point, samples, gradients)
        out = np.zeros((len(rows), *p.scale.shape))
        for gradient, basis in zip(table, self.bases, strict=True):
            out += gradient[:, :, None] * basis[samples][:, None, :]
        return np.asarray((out * p.scale).reshape(len(rows), p.size))

    def worst_constraint(self, x: FloatArray) -> str:
        """Return the name of the largest constraint, and its value."""
        kind, values = max(self.constraint_values(x).items(), key=lambda item: item[1].max())
        index = int(np.unravel_index(np.argmax(values), values.shape)[2])
        p = self.problem
        if kind == "contact":
            label = p.functions.contact_names[index]
        elif kind == "clearance" and p.clearance is not None:
            label = f"the clearance of {p.clearance.names[index]}"
        else:
            label = f"the {kind} limit of '{p.robot.joints[index]}'"
        return f"{label} ({values.max():.3g})"


def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve A x = b at all samples. Shapes (N, 6, 6), (N, 6) -> (N, 6)."""
    return np.asarray(_solve_matrix(matrix, right[:, :, None])[:, :, 0])


def _solve_matrix(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve A X = B at all samples; at a singular leg, the solution of least norm."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), float)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix) @ right)
