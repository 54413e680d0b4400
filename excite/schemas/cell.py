"""The cell in a trajectory: shapes, and pairs of bodies that need not keep the clearance."""

from __future__ import annotations

from typing import Literal

import msgspec

from .quantities import (
    Angle,
    ClearanceDistance,
    FilePath,
    Length,
    Name,
    Sha256,
    ShapeSize,
    Size,
    Text,
    shown,
)

ShapeKindName = Literal["sphere", "capsule", "cylinder", "box", "mesh", "floor"]
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "mesh": 3, "floor": 0}
"""Number of dimensions of each kind of shape."""


class ShapeDocument(msgspec.Struct):
    """A shape; `collision.geometry.Shape.document` writes it.

    Attributes:
        name: Name of the body that it is part of.
        kind: Kind of the shape.
        size: Dimensions as `collision.geometry.ShapeKind` states them.
        position: Origin of the shape [m].
        rotation: Roll, pitch and yaw about the fixed axes [rad].
        link: Link whose frame it is fixed in; None: the base frame.
        file: Path of a mesh.
        sha256: Digest of that file.
    """

    name: Name
    kind: ShapeKindName
    size: list[ShapeSize]
    position: tuple[Length, Length, Length]
    rotation: tuple[Angle, Angle, Angle]
    link: Name | None = None
    file: FilePath | None = None
    sha256: Sha256 | None = None

    def __post_init__(self) -> None:
        if len(self.size) != SIZES[self.kind]:
            raise ValueError(
                f"size: a {self.kind} should have {SIZES[self.kind]} values, not {len(self.size)}"
            )
        for i, length in enumerate(self.size):
            if self.kind != "mesh" and not Size.accepted.accepts(length):
                raise ValueError(f"size[{i}]: {shown(length)} should be {Size.accepted}")
        if self.kind == "mesh" and (self.file is None or self.sha256 is None):
            raise ValueError("a mesh should state its file and the file's sha256")
        if self.kind != "mesh" and self.file is not None:
            raise ValueError(f"a {self.kind} has no file")


def check_floor(floor: float | bool | None) -> None:
    """Raise ValueError for a floor that is neither a height nor false.

    msgspec has no union of a bool with a `Length`.
    """
    if floor is True or not (floor is None or floor is False or Length.accepted.accepts(floor)):
        raise ValueError(
            f"floor: {shown(floor)} should be a height {Length.accepted}, or false for none"
        )


class ExceptedDocument(msgspec.Struct):
    """A pair of bodies that need not keep the clearance, with the reason."""

    first: Name
    second: Name
    why: Text


class RecipeDocument(msgspec.Struct):
    """Files and options from which a cell was built; see `collision.workcell.Recipe`."""

    packages: list[FilePath] = []
    scene: FilePath | None = None
    srdf: FilePath | None = None
    floor: float | bool | None = None
    clearance: ClearanceDistance | None = None

    def __post_init__(self) -> None:
        check_floor(self.floor)


class CellDocument(msgspec.Struct):
    """A cell; `collision.workcell.Cell.document` writes it."""

    margin: ClearanceDistance
    shapes: list[ShapeDocument]
    disabled: list[tuple[Name, Name]] = []
    excepted: list[ExceptedDocument] = []
    notes: list[Text] = []
    recipe: RecipeDocument | None = None
