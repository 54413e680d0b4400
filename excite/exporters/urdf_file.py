"""URDF of an identified robot: the user's description with inertias and <dynamics> replaced."""

from __future__ import annotations

import numpy as np

from .._types import FloatArray
from ..identification.identified_model import stated_urdf
from ..identification.urdf_export import identified_urdf
from ..robot.robot import load
from .simulator_model import Held, SimulatorModel

HOLDS: frozenset[Held] = frozenset({Held.INERTIA, Held.VISCOUS, Held.COULOMB})
"""Quantities that URDF holds. Rotor inertia, offset and width of friction go into <excite>
elements, which excite reads and other programs ignore."""


def urdf_text(model: SimulatorModel) -> str:
    """Return the URDF of an identified robot.

    Args:
        model: The identified robot.
    """
    lines = model.header("URDF", HOLDS)
    lines.append("<excite> elements hold rotor inertia, offset and width of friction for excite")
    with stated_urdf(str(model.document["urdf"])) as file:
        robot = load(str(file), joints=model.joints, gravity=model.model.robot.model.gravity.linear)
        return identified_urdf(robot, model.model.layout, _psi(model), model.torques.widths, lines)


def _psi(model: SimulatorModel) -> FloatArray:
    """Standard parameters with the joint parameters of the effects. Shape (P,)."""
    psi, layout = model.psi.copy(), model.model.layout
    values = {
        "rotor_inertia": model.torques.rotor_inertia,
        "viscous": model.torques.damping[:, 0],
        "coulomb": model.torques.coulomb,
        "offset": model.torques.spring[:, 0],
    }
    for kind in model.model.drive:
        psi[layout.block(kind)] = np.asarray(values[kind])
    return psi
