"""A scene, a TOML file: shapes around the robot and on it, the floor and the clearance."""

from __future__ import annotations

import msgspec

from .cell import check_floor
from .quantities import Angle, Clearance, FilePath, Length, MeshScale, Name, Size


class _Placed(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The place of a shape: in the frame of `link`, or in the base frame.

    ignore: bodies that it may touch.
    """

    name: Name | None = None
    position: tuple[Length, Length, Length] = (Length(0.0), Length(0.0), Length(0.0))
    rotation: tuple[Angle, Angle, Angle] = (Angle(0.0), Angle(0.0), Angle(0.0))
    link: Name | None = None
    ignore: list[Name] = []


class Sphere(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A sphere."""

    radius: Size

    @property
    def dimensions(self) -> tuple[float, ...]:
        """The numbers of `collision.shape.Shape.size`."""
        return (self.radius,)


class Capsule(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A capsule along its z axis. length: between the centres of its ends."""

    radius: Size
    length: Size

    @property
    def dimensions(self) -> tuple[float, ...]:
        """The numbers of `collision.shape.Shape.size`."""
        return self.radius, self.length


class Cylinder(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A cylinder along its z axis."""

    radius: Size
    length: Size

    @property
    def dimensions(self) -> tuple[float, ...]:
        """The numbers of `collision.shape.Shape.size`."""
        return self.radius, self.length


class Box(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A box."""

    size: tuple[Size, Size, Size]

    @property
    def dimensions(self) -> tuple[float, ...]:
        """The numbers of `collision.shape.Shape.size`."""
        return self.size


class Mesh(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A mesh. file: relative to the scene file, or absolute."""

    file: FilePath
    scale: tuple[MeshScale, MeshScale, MeshScale] = (MeshScale(1.0), MeshScale(1.0), MeshScale(1.0))

    @property
    def dimensions(self) -> tuple[float, ...]:
        """The numbers of `collision.shape.Shape.size`."""
        return self.scale


StatedShape = Sphere | Capsule | Cylinder | Box | Mesh


class SceneFile(msgspec.Struct, forbid_unknown_fields=True):
    """The whole file. floor: its height [m], or false for none."""

    sphere: list[Sphere] = []
    capsule: list[Capsule] = []
    cylinder: list[Cylinder] = []
    box: list[Box] = []
    mesh: list[Mesh] = []
    floor: float | bool | None = None
    clearance: Clearance | None = None

    def __post_init__(self) -> None:
        check_floor(self.floor)
