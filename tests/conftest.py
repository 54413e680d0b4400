"""Fixtures and helpers: robots as URDF text, random robots, references by Pinocchio, designs."""

from __future__ import annotations

import os

os.environ["EXCITE_COMPILER"] = (
    ""  # compiling takes longer than the tests of a robot; test_casadi_batch.py compiles
)
os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # one thread per test process; it has to be set before numpy is imported

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from recording_fixtures import DamagedMotion, two_joint_motion

from excite.designer import certificate, pipeline
from excite.designer.certificate import Certificate
from excite.designer.identifiability import regressor_root
from excite.designer.options import DesignOptions
from excite.designer.pipeline import CertifiedDesign
from excite.identification.regression import IdentificationModel
from excite.robot.limits import Limits, from_sources, resolve
from excite.robot.robot import Robot, load, locate
from excite.robot.samples import Samples
from excite.trajectory.trajectory_file import Trajectory

pytest_plugins = ["slow_tests"]

settings.register_profile(
    "excite",
    deadline=None,
    derandomize=True,
    max_examples=10,
    database=None,
    suppress_health_check=list(HealthCheck),
)
settings.load_profile("excite")

BUILTIN = ("fr3", "iiwa14", "panda", "two_link", "tx40", "ur10e", "ur5e")
QUICK = DesignOptions(period=2.0, harmonics=3, samples=40, starts=1, iterations=40, jobs=1)

seeds = st.integers(0, 10**6).map(np.random.default_rng)


# -- robots as URDF text ----------------------------------------------------------------------


def words(values: np.ndarray | list[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def link(
    name: str,
    mass: float = 0.0,
    com: tuple[float, ...] = (0, 0, 0),
    tensor: np.ndarray | None = None,
    rpy: tuple[float, ...] = (0, 0, 0),
) -> str:
    if mass == 0.0 and tensor is None:
        return f'<link name="{name}"/>'
    I = np.eye(3) * 0.01 * mass if tensor is None else np.asarray(tensor)
    keys = {
        "ixx": (0, 0),
        "ixy": (0, 1),
        "ixz": (0, 2),
        "iyy": (1, 1),
        "iyz": (1, 2),
        "izz": (2, 2),
    }
    moments = " ".join(f'{key}="{float(I[at])!r}"' for key, at in keys.items())
    return (
        f'<link name="{name}"><inertial><origin xyz="{words(com)}" rpy="{words(rpy)}"/>'
        f'<mass value="{mass!r}"/><inertia {moments}/></inertial></link>'
    )


LIMIT = '<limit lower="-2" upper="2.5" velocity="3" effort="40"/>'


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    xyz: tuple[float, ...] = (0, 0, 0),
    rpy: tuple[float, ...] = (0, 0, 0),
    axis: tuple[float, ...] = (0, 0, 1),
    inside: str = LIMIT,
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{words(xyz)}" rpy="{words(rpy)}"/><axis xyz="{words(axis)}"/>'
        f"{inside}</joint>"
    )


def document(*parts: str) -> str:
    return '<robot name="thing">\n' + "\n".join(parts) + "\n</robot>\n"


def pendulum(
    inside: str = LIMIT,
    kind: str = "revolute",
    axis: tuple[float, ...] = (0, 1, 0),
    body: str | None = None,
) -> str:
    return document(
        link("base"),
        body or link("arm", 2.0, (0.3, 0.0, 0.0)),
        joint("swing", "base", "arm", kind, axis=axis, inside=inside),
    )


def random_urdf(
    rng: np.random.Generator,
    count: int = 4,
    *,
    kinds: tuple[str, ...] = ("revolute", "continuous", "prismatic"),
    tree: bool = True,
    tidy: bool = False,
    mimics: dict[int, tuple[int, float, float]] | None = None,
) -> str:
    """Return a random robot with joints j0, j1, … and a fixed tool on the last link.

    Args:
        rng: Generator of the draw.
        count: Number of joints.
        kinds: Joint types to choose from.
        tree: True if links may branch.
        tidy: True if axes and offsets are mostly along x, y, z, as in real arms.
        mimics: By joint: the joint that it mimics, multiplier and offset.
    """
    parts = [link("l"), random_link(rng, "tool")]
    for i in range(count):
        parent = "l" if i == 0 else f"l{rng.integers(i) if tree else i - 1}"
        inside = LIMIT
        if mimics and i in mimics:
            master, multiplier, offset = mimics[i]
            inside += f'<mimic joint="j{master}" multiplier="{multiplier!r}" offset="{offset!r}"/>'
        parts.append(random_link(rng, f"l{i}"))
        parts.append(
            joint(
                f"j{i}",
                parent,
                f"l{i}",
                str(rng.choice(kinds)),
                *random_placement(rng, tidy),
                inside=inside,
            )
        )
    parts.append(joint("mount", f"l{count - 1}", "tool", "fixed", *random_placement(rng, False)))
    return document(*parts)


def random_placement(rng: np.random.Generator, tidy: bool) -> tuple[tuple[float, ...], ...]:
    if not tidy:
        return (
            tuple(rng.uniform(-0.5, 0.5, 3)),
            tuple(rng.uniform(-3, 3, 3)),
            tuple(rng.normal(size=3)),
        )
    xyz = rng.choice([0.0, 0.0, 0.3, -0.2], 3)
    return (
        tuple(xyz),
        tuple(rng.integers(-1, 3, 3) * np.pi / 2),
        tuple(np.eye(3)[rng.integers(3)] * rng.choice([-1, 1])),
    )


def random_link(rng: np.random.Generator, name: str) -> str:
    return link(
        name,
        rng.uniform(0.5, 5.0),
        tuple(rng.uniform(-0.2, 0.2, 3)),
        random_tensor(rng),
        tuple(rng.uniform(-3, 3, 3)),
    )


def random_tensor(rng: np.random.Generator) -> np.ndarray:
    root = rng.uniform(-0.1, 0.1, (3, 3))
    second = root @ root.T + 1e-3 * np.eye(3)
    return np.trace(second) * np.eye(3) - second


def random_body(rng: np.random.Generator) -> np.ndarray:
    """Return the ten parameters of a physically consistent body."""
    return pin.Inertia(
        rng.uniform(0.5, 5.0), rng.uniform(-0.2, 0.2, 3), random_tensor(rng)
    ).toDynamicParameters()


def loaded(text: str, **options: object) -> Robot:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        path.write_text(text, encoding="utf-8")
        return load(str(path), **options)  # type: ignore[arg-type]


def text_of(name: str) -> str:
    return locate(name).read_text(encoding="utf-8")


def write_obj(path: Path, vertices: np.ndarray, triangles: np.ndarray) -> str:
    """Write a mesh and return its path."""
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


# -- equal physics in other frames ---------------------------------------------------------


def reframed(text: str, rng: np.random.Generator) -> str:
    """Return the same robot with link frames rotated and shifted along the joint axes."""
    root = ElementTree.fromstring(text)
    moved = {
        element.find("child").get("link"): _new_frame(element, rng)
        for element in root.findall("joint")
    }
    for element in root.findall("joint"):
        before = moved.get(element.find("parent").get("link"), pin.SE3.Identity())
        after = moved[element.find("child").get("link")]
        _place(element, before.actInv(_placement(element) * after))
        axis = element.find("axis")
        if axis is not None:
            axis.set("xyz", words(after.rotation.T @ _vector(axis.get("xyz"))))
    for element in root.findall("link"):
        inertial = element.find("inertial")
        if inertial is not None:
            _place(
                inertial,
                moved.get(element.get("name"), pin.SE3.Identity()).actInv(_placement(inertial)),
            )
    return ElementTree.tostring(root, encoding="unicode")


def _new_frame(element: ElementTree.Element, rng: np.random.Generator) -> pin.SE3:
    turn = pin.exp3(rng.normal(size=3))
    if element.get("type") == "fixed":
        return pin.SE3.Identity()
    axis = _vector(element.find("axis").get("xyz"))
    return pin.SE3(turn, rng.uniform(-0.4, 0.4) * axis / np.linalg.norm(axis))


def _vector(text: str | None) -> np.ndarray:
    return np.array((text or "0 0 0").split(), float)


def _placement(element: ElementTree.Element) -> pin.SE3:
    origin = element.find("origin")
    if origin is None:
        return pin.SE3.Identity()
    return pin.SE3(pin.rpy.rpyToMatrix(_vector(origin.get("rpy"))), _vector(origin.get("xyz")))


def _place(element: ElementTree.Element, where: pin.SE3) -> None:
    origin = element.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(element, "origin")
    origin.set("xyz", words(where.translation))
    origin.set("rpy", words(pin.rpy.matrixToRpy(where.rotation)))


# -- motion and numbers -----------------------------------------------------------------------


def states(n: int, count: int = 6, seed: int = 0, speed: float = 2.0) -> Samples:
    rng = np.random.default_rng(seed)
    return Samples(
        rng.uniform(-2, 2, (count, n)),
        speed * rng.normal(size=(count, n)),
        5.0 * rng.normal(size=(count, n)),
    )


def raw_torque(
    text: str, joints: tuple[str, ...], motion: Samples, gravity: tuple[float, ...] = (0, 0, -9.81)
) -> np.ndarray:
    """Return Pinocchio's torque for a URDF as it stands; mimic joints move freely.

    A continuous joint has two coordinates there.
    """
    model = pin.buildModelFromXML(text)
    model.gravity.linear = np.array(gravity, float)
    data = model.createData()
    at = [model.joints[model.getJointId(name)] for name in joints]
    out = np.empty(motion.q.shape)
    for t in range(len(motion)):
        q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for i, entry in enumerate(at):
            angle = motion.q[t, i]
            q[entry.idx_q : entry.idx_q + entry.nq] = (
                (np.cos(angle), np.sin(angle)) if entry.nq == 2 else angle
            )
            v[entry.idx_v], a[entry.idx_v] = motion.dq[t, i], motion.ddq[t, i]
        torque = pin.rnea(model, data, q, v, a)
        out[t] = [torque[entry.idx_v] for entry in at]
    return out


def slope(function: Callable[[float], np.ndarray], h: float) -> np.ndarray:
    """Return the derivative at 0 by central differences with one Richardson step: error O(h⁴)."""
    coarse = (np.asarray(function(h)) - function(-h)) / (2 * h)
    fine = (np.asarray(function(h / 2)) - function(-h / 2)) / h
    return (4.0 * fine - coarse) / 3.0


def off(actual: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest deviation relative to the largest expected entry."""
    actual, expected = np.asarray(actual), np.asarray(expected)
    assert actual.shape == expected.shape
    return float(np.abs(actual - expected).max() / np.abs(expected).max())


def information_of(Y: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return Σₜ Yᵀ Σ⁻¹ Y."""
    root = regressor_root(Y, noise)
    return root.T @ root


def verified(trajectory: Trajectory) -> Certificate:
    """Verify a trajectory against the sources of its limits and its cell."""
    robot = trajectory.load_robot()
    limits = from_sources(robot, trajectory.limits)
    return certificate.verify_with_cell_on_disk(trajectory, robot, limits)


# -- designs, computed once per process -------------------------------------------------------


@pytest.fixture(scope="session")
def two_link() -> Robot:
    return load("two_link")


@pytest.fixture(scope="session")
def subject() -> IdentificationModel:
    """Two-link robot of the tests of the diagnosis."""
    from synthetic_recordings import two_link_model  # which takes from here

    return two_link_model()


@pytest.fixture
def damage() -> DamagedMotion:
    return DamagedMotion(two_joint_motion())


@pytest.fixture(scope="session")
def table(two_link: Robot) -> Limits:
    return resolve(two_link)


@pytest.fixture(scope="session")
def delivery(two_link: Robot, table: Limits) -> CertifiedDesign:
    return pipeline.design_trajectory(two_link, table, QUICK, start=np.array([-1.5, 0.3]))


@pytest.fixture(scope="session")
def braked() -> CertifiedDesign:
    """Three joints of the FR3, whose speed limits depend on position."""
    robot = load("fr3", joints=("fr3_joint1", "fr3_joint2", "fr3_joint4"))
    return pipeline.design_trajectory(robot, resolve(robot), replace(QUICK, period=4.0, samples=60))
