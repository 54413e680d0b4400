"""What can go wrong, each with the line a user needs: the file, the joint, the remedy."""

from __future__ import annotations

import json


class ExciteError(Exception):
    """Base of every error this package raises on purpose. `exit_code` is the command line's."""

    exit_code = 2


class UnusableInput(ExciteError):
    """A file, an option or a number that cannot be used as given."""


def toml_key(name: str) -> str:
    """A name as a key of TOML: in quotes unless it has only letters, digits, _ and - of ASCII."""
    bare = name.isascii() and bool(name) and name.replace("_", "a").replace("-", "a").isalnum()
    return name if bare else json.dumps(name, ensure_ascii=False)


class MissingLimit(UnusableInput):
    """A joint has no usable limit of a kind that the design needs."""

    def __init__(self, joint: str, quantity: str, source: str) -> None:
        self.joint = joint
        self.quantity = quantity
        super().__init__(
            f"{source}: joint '{joint}' has no usable {quantity} limit; "
            f"set it in the URDF's <limit> or with --limits FILE.toml "
            f"([joints.{toml_key(joint)}] {quantity} = …)"
        )


class Infeasible(ExciteError):
    """No motion obeys all limits; the text says which of them fight."""

    exit_code = 1


class CheckFailed(ExciteError):
    """A finished motion breaks a limit when recomputed from its file."""

    exit_code = 1


class ExciteWarning(UserWarning):
    """Something was handled by a stated rule; the user should know."""
