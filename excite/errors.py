"""Errors and warnings of the package; each message is one line: file, joint, remedy."""

from __future__ import annotations

import json


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


class MissingLimit(UnusableInput):
    """A joint has no usable limit of a quantity that the computation needs.

    Attributes:
        joint: Name of the joint.
        quantity: Quantity without a limit: "velocity".
    """

    def __init__(self, joint: str, quantity: str, source: str) -> None:
        self.joint = joint
        self.quantity = quantity
        super().__init__(
            f"{source}: joint '{joint}' has no usable {quantity} limit; "
            f"set it in the URDF's <limit> or with --limits FILE.toml "
            f"([joints.{toml_key(joint)}] {quantity} = …)"
        )


class Infeasible(ExciteError):
    """No motion satisfies all limits; the message names those that conflict."""

    exit_code = 1


class CheckFailed(ExciteError):
    """A motion violates a limit when it is verified from its file."""

    exit_code = 1


class ExciteWarning(UserWarning):
    """Input was repaired or completed by a documented rule."""
