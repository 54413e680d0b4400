"""A scene, a TOML file: shapes around the robot and on it, the floor and the clearance."""

from __future__ import annotations

import msgspec

from .cell import check_floor
from .quantities import Angle, ClearanceDistance, FilePath, Length, MeshScale, Name, Size


class _Placed(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Name and place of a shape.

    Attributes:
        name: Name of the shape.
        position: Origin of the shape [m].
        rotation: Roll, pitch and yaw about the fixed axes [rad].
        link: Link whose frame it is fixed in; None: the base frame.
        ignore: Names of bodies that it may touch.
    """

    name: Name | None = None
    position: tuple[Length, Length, Length] = (Length(0.0), Length(0.0), Length(0.0))
    rotation: tuple[Angle, Angle, Angle] = (Angle(0.0), Angle(0.0), Angle(0.0))
    link: Name | None = None
    ignore: list[Name] = []


class SphereEntry(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A sphere."""

    radius: Size

    @property
    def dimensions(self) -> tuple[float, ...]:
        """Numbers of `collision.geometry.Shape.size`."""
        return (self.radius,)


class CapsuleEntry(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A capsule along its z axis.

    Attributes:
        radius: Radius [m].
        length: Distance between the centres of its ends [m].
    """

    radius: Size
    length: Size

    @property
    def dimensions(self) -> tuple[float, ...]:
        """Numbers of `collision.geometry.Shape.size`."""
        return self.radius, self.length


class CylinderEntry(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A cylinder along its z axis."""

    radius: Size
    length: Size

    @property
    def dimensions(self) -> tuple[float, ...]:
        """Numbers of `collision.geometry.Shape.size`."""
        return self.radius, self.length


class BoxEntry(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A box."""

    size: tuple[Size, Size, Size]

    @property
    def dimensions(self) -> tuple[float, ...]:
        """Numbers of `collision.geometry.Shape.size`."""
        return self.size


class MeshEntry(_Placed, forbid_unknown_fields=True, kw_only=True):
    """A mesh.

    Attributes:
        file: Path, absolute or relative to the scene file.
        scale: Factors along x, y and z.
    """

    file: FilePath
    scale: tuple[MeshScale, MeshScale, MeshScale] = (MeshScale(1.0), MeshScale(1.0), MeshScale(1.0))

    @property
    def dimensions(self) -> tuple[float, ...]:
        """Numbers of `collision.geometry.Shape.size`."""
        return self.scale


ShapeEntry = SphereEntry | CapsuleEntry | CylinderEntry | BoxEntry | MeshEntry


class SceneFile(msgspec.Struct, forbid_unknown_fields=True):
    """The complete file.

    Attributes:
        floor: Height of the floor [m], or false for none.
        clearance: Distance that bodies must keep [m].
    """

    sphere: list[SphereEntry] = []
    capsule: list[CapsuleEntry] = []
    cylinder: list[CylinderEntry] = []
    box: list[BoxEntry] = []
    mesh: list[MeshEntry] = []
    floor: float | bool | None = None
    clearance: ClearanceDistance | None = None

    def __post_init__(self) -> None:
        check_floor(self.floor)
