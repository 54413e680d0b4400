"""What leaves the laboratory: the contract's CSV and sidecar; and what stays there: the truth."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import Any

import numpy as np

from .measurement import Chain
from .reference_trajectory import Reference
from .simulated_robot import Plant, Run
from .urdf_tree import MOMENTS, Tree

Array = np.ndarray
SETTLE = 0.5
"""Of the periodic part, what is left out of the stated window until the loop has settled [s]."""


@dataclass(frozen=True)
class Recording:
    """A recorded motion. t: Shape (N,) [s]; q, tau, qref: Shapes (N, n) [rad, N m, rad].

    period, periodic: of the excitation, and the window in which the motion repeats [s].
    """

    joints: tuple[str, ...]
    t: Array
    q: Array
    tau: Array
    qref: Array
    period: float
    periodic: tuple[float, float]

    def csv(self) -> str:
        """The contract's columns; every number takes equally many characters."""
        stream = io.StringIO()
        names = [f"{kind}.{joint}" for kind in ("q", "tau", "qref") for joint in self.joints]
        csv.writer(stream, lineterminator="\n").writerow(["t", *names])
        row = "%012.6f" + ",%+.9e" * (3 * len(self.joints)) + "\n"
        table = np.hstack([self.t[:, None], self.q, self.tau, self.qref])
        return stream.getvalue() + "".join(row % tuple(values) for values in table.tolist())

    def sidecar(self) -> dict[str, Any]:
        """`excite.recording/1`."""
        return {
            "schema": "excite.recording/1",
            "period": self.period,
            "periodic": list(self.periodic),
            "motor_side": True,
            "notes": "simulated by 'excite simulate'",
        }


def record(run: Run, reference: Reference, chain: Chain, rng: np.random.Generator) -> Recording:
    """Measure a motion. The same generator state gives the same noise, whatever hides in the robot."""
    t = chain.times(reference.duration)
    clock, noise = rng.spawn(2)
    q, tau = run.told(chain.sampled(t, clock))
    window = (reference.periodic[0] + min(SETTLE, 0.1 * reference.period), reference.periodic[1])
    return Recording(
        reference.joints,
        t,
        chain.positions(q),
        chain.torques(tau, noise),
        reference.at(t)[0],
        reference.period,
        window,
    )


def truth(plant: Plant, chain: Chain, facts: Mapping[str, Any]) -> dict[str, Any]:
    """`excite.truth/1`: what the simulated robot is, in the contract's units; `facts` (effects, seed …) come first."""
    drive = {
        key: dict(zip(plant.joints, values.tolist(), strict=True))
        for key, values in asdict(plant.drive).items()
    }
    document: dict[str, Any] = {
        "schema": "excite.truth/1",
        **facts,
        "joints": list(plant.joints),
        "drive": drive,
        "bodies": {link: ten(plant.tree, link) for link in plant.tree.links},
        "control": asdict(plant.control),
        "chain": {
            k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in asdict(chain).items()
        },
        "versions": {name: metadata.version(name) for name in ("mujoco", "numpy", "scipy")},
    }
    return document


def ten(tree: Tree, link: str) -> list[float]:
    """[m, m·cx, m·cy, m·cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz] of a link in its own frame."""
    pseudo = tree.body(link)
    tensor = np.trace(pseudo[:3, :3]) * np.eye(3) - pseudo[:3, :3]
    order = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
    return [
        float(v) for v in (pseudo[3, 3], *pseudo[:3, 3], *(tensor[MOMENTS[key]] for key in order))
    ]


def dumps(document: Mapping[str, Any]) -> str:
    """Strict JSON, keys in the order given."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)
