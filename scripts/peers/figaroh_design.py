"""Compute figaroh's optimal trajectory of a robot; prints JSON.

The script runs in an interpreter that has figaroh (bench_design.py --peer).

Installation that worked (figaroh 1.0.2, cyipopt 1.7.0, casadi 3.8.2, Python 3.11, Linux): cyipopt
is built against the IPOPT in the casadi wheel, whose ipopt.pc has to be corrected:

    python3.11 -m venv /tmp/figaroh && cd /tmp/figaroh && bin/pip install figaroh==1.0.2 casadi
    C=$(bin/python -c "import casadi, os; print(os.path.dirname(casadi.__file__))") && mkdir pc
    sed "s|^prefix=.*|prefix=$C|; s|^libdir=.*|libdir=$C|" $C/pkgconfig/ipopt.pc > pc/ipopt.pc
    PKG_CONFIG_PATH=$PWD/pc LDFLAGS="-Wl,-rpath,$C" bin/pip install --no-cache-dir cyipopt

The problem is that of figaroh-examples' UR10: cubic spline at rest in waypoints 2 s apart,
condition number of the base regressor at 20 Hz, position, velocity and torque limits of the
URDF, IPOPT. Unlike there, limits are not narrowed (soft_lim 0), and meshes are left out, so that
collision pairs, which excite does not check in this comparison, cost nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from figaroh.optimal.base_optimal_trajectory import (  # type: ignore[import-not-found]
    BaseOptimalTrajectory,
    BaseTrajectoryIPOPTProblem,
)
from figaroh.tools.robot import load_robot  # type: ignore[import-not-found]

DENSE = 10
"""Factor by which the returned trajectory is denser than its own samples, for checking."""


class TimedProblem(BaseTrajectoryIPOPTProblem):  # type: ignore[misc]
    """figaroh's problem, with a record of time, value and iterate.

    IPOPT evaluates the gradient once per iterate.
    """

    def gradient(self, X: Any) -> Any:
        """Remember the iterate."""
        self.iterate = np.array(X)
        return super().gradient(X)

    def intermediate(self, alg_mod: int, iter_count: int, obj_value: float, *other: Any) -> Any:
        """Record the iteration."""
        self.opt_traj.history.append(
            (time.perf_counter() - self.opt_traj.began, float(obj_value), self.iterate)
        )
        return super().intermediate(alg_mod, iter_count, obj_value, *other)

    def solve_with_waypoints(self, wps: Any) -> Any:
        """Record the time of the initial guess and the solution."""
        self.opt_traj.guess = time.perf_counter() - self.opt_traj.began
        success, results = super().solve_with_waypoints(wps)
        self.solution = results.get("x_opt")
        return success, results


class TimedTrajectory(BaseOptimalTrajectory):  # type: ignore[misc]
    """figaroh's optimal trajectory with the timed problem."""

    def create_ipopt_problem(self, *sizes: Any) -> TimedProblem:
        """Create the timed problem."""
        self.problem = TimedProblem(self, *sizes, "peer")
        return self.problem

    def start(self) -> None:
        """Find the base parameters and start the clock."""
        joints = self.robot.model.joints[1:]
        self.identif_config |= {
            "active_joints": self.active_joints,
            "act_Jid": [j.id for j in joints],
            "act_J": list(joints),
        }
        self.identif_config |= {
            "act_idxq": [j.idx_q for j in joints],
            "act_idxv": [j.idx_v for j in joints],
        }
        self.initialize()
        self.history: list[tuple[float, float, Any]] = []
        self.guess, self.began = 0.0, time.perf_counter()


def configuration(given: argparse.Namespace, joints: list[str]) -> dict[str, Any]:
    """Return figaroh's configuration: that of its UR10 example, with the changes of this run."""
    return {
        "robot": {"name": "peer", "properties": {"joints": {"active_joints": joints}}},
        "tasks": {
            "identification": {
                "problem": {
                    "include_external_forces": False,
                    "use_joint_torques": True,
                    "model_components": {
                        "friction": False,
                        "joint_offset": False,
                        "actuator_inertia": False,
                    },
                }
            },
            "optimal_trajectory": {
                "problem": {
                    "soft_lim": 0.0,
                    "max_attempts": 500,
                    "max_iterations": given.iterations,
                },
                "trajectory": {
                    "waypoints": round(given.duration / 2.0) + 1,
                    "frequency": given.rate,
                    "segment_duration": 2.0,
                },
            },
        },
    }


def without_meshes(urdf: Path, folder: Path) -> Path:
    """Write a copy of the URDF without geometry."""
    tree = ElementTree.parse(urdf)
    for link in tree.iter("link"):
        for kind in ("visual", "collision"):
            for part in link.findall(kind):
                link.remove(part)
    tree.write(folder / "robot.urdf")
    return folder / "robot.urdf"


def solve(given: argparse.Namespace) -> dict[str, Any]:
    """Run figaroh's optimiser on one segment.

    Times count from after its base parameters are found.
    """
    np.random.seed(given.seed)  # noqa: NPY002 — figaroh draws from the global generator
    with tempfile.TemporaryDirectory() as name:
        robot = load_robot(
            str(without_meshes(given.urdf, Path(name))), package_dirs=name, load_by_urdf=True
        )
        joints = [str(joint) for joint in robot.model.names[1:]]
        (Path(name) / "peer.yaml").write_text(
            yaml.safe_dump(configuration(given, joints)), encoding="utf-8"
        )
        trajectory = TimedTrajectory(robot, joints, str(Path(name) / "peer.yaml"))
    trajectory.start()
    results = trajectory.solve(stack_reps=1)
    seconds = time.perf_counter() - trajectory.began
    if not results["T_F"]:
        return {"solved": False, "seconds": seconds}
    problem = trajectory.problem
    moving = np.reshape(problem.solution, (problem.n_wps - 1, problem.n_joints))
    waypoints = np.vstack([problem.wp_init, moving]).T
    _, *dense = trajectory.CB.get_full_config(
        DENSE * given.rate, problem.tps, waypoints, problem.vel_wps, problem.acc_wps
    )
    return {
        "solved": True,
        "seconds": seconds,
        "guess": trajectory.guess,
        "value": float(
            np.linalg.cond(
                trajectory._stack_base_regressors(
                    *(results[key][-1] for key in ("P_F", "V_F", "A_F"))
                )
            )
        ),
        "history": [
            (seconds_at, value, problem._is_feasible(x))
            for seconds_at, value, x in trajectory.history
        ],
        "converged": bool(results["iteration_data"][-1]["converged"]),
        "base": len(trajectory.idx_b),
        "joints": joints,
        "own": [np.asarray(results[key][-1]).tolist() for key in ("P_F", "V_F", "A_F")],
        "dense": [np.asarray(part).tolist() for part in dense],
    }


def main() -> int:
    """Print the result as JSON; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("urdf", type=Path)
    parser.add_argument("--duration", type=float, default=12.0, help="[s], a multiple of 2")
    parser.add_argument("--rate", type=int, default=20, help="[Hz]")
    parser.add_argument("--iterations", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    out = os.dup(1)
    os.dup2(2, 1)  # IPOPT's banner and figaroh's prints must not mix with the JSON
    result = {"figaroh": metadata.version("figaroh"), **solve(given)}
    os.write(out, json.dumps(result).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
