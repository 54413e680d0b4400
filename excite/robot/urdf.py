"""A URDF read for its mechanics alone: joints, links, inertias and limits; meshes are never opened."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

from ..errors import UnusableInput

MOVABLE = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class JointEntry:
    """One movable joint as the URDF states it; a limit that is absent, zero or inverted is None."""

    name: str
    kind: str
    child: str
    position: tuple[float, float] | None
    velocity: float | None
    torque: float | None
    viscous: float
    coulomb: float
    mimic: tuple[str, float, float] | None  # (master, multiplier, offset)
    rotor_inertia: float = 0.0  # this and the next by <excite>, for which URDF has no words
    offset: float = 0.0

    def unit(self, turning: str) -> str:
        """What stands for a turning joint's unit: of a sliding one N, m and kg for N m, rad and kg m²; its angles of waves are m too."""
        if self.kind != "prismatic":
            return turning
        return {"kg m²": "kg", "1/turn": "rad/m"}.get(
            turning, turning.replace("N m", "N").replace("rad", "m")
        )


@dataclass(frozen=True)
class Urdf:
    """The mechanical content of a URDF, and a reduced text that Pinocchio parses without surprises."""

    source: str
    text: str
    name: str
    joints: dict[str, JointEntry]
    links: tuple[str, ...]


def read(path: Path) -> Urdf:
    """Parse the URDF at `path`.

    Raises UnusableInput when the file is missing, is an unexpanded xacro, is no valid XML, holds a number that
    is not finite, or has a joint of more than one degree of freedom.
    """
    if not path.is_file():
        raise UnusableInput(
            f"{path}: no such file; give a URDF's path or a name that 'excite robots' lists"
        )
    raw = path.read_text(encoding="utf-8", errors="replace")
    if raw.strip() and not raw.lstrip("\ufeff \t\r\n").startswith("<"):
        raise UnusableInput(
            f"{path}: is not a URDF; first comes the robot's URDF or a name that 'excite robots' lists"
        )
    # ROS macros are marked by the suffix, the root's namespace or the substitutions that only xacro understands.
    bare = re.sub(r"<!--.*?-->", "", raw, flags=re.DOTALL)
    if path.suffix == ".xacro" or re.search(r"<xacro:|\$\{[^}]*\}|\$\((arg|find)\b", bare):
        raise UnusableInput(
            f"{path}: is a xacro file; expand it first: xacro {path.name} > {path.stem}.urdf"
        )
    try:
        root = ElementTree.fromstring(raw)
    except ElementTree.ParseError as error:
        raise UnusableInput(
            f"{path}: is not valid XML ({error}); repair the file or export it again"
        ) from error
    if root.tag != "robot":
        raise UnusableInput(f"{path}: its root is <{root.tag}>, not <robot>; give a URDF")
    source = str(path)
    links = tuple(_attribute(source, link, "name") for link in root.findall("link"))
    for tag in ("link", "joint"):
        names = [_attribute(source, element, "name") for element in root.findall(tag)]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise UnusableInput(f"{source}: two {tag}s are named '{twice}'; rename one")
    joints, elements = {}, []
    for element in root.findall("joint"):
        entry = _joint(source, element)
        if entry is not None:
            joints[entry.name] = entry
        elements.append(_plain_joint(source, element, set(links)))
    elements += [_plain_link(source, link) for link in root.findall("link")]
    name = root.get("name") or path.stem
    text = f'<robot name="{_escape(name)}">\n' + "\n".join(elements) + "\n</robot>\n"
    return Urdf(source=source, text=text, name=name, joints=joints, links=links)


def _escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _attribute(source: str, element: ElementTree.Element, key: str) -> str:
    value = element.get(key)
    if value is None:
        raise UnusableInput(f"{source}: a <{element.tag}> has no attribute '{key}'; add it")
    return value


def _numbers(source: str, owner: str, text: str, count: int) -> list[float]:
    try:
        values = [float(word) for word in text.split()]
    except ValueError as error:
        raise UnusableInput(
            f"{source}: {owner}: '{text}' is not a list of numbers; correct it"
        ) from error
    if len(values) != count:
        raise UnusableInput(
            f"{source}: {owner}: '{text}' should hold {count} number(s); correct it"
        )
    if not all(math.isfinite(value) for value in values):
        raise UnusableInput(f"{source}: {owner}: '{text}' is not finite; correct it")
    return values


def _number(source: str, owner: str, element: ElementTree.Element | None, key: str) -> float | None:
    text = None if element is None else element.get(key)
    return None if text is None else _numbers(source, f"{owner}, {key}", text, 1)[0]


def _joint(source: str, element: ElementTree.Element) -> JointEntry | None:
    name = _attribute(source, element, "name")
    kind = _attribute(source, element, "type")
    owner = f"joint '{name}'"
    if kind == "fixed":
        return None
    if kind not in MOVABLE:
        raise UnusableInput(
            f"{source}: {owner} is of type '{kind}'; only {', '.join(MOVABLE)} and fixed joints are known"
        )
    child = element.find("child")
    limit, dynamics, mimic = element.find("limit"), element.find("dynamics"), element.find("mimic")
    lower, upper = _number(source, owner, limit, "lower"), _number(source, owner, limit, "upper")
    position = None
    if kind != "continuous" and limit is not None and (lower is not None or upper is not None):
        pair = (lower or 0.0, upper or 0.0)  # URDF: an omitted bound is 0
        position = pair if pair[0] < pair[1] else None
    follows = None
    if mimic is not None:
        multiplier, offset = (
            _number(source, owner, mimic, "multiplier"),
            _number(source, owner, mimic, "offset"),
        )
        follows = (
            _attribute(source, mimic, "joint"),
            1.0 if multiplier is None else multiplier,
            offset or 0.0,
        )
    return JointEntry(
        name=name,
        kind=kind,
        child="" if child is None else _attribute(source, child, "link"),
        position=position,
        velocity=_positive(_number(source, owner, limit, "velocity")),
        torque=_positive(_number(source, owner, limit, "effort")),
        viscous=max(_number(source, owner, dynamics, "damping") or 0.0, 0.0),
        coulomb=max(_number(source, owner, dynamics, "friction") or 0.0, 0.0),
        mimic=follows,
        rotor_inertia=max(
            _number(source, owner, element.find("excite"), "rotor_inertia") or 0.0, 0.0
        ),
        offset=_number(source, owner, element.find("excite"), "offset") or 0.0,
    )


def _positive(value: float | None) -> float | None:
    return value if value is not None and value > 0.0 else None


def _origin(source: str, owner: str, element: ElementTree.Element) -> str:
    origin = element.find("origin")
    xyz = _numbers(
        source, f"{owner}, origin xyz", "0 0 0" if origin is None else origin.get("xyz", "0 0 0"), 3
    )
    rpy = _numbers(
        source, f"{owner}, origin rpy", "0 0 0" if origin is None else origin.get("rpy", "0 0 0"), 3
    )
    return f'<origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>'


def _words(values: list[float]) -> str:
    return " ".join(repr(value) for value in values)


def _plain_joint(source: str, element: ElementTree.Element, links: set[str]) -> str:
    """The joint with what Pinocchio needs and no more; a continuous one becomes revolute, so that nq = nv."""
    name, kind = _attribute(source, element, "name"), _attribute(source, element, "type")
    owner = f"joint '{name}'"
    ends = []
    for tag in ("parent", "child"):
        end = element.find(tag)
        link = None if end is None else _attribute(source, end, "link")
        if link not in links:
            raise UnusableInput(
                f"{source}: {owner}: its {tag} link {link!r} is not defined; add the <link>"
            )
        ends.append(f'<{tag} link="{_escape(str(link))}"/>')
    axis_element = element.find("axis")
    axis = _numbers(
        source,
        f"{owner}, axis",
        "1 0 0" if axis_element is None else axis_element.get("xyz", "1 0 0"),
        3,
    )
    length = math.hypot(*axis)
    if kind != "fixed" and length < 1e-9:
        raise UnusableInput(f"{source}: {owner}: its axis is zero; give a direction in <axis xyz>")
    unit = [value / length for value in axis] if length else [1.0, 0.0, 0.0]
    kind = "revolute" if kind == "continuous" else kind
    return (
        f'<joint name="{_escape(name)}" type="{kind}">{ends[0]}{ends[1]}{_origin(source, owner, element)}'
        f'<axis xyz="{_words(unit)}"/><limit lower="-1e9" upper="1e9" velocity="1e9" effort="1e9"/></joint>'
    )


def _plain_link(source: str, element: ElementTree.Element) -> str:
    name = _attribute(source, element, "name")
    owner = f"link '{name}'"
    inertial = element.find("inertial")
    if inertial is None:
        return f'<link name="{_escape(name)}"/>'
    mass = _number(source, owner, inertial.find("mass"), "value") or 0.0
    tensor = inertial.find("inertia")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = [_number(source, owner, tensor, key) or 0.0 for key in keys]
    moments = " ".join(f'{key}="{value!r}"' for key, value in zip(keys, values, strict=True))
    return (
        f'<link name="{_escape(name)}"><inertial>{_origin(source, owner, inertial)}'
        f'<mass value="{mass!r}"/><inertia {moments}/></inertial></link>'
    )
