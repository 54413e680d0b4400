"""Errors and warnings of the package; each message is one line: file, joint, remedy."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass


class ExciteError(Exception):
    """Base class of all errors that the package raises deliberately.

    Attributes:
        exit_code: Exit code of a command that ends with the error.
    """

    exit_code = 2


class UnusableInput(ExciteError):
    """A file, an option or a number that cannot be used as given."""


def toml_key(name: str) -> str:
    """Return a name as a key of TOML: quoted unless it consists of ASCII letters, digits, _, -."""
    bare = name.isascii() and bool(name) and name.replace("_", "a").replace("-", "a").isalnum()
    return name if bare else json.dumps(name, ensure_ascii=False)


class UnusableRobot(UnusableInput):
    """A robot whose description has faults.

    Attributes:
        faults: All of them, a line each; the message is the first one and says how many follow.
    """

    def __init__(self, faults: Sequence[str]) -> None:
        self.faults = tuple(faults)
        more = len(self.faults) - 1
        super().__init__(
            self.faults[0] + (f" ({more} more fault(s): 'excite check' lists them)" if more else "")
        )


@dataclass(frozen=True)
class LimitFault:
    """A limit that is needed and cannot be used.

    Attributes:
        joint: Name of the joint.
        quantity: "position", "velocity" or "torque".
        reason: Why the stated one cannot be used; "" where none is stated.
    """

    joint: str
    quantity: str
    reason: str = ""

    def summary(self) -> str:
        """The quantity, and the reason in parentheses."""
        return f"{self.quantity} ({self.reason})" if self.reason else self.quantity

    def __str__(self) -> str:
        reason = f" ({self.reason})" if self.reason else ""
        return f"joint '{self.joint}' has no usable {self.quantity} limit{reason}"


class MissingLimit(UnusableInput):
    """Joints have no usable limit of a kind that the design needs.

    Attributes:
        faults: All limits that are missing.
    """

    def __init__(self, source: str, faults: Sequence[LimitFault], *, is_mjcf: bool = False) -> None:
        self.faults = tuple(faults)
        first = self.faults[0]
        example = f"([joints.{toml_key(first.joint)}] {first.quantity} = …)"
        place = _place_of_limits(self.faults, is_mjcf=is_mjcf)
        if len(self.faults) == 1:
            super().__init__(f"{source}: {first}; set it {place} --limits FILE.toml {example}")
            return
        joints = dict.fromkeys(fault.joint for fault in self.faults)
        listed = "; ".join(
            f"'{joint}': {', '.join(f.summary() for f in self.faults if f.joint == joint)}"
            for joint in joints
        )
        super().__init__(
            f"{source}: {len(self.faults)} limits are missing or unusable ({listed}); set them "
            f"{place} --limits FILE.toml {example}; 'excite check {source} "
            "--limits-template FILE.toml' writes a file to fill in"
        )


def _place_of_limits(faults: Sequence[LimitFault], *, is_mjcf: bool) -> str:
    """Return where limits are set, up to the option: in the robot's file, unless an MJCF has no
    place for them, or by the option."""
    if not is_mjcf:
        return "in the URDF's <limit> or with"
    quantities = {fault.quantity for fault in faults}
    places = [
        attribute
        for quantity, attribute in (("position", "range"), ("torque", "actuatorfrcrange"))
        if quantity in quantities
    ]
    if not places:
        return "with"
    named = f"in the MJCF ({' and '.join(places)} of the <joint>"
    no_place = "; it has no place for a velocity" if "velocity" in quantities else ""
    return f"{named}{no_place}) or with"


class Infeasible(ExciteError):
    """No motion satisfies all limits; the message names those that conflict."""

    exit_code = 1


class CheckFailed(ExciteError):
    """A motion violates a limit when it is verified from its file."""

    exit_code = 1


class WorkerKilled(ExciteError):
    """A process that ran a part of the work was killed."""

    exit_code = 70


class ExciteWarning(UserWarning):
    """Input was repaired or completed by a documented rule."""
