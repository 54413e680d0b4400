"""A URDF read for its mechanics alone: joints, links, inertias and limits; meshes are never
opened."""

from __future__ import annotations

import dataclasses
import math
import re
import unicodedata
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

from .. import physical_ranges as ranges
from ..errors import UnusableInput
from ..physical_ranges import Range
from . import exact_placement, xml_file

MOVABLE = ("revolute", "continuous", "prismatic")
MOST_LINKS = 1000
"""Largest number of links; Pinocchio's parser recurses once per link of a chain."""
NARROWEST = 1e-9
"""Narrowest range of positions that counts as one [rad or m]; lower = upper = 0 is how some URDFs
say that there is no limit."""
SHORTEST_AXIS = 1e-9
"""Length of an <axis xyz> below which it is no direction [1]."""
SHAPE_NUMBERS = ("xyz", "rpy", "rgba", "radius", "length", "size", "scale")
"""Attributes of <visual> and <collision> that hold numbers."""
SHOWN = 40
"""Characters of a name or a number that a message repeats."""


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
        """Unit of a quantity of this joint.

        Args:
            turning: The unit for a turning joint, such as "N m s/rad". A sliding one has N, m and
                kg for N m, rad and kg m²; its waves are per length.
        """
        if self.kind != "prismatic":
            return turning
        return {"kg m²": "kg", "1/turn": "rad/m"}.get(
            turning, turning.replace("N m", "N").replace("rad", "m")
        )


@dataclass(frozen=True)
class Urdf:
    """The mechanical content of a URDF, and a reduced text that Pinocchio parses without surprises.

    Attributes:
        source: Path of the file.
        text: The reduced URDF.
        exact_text: The same with exact placements; see `exact_placement`.
        rounded: Names of the joints, fixed ones too, whose placement differs between the two.
        name: Name of the robot.
        joints: The movable joints by name.
        links: Names of all links.
    """

    source: str
    text: str
    exact_text: str
    rounded: tuple[str, ...]
    name: str
    joints: dict[str, JointEntry]
    links: tuple[str, ...]


def read(path: Path) -> Urdf:
    """Parse the URDF at `path`.

    Raises:
        UnusableInput: The file is missing, is an unexpanded xacro, is no valid XML or is not in the
            encoding that it declares; it holds a number outside its `physical_ranges`; it has a
            joint of more than one degree of freedom; or its links form no tree.
    """
    if not is_file(path):
        raise UnusableInput(
            f"{path}: no such file; give a URDF's path or a name that 'excite robots' lists"
        )
    raw = xml_file.read_text(path, "a URDF")
    if raw.strip() and not raw.lstrip("\ufeff \t\r\n").startswith("<"):
        raise UnusableInput(
            f"{path}: is not a URDF; first comes the robot's URDF or a name that 'excite robots' "
            "lists"
        )
    # ROS macros are marked by the suffix, the root's namespace or the substitutions that only xacro
    # understands.
    bare = re.sub(r"<!--.*?-->", "", raw, flags=re.DOTALL)
    if path.suffix == ".xacro" or re.search(r"<xacro:|\$\{[^}]*\}|\$\((arg|find)\b", bare):
        raise UnusableInput(
            f"{path}: is a xacro file; expand it first: xacro {path.name} > {path.stem}.urdf"
        )
    root = xml_file.parse_text(path, raw)
    if root.tag != "robot":
        raise UnusableInput(f"{path}: its root is <{root.tag}>, not <robot>; give a URDF")
    source = str(path)
    links = tuple(_names(source, root, "link"))
    _names(source, root, "joint")
    if len(links) > MOST_LINKS:
        raise UnusableInput(
            f"{source}: has {len(links)} links, more than {MOST_LINKS}; leave out what does not "
            "belong to the robot"
        )
    joints, plain = {}, []
    for element in root.findall("joint"):
        entry = _joint(source, element)
        if entry is not None:
            joints[entry.name] = entry
        plain.append(_plain_joint(source, element, set(links)))
    _require_tree(source, root, links)
    bodies = [_plain_link(source, link) for link in root.findall("link")]
    name = _printable(source, "robot", root.get("name") or path.stem)
    exact = [joint.exact() for joint in plain]
    text, exact_text = (
        f'<robot name="{_escape(name)}">\n'
        + "\n".join([*(joint.text() for joint in stated), *bodies])
        + "\n</robot>\n"
        for stated in (plain, exact)
    )
    rounded = tuple(a.name for a, b in zip(plain, exact, strict=True) if a is not b)
    return Urdf(
        source=source,
        text=text,
        exact_text=exact_text,
        rounded=rounded,
        name=name,
        joints=joints,
        links=links,
    )


def is_file(path: Path) -> bool:
    """Look up a path: true for a regular file, false for others and for names that are too long."""
    try:
        return path.is_file()
    except OSError:
        return False


def _require_finite_shapes(source: str, link: ElementTree.Element) -> None:
    """Raise UnusableInput for a number of a link's shapes that is not finite.

    The shapes are not read here, but copied into the URDF of an identified robot.
    """
    for kind in ("visual", "collision"):
        for element in (inner for shape in link.findall(kind) for inner in shape.iter()):
            for key in SHAPE_NUMBERS:
                words = element.get(key, "").lower().split()
                if any(word.lstrip("+-") in ("nan", "inf", "infinity") for word in words):
                    raise UnusableInput(
                        f"{source}: link '{link.get('name')}', in its <{kind}>: "
                        f"'{element.get(key)}' "
                        "is not finite; correct it"
                    )


def _names(source: str, root: ElementTree.Element, tag: str) -> list[str]:
    """Names of all elements of a tag. Raises UnusableInput for one that is absent, occurs twice or
    cannot be printed."""
    names = [
        _printable(source, tag, _attribute(source, element, "name"))
        for element in root.findall(tag)
    ]
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise UnusableInput(f"{source}: two {tag}s are named '{name}'; rename one")
        seen.add(name)
    return names


def _printable(source: str, tag: str, name: str) -> str:
    """A name that fits on a line of a message, a table or a program. Raises UnusableInput for
    others."""
    if not name.strip():
        raise UnusableInput(f"{source}: a {tag} has an empty name; give it one")
    control = next(
        (letter for letter in name if unicodedata.category(letter) in ("Cc", "Zl", "Zp")), None
    )
    if control is not None:
        shown = name.encode("unicode_escape").decode("ascii")[:SHOWN]
        raise UnusableInput(
            f"{source}: {tag} '{shown}': its name has the control character U+{ord(control):04X}; "
            "rename it"
        )
    return name


def _require_tree(source: str, root: ElementTree.Element, links: tuple[str, ...]) -> None:
    """Raise UnusableInput unless the joints connect all links to one tree. Parsers in C++ crash on
    some of these."""
    if not links:
        raise UnusableInput(f"{source}: has no <link>; give the URDF of a robot")
    parent: dict[str, tuple[str, str]] = {}  # child link -> (joint, parent link)
    for element in root.findall("joint"):
        joint, (upper, lower) = str(element.get("name")), _ends(element)
        if lower in parent:
            other, upper_of_other = parent[lower]
            raise UnusableInput(
                f"{source}: joints '{other}' and '{joint}' both move link '{lower}', from "
                f"'{upper_of_other}' and '{upper}'; "
                "remove one of them: closed loops are not modelled"
            )
        parent[lower] = joint, upper
    roots = [link for link in links if link not in parent]
    if len(roots) > 1:
        raise UnusableInput(
            f"{source}: links '{roots[0]}' and '{roots[1]}' both have no parent; connect them by a "
            "fixed <joint>"
        )
    if not roots:
        joint, upper = parent[links[0]]
        raise UnusableInput(
            f"{source}: joint '{joint}' closes a loop from '{upper}' to '{links[0]}'; a robot "
            "needs a base link"
        )
    reached = {roots[0]}
    for start in links:
        link, way = start, list[str]()
        while link not in reached:
            joint, upper = parent[link]
            if link in way:
                raise UnusableInput(
                    f"{source}: joint '{joint}' closes a loop from '{upper}' to '{link}'; closed "
                    "loops are not modelled"
                )
            way.append(link)
            link = upper
        reached.update(way)


def _ends(element: ElementTree.Element) -> tuple[str, str]:
    """Names of a joint's parent and child link, "" where one is not stated."""
    parent, child = (element.find(tag) for tag in ("parent", "child"))
    return "" if parent is None else parent.get("link", ""), "" if child is None else child.get(
        "link", ""
    )


def _escape(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _attribute(source: str, element: ElementTree.Element, key: str) -> str:
    value = element.get(key)
    if value is None:
        raise UnusableInput(f"{source}: a <{element.tag}> has no attribute '{key}'; add it")
    return value


def numbers(source: str, owner: str, text: str, count: int, accepted: Range) -> list[float]:
    """Numbers of an attribute, separated by blanks.

    Args:
        source: The file, for messages.
        owner: What the attribute belongs to and its name, for messages: "joint 'a', axis".
        text: The attribute.
        count: How many numbers it should hold.
        accepted: The range of each.

    Raises:
        UnusableInput: The attribute holds something else.
    """
    shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
    try:
        values = [float(word) for word in text.split()]
    except ValueError as error:
        raise UnusableInput(
            f"{source}: {owner}: '{shown}' is not a list of numbers; correct it"
        ) from error
    if len(values) != count:
        raise UnusableInput(
            f"{source}: {owner}: '{shown}' should hold {count} number(s); correct it"
        )
    if not all(math.isfinite(value) for value in values):
        raise UnusableInput(f"{source}: {owner}: '{shown}' is not finite; correct it")
    if not all(accepted.accepts(value) for value in values):
        raise UnusableInput(f"{source}: {owner}: '{shown}' should be {accepted}; correct it")
    return values


def _number(
    source: str, owner: str, element: ElementTree.Element | None, key: str, accepted: Range
) -> float | None:
    text = None if element is None else element.get(key)
    return None if text is None else numbers(source, f"{owner}, {key}", text, 1, accepted)[0]


def _joint(source: str, element: ElementTree.Element) -> JointEntry | None:
    name = _attribute(source, element, "name")
    kind = _attribute(source, element, "type")
    owner = f"joint '{name}'"
    if kind == "fixed":
        return None
    if kind not in MOVABLE:
        raise UnusableInput(
            f"{source}: {owner} is of type '{kind}'; only {', '.join(MOVABLE)} and fixed joints "
            "are known"
        )
    limit, dynamics, mimic = element.find("limit"), element.find("dynamics"), element.find("mimic")
    position = None
    if kind != "continuous" and limit is not None:
        lower, upper = (
            _number(source, owner, limit, key, ranges.POSITION) for key in ("lower", "upper")
        )
        pair = (lower or 0.0, upper or 0.0)  # URDF: an omitted bound is 0
        position = pair if pair[1] - pair[0] >= NARROWEST else None
    follows = None
    if mimic is not None:
        multiplier = _number(source, owner, mimic, "multiplier", ranges.MIMIC_MULTIPLIER)
        offset = _number(source, owner, mimic, "offset", ranges.POSITION)
        follows = (
            _attribute(source, mimic, "joint"),
            1.0 if multiplier is None else multiplier,
            offset or 0.0,
        )
    extra = element.find("excite")
    return JointEntry(
        name=name,
        kind=kind,
        child=_ends(element)[1],
        position=position,
        velocity=_positive(_number(source, owner, limit, "velocity", ranges.VELOCITY)),
        torque=_positive(_number(source, owner, limit, "effort", ranges.EFFORT)),
        viscous=max(
            _number(source, owner, dynamics, "damping", ranges.VISCOUS_FRICTION) or 0.0, 0.0
        ),
        coulomb=max(
            _number(source, owner, dynamics, "friction", ranges.COULOMB_FRICTION) or 0.0, 0.0
        ),
        mimic=follows,
        rotor_inertia=max(
            _number(source, owner, extra, "rotor_inertia", ranges.ROTOR_INERTIA) or 0.0, 0.0
        ),
        offset=_number(source, owner, extra, "offset", ranges.EFFORT) or 0.0,
    )


def _positive(value: float | None) -> float | None:
    return value if value is not None and value > 0.0 else None


def _placement(
    source: str, owner: str, element: ElementTree.Element
) -> tuple[list[float], list[float]]:
    """Position [m] and roll, pitch, yaw [rad] of an element's <origin>."""
    origin = element.find("origin")
    given = {} if origin is None else origin.attrib
    xyz = numbers(source, f"{owner}, origin xyz", given.get("xyz", "0 0 0"), 3, ranges.LENGTH)
    rpy = numbers(source, f"{owner}, origin rpy", given.get("rpy", "0 0 0"), 3, ranges.ANGLE)
    return xyz, rpy


def _origin(xyz: list[float], rpy: list[float]) -> str:
    return f'<origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>'


def _words(values: list[float]) -> str:
    return " ".join(repr(value) for value in values)


@dataclass(frozen=True)
class _PlainJoint:
    """A joint with what Pinocchio needs and no more; a continuous one becomes revolute, so that
    nq = nv.

    Attributes:
        head: The joint's opening tag, parent and child.
        xyz: Position of its frame in the parent link's [m].
        rpy: Roll, pitch and yaw of its frame [rad].
        axis: Unit vector along which it moves, in its frame.
    """

    name: str
    head: str
    xyz: list[float]
    rpy: list[float]
    axis: list[float]

    def text(self) -> str:
        """The joint as an element of a URDF."""
        return (
            f"{self.head}{_origin(self.xyz, self.rpy)}"
            f'<axis xyz="{_words(self.axis)}"/>'
            '<limit lower="-1e9" upper="1e9" velocity="1e9" effort="1e9"/></joint>'
        )

    def exact(self) -> _PlainJoint:
        """The joint with its placement exact; itself where nothing is rounded."""
        xyz, rpy = exact_placement.exact_lengths(self.xyz), exact_placement.exact_angles(self.rpy)
        axis = exact_placement.exact_direction(self.axis)
        stated, exact = [*self.xyz, *self.rpy, *self.axis], [*xyz, *rpy, *axis]
        if not exact_placement.is_rounded(stated, exact):
            return self
        return dataclasses.replace(self, xyz=xyz, rpy=rpy, axis=axis)


def _plain_joint(source: str, element: ElementTree.Element, links: set[str]) -> _PlainJoint:
    name, kind = _attribute(source, element, "name"), _attribute(source, element, "type")
    owner = f"joint '{name}'"
    ends = []
    for tag, link in zip(("parent", "child"), _ends(element), strict=True):
        if link not in links:
            raise UnusableInput(
                f"{source}: {owner}: its {tag} link '{link}' is not defined; add the <link>"
            )
        ends.append(f'<{tag} link="{_escape(link)}"/>')
    axis_element = element.find("axis")
    direction = "1 0 0" if axis_element is None else axis_element.get("xyz", "1 0 0")
    axis = numbers(source, f"{owner}, axis", direction, 3, ranges.AXIS)
    length = math.hypot(*axis)
    if kind != "fixed" and length < SHORTEST_AXIS:
        raise UnusableInput(f"{source}: {owner}: its axis is zero; give a direction in <axis xyz>")
    unit = [value / length for value in axis] if length else [1.0, 0.0, 0.0]
    kind = "revolute" if kind == "continuous" else kind
    xyz, rpy = _placement(source, owner, element)
    head = f'<joint name="{_escape(name)}" type="{kind}">{ends[0]}{ends[1]}'
    return _PlainJoint(name, head, xyz, rpy, unit)


def _plain_link(source: str, element: ElementTree.Element) -> str:
    name = _attribute(source, element, "name")
    _require_finite_shapes(source, element)
    owner = f"link '{name}'"
    inertial = element.find("inertial")
    if inertial is None:
        return f'<link name="{_escape(name)}"/>'
    mass = _number(source, owner, inertial.find("mass"), "value", ranges.MASS) or 0.0
    tensor = inertial.find("inertia")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = [_number(source, owner, tensor, key, ranges.INERTIA) or 0.0 for key in keys]
    moments = " ".join(f'{key}="{value!r}"' for key, value in zip(keys, values, strict=True))
    return (
        f'<link name="{_escape(name)}"><inertial>{_origin(*_placement(source, owner, inertial))}'
        f'<mass value="{mass!r}"/><inertia {moments}/></inertial></link>'
    )
