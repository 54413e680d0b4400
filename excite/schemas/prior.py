"""Prior knowledge of a robot, schema excite.prior/1."""

from __future__ import annotations

from typing import Literal

import msgspec

from .quantities import CoulombFriction, RotorInertia, Text, Torque, ViscousFriction

SCHEMA = "excite.prior/1"


class PriorJoint(msgspec.Struct, forbid_unknown_fields=True):
    """Known parameters of a joint; None for a parameter that is to be estimated."""

    rotor_inertia: RotorInertia | None = None
    viscous: ViscousFriction | None = None
    coulomb: CoulombFriction | None = None
    offset: Torque | None = None


class PriorDocument(msgspec.Struct, forbid_unknown_fields=True):
    """The complete file."""

    schema: Literal["excite.prior/1"]
    trust_prior: bool
    joints: dict[str, PriorJoint] = {}
    notes: Text = Text("")
