"""The quadratic program of one step: min gᵀd + ½dᵀBd subject to J d ≤ room, lower ≤ d ≤ upper.

CasADi's DAQP solves it, fed through memory it reads directly: converting arrays would cost more than solving. Few of
the rows ever bind, so they join as a step breaks them.
"""

from __future__ import annotations

import threading

import casadi as ca
import numpy as np

Array = np.ndarray
WORKING_SET_SLACK = 0.04
"""Rows with less room than this take part from the beginning."""
ROW_COUNT_STEP = 32
FEASIBILITY_TOLERANCE = 1e-6
# HiGHS now: highspy, which cvxpy imports, has another version under the same name, and CasADi would crash on that one.
ca.load_conic("highs")
_SETTINGS: dict[str, dict[str, object]] = {
    "daqp": {"daqp": {"eps_prox": 1e-6}},
    "highs": {"highs": {"output_flag": False, "time_limit": 1.0}},
}


class _Program:
    """One solver for one size, with the arrays it reads and writes. Rows beyond those given are 0 ≤ ∞."""

    def __init__(self, plugin: str, size: int, rows: int) -> None:
        shape = {"h": ca.Sparsity.dense(size, size), "a": ca.Sparsity.dense(rows, size)}
        self._solver = ca.conic(
            "subproblem", plugin, shape, {**_SETTINGS[plugin], "error_on_fail": False}
        )
        self._buffer, self._run = self._solver.buffer()
        self.given = {
            name: np.zeros(self._solver.nnz_in(i)) for i, name in enumerate(self._solver.name_in())
        }
        self.found = {
            name: np.zeros(self._solver.nnz_out(i))
            for i, name in enumerate(self._solver.name_out())
        }
        self.given["a"] = np.zeros((size, rows))  # CasADi stores by columns
        for i, array in enumerate(self.given.values()):
            self._buffer.set_arg(i, memoryview(array))  # type: ignore[arg-type]
        for i, array in enumerate(self.found.values()):
            self._buffer.set_res(i, memoryview(array))  # type: ignore[arg-type]
        self.given["lba"][:] = -np.inf

    def __call__(
        self, B: Array, g: Array, J: Array, room: Array, lower: Array, upper: Array
    ) -> tuple[Array, Array]:
        count, given = len(room), self.given
        given["h"][:], given["g"][:], given["lbx"][:], given["ubx"][:] = B.ravel(), g, lower, upper
        given["a"][:, :count], given["a"][:, count:] = J.T, 0.0
        given["uba"][:count], given["uba"][count:] = room, np.inf
        for name in ("x0", "lam_x0", "lam_a0"):
            given[name][:] = 0.0
        self._run()
        return self.found["x"].copy(), self.found["lam_a"][:count].copy()


class _Kept(threading.local):
    """Solvers by kind and size; each thread has its own, because a call writes into the solver's memory."""

    def __init__(self) -> None:
        self.programs: dict[tuple[str, int, int], _Program] = {}


_KEPT = _Kept()


def _program(plugin: str, size: int, rows: int) -> _Program:
    key = (plugin, size, ROW_COUNT_STEP * (1 + rows // ROW_COUNT_STEP))  # few distinct sizes
    if key not in _KEPT.programs:
        _KEPT.programs[key] = _Program(*key)
    return _KEPT.programs[key]


def solve(
    B: Array, g: Array, J: Array, room: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """The step d and the rows' multipliers (≥ 0). Shapes (n, n), (n,), (m, n), (m,), (n,), (n,) -> (n,), (m,)."""
    taken = room < WORKING_SET_SLACK
    while True:
        step, found = _robust(B, g, J[taken], room[taken], lower, upper)
        multipliers = np.zeros(len(room))
        multipliers[taken] = found
        broken = (J @ step > room + FEASIBILITY_TOLERANCE) & ~taken
        if not broken.any():
            return step, multipliers
        taken |= broken


def _robust(
    B: Array, g: Array, J: Array, room: Array, lower: Array, upper: Array
) -> tuple[Array, Array]:
    """DAQP is fast but now and then ends with broken rows; HiGHS is slower and doesn't.

    Last resort: rows that are broken already need not be mended, so that a step of zero is feasible.
    """
    for plugin, bound in (("daqp", room), ("highs", room), ("highs", np.maximum(room, 0.0))):
        step, multipliers = _program(plugin, len(g), len(room))(B, g, J, bound, lower, upper)
        if not np.isfinite(step).all():
            step, multipliers = np.zeros_like(g), np.zeros(len(room))
        excess = max(
            (J @ step - bound).max(initial=0.0), (step - upper).max(), (lower - step).max()
        )
        if excess < FEASIBILITY_TOLERANCE:
            break
    return step, np.maximum(multipliers, 0.0)
