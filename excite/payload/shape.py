"""Stated shapes of a payload, as the prior of its inertia: box, cylinder, sphere or mesh."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._types import FloatArray
from ..collision.mesh_file import read_all
from ..errors import UnusableInput

DIMENSIONS = {"box": 3, "cylinder": 2, "sphere": 1}
"""Number of lengths of each shape: edges x, y, z; radius and length along z; radius."""
DEFAULT_DENSITY = 1000.0
"""Density of a payload of unknown shape [kg/m³]: that of a hollow or light tool."""
STATED_DEVIATION = 0.3
"""Standard deviation of a body from its stated shape, in the affine-invariant metric."""
UNKNOWN_DEVIATION = 3.0
"""The same for a body of unknown shape: second moments that are s times as large are at the
distance √(3/2) ln s, so that s may well be 10."""
USAGE = "box:X,Y,Z, cylinder:RADIUS,LENGTH, sphere:RADIUS or mesh:FILE, each with @CX,CY,CZ [m]"
"""Grammar of `parse_shape`."""


@dataclass(frozen=True)
class PayloadShape:
    """A uniform body of unit mass.

    Attributes:
        second: Second moments about its centre over the mass, ∫ r rᵀ dm / m. Shape (3, 3) [m²].
        centre: Centre of mass in the link's frame, shape (3,) [m]; None: unknown.
        deviation: Standard deviation of the true body from it in the affine-invariant metric.
        description: As it was stated.
    """

    second: FloatArray
    centre: FloatArray | None
    deviation: float
    description: str


def ball_of_mass(mass: float) -> PayloadShape:
    """Return the shape that stands for an unknown one: a ball of light material.

    Args:
        mass: Mass of the payload [kg].
    """
    radius = (3.0 * mass / (4.0 * np.pi * DEFAULT_DENSITY)) ** (1.0 / 3.0)
    second = 0.2 * radius**2 * np.eye(3)
    return PayloadShape(second, None, UNKNOWN_DEVIATION, "unknown")


def shape_mesh(text: str) -> Path | None:
    """Return the mesh file that a stated shape names, None if it names none.

    Args:
        text: As `USAGE` says.
    """
    kind, _, file = text.partition("@")[0].partition(":")
    return Path(file) if kind == "mesh" else None


def parse_shape(text: str) -> PayloadShape:
    """Read a stated shape.

    Args:
        text: As `USAGE` says; axes are those of the link.

    Raises:
        UnusableInput: The text is no shape, or its mesh cannot be read.
    """
    body, _, place = text.partition("@")
    kind, _, numbers = body.partition(":")
    centre = None
    if place:
        centre = np.array(_lengths(text, place, 3, signed=True))
    mesh = shape_mesh(text)
    if mesh is not None:
        second, middle = _mesh_moments(mesh)
        return PayloadShape(second, middle if centre is None else centre, STATED_DEVIATION, text)
    if kind not in DIMENSIONS:
        raise UnusableInput(f"--shape {text}: should be {USAGE}")
    lengths = np.array(_lengths(text, numbers, DIMENSIONS[kind], signed=False))
    if kind == "box":
        moments = lengths**2 / 12.0
    elif kind == "cylinder":
        radius, length = lengths
        moments = np.array([radius**2 / 4.0, radius**2 / 4.0, length**2 / 12.0])
    else:
        moments = np.full(3, lengths[0] ** 2 / 5.0)
    return PayloadShape(np.diag(moments), centre, STATED_DEVIATION, text)


def _lengths(text: str, numbers: str, count: int, *, signed: bool) -> list[float]:
    """The numbers of a shape [m].

    Raises:
        UnusableInput: They are not `count` lengths.
    """
    try:
        values = [float(number) for number in numbers.split(",")]
    except ValueError:
        values = []
    is_valid = len(values) == count and all(abs(value) < 100.0 for value in values)
    if not is_valid or (not signed and min(values) <= 0.0):
        raise UnusableInput(f"--shape {text}: should be {USAGE}")
    return values


def _mesh_moments(path: Path) -> tuple[FloatArray, FloatArray]:
    """Second moments over the mass about the centre, and the centre, of the uniform body inside a
    closed mesh, as sums over the tetrahedra from the origin."""
    mesh = read_all([str(path)])[0]
    corners = mesh.vertices[mesh.triangles]
    volumes = np.linalg.det(corners) / 6.0
    volume = float(volumes.sum())
    if abs(volume) < 1e-15:
        raise UnusableInput(f"{path}: encloses no volume; give a closed mesh in metres")
    sums = corners.sum(axis=1)
    centre = np.einsum("t,ti->i", volumes, sums) / (4.0 * volume)
    products = np.einsum("tki,tkj->tij", corners, corners) + np.einsum("ti,tj->tij", sums, sums)
    second = np.einsum("t,tij->ij", volumes, products) / (20.0 * volume)
    second -= np.outer(centre, centre)
    values, vectors = np.linalg.eigh(second)
    largest = float(values[-1])
    return (vectors * np.maximum(values, 1e-6 * largest)) @ vectors.T, centre
