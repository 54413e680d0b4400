"""Payload in the words of controllers: UR, Franka, KUKA, and as a body for URDF and MJCF."""

from __future__ import annotations

import json
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from .._system.comments import line_comment, xml_comment_text
from ..robot.inertial_parameters import TENSOR_ELEMENTS

UNVERIFIED = "never tried on hardware; check units and frame before use"
"""Warning in every snippet for a controller."""


def snippets(body: pin.Inertia, link: str) -> dict[str, str]:
    """Return the payload as text for each kind of user.

    Args:
        body: The payload as a rigid body in the link's frame. For controllers that link should be
            their flange or tool frame.
        link: Name of the link.
    """
    mass, centre, tensor = float(body.mass), np.array(body.lever), np.array(body.inertia)
    return {
        "UR: set_target_payload": _ur(mass, centre, tensor, link),
        "Franka: setLoad and Desk": _franka(mass, centre, tensor, link),
        "KUKA: load data": _kuka(mass, centre, tensor, link),
        "URDF": _urdf(mass, centre, tensor, link),
        "MJCF": _mjcf(mass, centre, tensor, link),
    }


def _frame_comment(mark: str, link: str, flange: str) -> str:
    """The line of a controller's program that says in which frame the payload is."""
    place = f"centre and axes in the frame {link}, which should be the {flange}"
    return line_comment([f"{place}; {UNVERIFIED}"], mark)


def _ur(mass: float, centre: np.ndarray, tensor: np.ndarray, link: str) -> str:
    """URScript: mass [kg], centre [m], inertia about the centre Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
    moments = [tensor[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return (
        f"{_frame_comment('#', link, 'tool flange')}\n"
        f"set_target_payload({mass:.6g}, {_list(centre)}, {_list(moments)})"
    )


def _franka(mass: float, centre: np.ndarray, tensor: np.ndarray, link: str) -> str:
    """libfranka: mass, centre in the flange frame, inertia about the centre by columns."""
    numbers = ", ".join(f"{value:.6g}" for value in tensor.T.ravel())
    middle = ", ".join(f"{value:.6g}" for value in centre)
    desk = {
        "mass": round(mass, 6),
        "centerOfMass": [round(float(value), 6) for value in centre],
        "inertia": [
            round(float(tensor[k]), 9) for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        ],
    }
    return (
        f"{_frame_comment('//', link, 'flange')}\n"
        f"robot.setLoad({mass:.6g}, {{{middle}}}, {{{numbers}}});\n"
        f"// Desk, inertia as xx, yy, zz, xy, xz, yz:\n{json.dumps(desk)}"
    )


def _kuka(mass: float, centre: np.ndarray, tensor: np.ndarray, link: str) -> str:
    """KRL: mass [kg], centre [mm], principal axes A, B, C [deg] and principal moments [kg m²]."""
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    a, b, c = np.rad2deg(_zyx(axes))
    x, y, z = 1000.0 * centre
    jx, jy, jz = moments
    return (
        f"{_frame_comment(';', link, 'flange')}\n"
        f"LOAD_DATA[1]={{M {mass:.6g},CM {{X {x:.6g},Y {y:.6g},Z {z:.6g},"
        f"A {a:.6g},B {b:.6g},C {c:.6g}}},J {{X {jx:.6g},Y {jy:.6g},Z {jz:.6g}}}}}"
    )


def _zyx(rotation: np.ndarray) -> tuple[float, float, float]:
    """Angles A, B, C of R = Rz(A) Ry(B) Rx(C) [rad]."""
    c, b, a = pin.rpy.matrixToRpy(rotation)
    return float(a), float(b), float(c)


def _urdf(mass: float, centre: np.ndarray, tensor: np.ndarray, link: str) -> str:
    """A link that is fixed to the carrying one."""
    moments = " ".join(f'{key}="{tensor[k]:.9g}"' for key, k in TENSOR_ELEMENTS.items())
    return (
        f'<link name="payload"><inertial><origin xyz="{_words(centre)}"/>'
        f'<mass value="{mass:.9g}"/><inertia {moments}/></inertial></link>\n'
        f'<joint name="payload_joint" type="fixed"><parent link={quoteattr(link)}/>'
        '<child link="payload"/></joint>'
    )


def _mjcf(mass: float, centre: np.ndarray, tensor: np.ndarray, link: str) -> str:
    """A body inside the carrying one."""
    moments = [tensor[k] for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return (
        f"<!-- inside the body {xml_comment_text(link)} -->\n"
        f'<body name="payload"><inertial pos="{_words(centre)}" mass="{mass:.9g}" '
        f'fullinertia="{_words(moments)}"/></body>'
    )


def _words(values: object) -> str:
    return " ".join(f"{float(value):.9g}" for value in np.asarray(values, float))


def _list(values: object) -> str:
    return "[" + ", ".join(f"{float(value):.6g}" for value in np.asarray(values, float)) + "]"
