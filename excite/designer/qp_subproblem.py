"""Quadratic subproblem of one step: min gᵀd + ½dᵀBd subject to J d ≤ slack, lower ≤ d ≤ upper.

CasADi's DAQP solves it. It reads and writes numpy memory directly, since converting arrays would
cost more than solving. Few constraints are ever active, so they are added as a step violates them.
"""

from __future__ import annotations

import threading

import casadi as ca
import numpy as np

from .._types import FloatArray

WORKING_SET_SLACK = 0.04
"""Constraints with less slack than this take part from the beginning [1]."""

ROW_COUNT_STEP = 32
"""Solvers are built for multiples of this number of constraints, to reuse them [1]."""

FEASIBILITY_TOLERANCE = 1e-6
"""Violation of a constraint that a solution may have [1]."""

# Load HiGHS now: cvxpy imports highspy, another version under the same library name, on which
# CasADi would crash.
ca.load_conic("highs")
_SETTINGS: dict[str, dict[str, object]] = {
    "daqp": {"daqp": {"eps_prox": 1e-6}},
    "highs": {"highs": {"output_flag": False, "time_limit": 1.0}},
}


class _Program:
    """Solver for one size, with the arrays that it reads and writes; unused rows are 0 ≤ ∞."""

    def __init__(self, plugin: str, size: int, rows: int) -> None:
        """Build the solver.

        Args:
            plugin: CasADi plugin, daqp or highs.
            size: Number of variables.
            rows: Number of constraints.
        """
        shape = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity.dense(rows, size)}
        self._solver = ca.conic(
            "subproblem", plugin, shape, {**_SETTINGS[plugin], "error_on_fail": False}
        )
        self._buffer, self._run = self._solver.buffer()
        self.inputs = {
            name: np.zeros(self._solver.nnz_in(i)) for i, name in enumerate(self._solver.name_in())
        }
        self.outputs = {
            name: np.zeros(self._solver.nnz_out(i))
            for i, name in enumerate(self._solver.name_out())
        }
        self.inputs["a"] = np.zeros((size, rows))  # CasADi stores by columns
        for i, array in enumerate(self.inputs.values()):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[arg-type]
        for i, array in enumerate(self.outputs.values()):
            self._buffer.set_res(i, memoryview(array))  # type: ignore[arg-type]
        self.inputs["lba"][:] = -np.inf

    def __call__(
        self,
        B: FloatArray,
        g: FloatArray,
        J: FloatArray,
        slack: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Solve one subproblem; return the step and the multipliers."""
        count, inputs = len(slack), self.inputs
        inputs["h"][:], inputs["g"][:], inputs["lbx"][:], inputs["ubx"][:] = (
            B.ravel(),
            g,
            lower,
            upper,
        )
        inputs["a"][:, :count], inputs["a"][:, count:] = J.T, 0.0
        inputs["uba"][:count], inputs["uba"][count:] = slack, np.inf
        for name in ("x0", "lam_x0", "lam_a0"):
            inputs[name][:] = 0.0
        self._run()
        return self.outputs["x"].copy(), self.outputs["lam_a"][:count].copy()


class _ProgramCache(threading.local):
    """Solvers by plugin and size, for each thread, as a call writes into the solver's memory."""

    def __init__(self) -> None:
        """Begin with no solvers."""
        self.programs: dict[tuple[str, int, int], _Program] = {}


_CACHE = _ProgramCache()


def _program(plugin: str, size: int, rows: int) -> _Program:
    """Return a solver for at least `rows` constraints."""
    key = (plugin, size, ROW_COUNT_STEP * (1 + rows // ROW_COUNT_STEP))
    if key not in _CACHE.programs:
        _CACHE.programs[key] = _Program(*key)
    return _CACHE.programs[key]


def solve(
    B: FloatArray,
    g: FloatArray,
    J: FloatArray,
    slack: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Solve one subproblem.

    Args:
        B: Approximate Hessian of the Lagrangian. Shape (n, n).
        g: Gradient of the objective. Shape (n,).
        J: Jacobian of the constraints. Shape (m, n).
        slack: Slack of the constraints, negative where they are violated. Shape (m,).
        lower: Lower bounds of the step. Shape (n,).
        upper: Upper bounds of the step. Shape (n,).

    Returns:
        The step d, shape (n,), and the multipliers of the constraints, not negative, shape (m,).
    """
    working = slack < WORKING_SET_SLACK
    while True:
        step, working_multipliers = _solve_robustly(B, g, J[working], slack[working], lower, upper)
        multipliers = np.zeros(len(slack))
        multipliers[working] = working_multipliers
        violated = (J @ step > slack + FEASIBILITY_TOLERANCE) & ~working
        if not violated.any():
            return step, multipliers
        working |= violated


def _solve_robustly(
    B: FloatArray,
    g: FloatArray,
    J: FloatArray,
    slack: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Solve with DAQP, and with HiGHS where DAQP ends with violated constraints.

    DAQP is faster, HiGHS more reliable. As a last resort, constraints that are violated already
    need not improve, so that a step of 0 is feasible.
    """
    for plugin, bound in (("daqp", slack), ("highs", slack), ("highs", np.maximum(slack, 0.0))):
        step, multipliers = _program(plugin, len(g), len(slack))(B, g, J, bound, lower, upper)
        if not np.isfinite(step).all():
            step, multipliers = np.zeros_like(g), np.zeros(len(slack))
        excess = max(
            (J @ step - bound).max(initial=0.0), (step - upper).max(), (lower - step).max()
        )
        if excess < FEASIBILITY_TOLERANCE:
            break
    return step, np.maximum(multipliers, 0.0)
