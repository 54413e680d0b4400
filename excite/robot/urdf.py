"""A URDF read for its mechanics alone: joints, links, inertias and limits; meshes are never
opened."""

from __future__ import annotations

import dataclasses
import math
import unicodedata
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from .. import physical_ranges as ranges
from ..errors import UnusableInput, UnusableRobot
from ..physical_ranges import Range
from . import exact_placement, source_text, xml_file
from .link_inertia import LinkInertia

MOVABLE = ("revolute", "continuous", "prismatic")
MOST_LINKS = 1000
"""Largest number of links; Pinocchio's parser recurses once per link of a chain."""
NARROWEST_RANGE = 1e-9
"""Narrowest range of positions that counts as one [rad or m]; lower = upper = 0 is how some URDFs
say that there is no limit."""
WIDEST_RANGE = 8.0 * math.pi
"""Widest range of a revolute joint that is believed [rad]: four turns. Wrists of industrial robots
turn by up to 2.5; ranges in degrees begin at ±12.6°, and a design needs no more than a turn."""
ALIAS_SUFFIX = "#link"
"""Appended to the name of a link that is also a joint's, which Pinocchio confuses."""
SHORTEST_AXIS = 1e-9
"""Length of an <axis xyz> below which it is no direction [1]."""
SHAPE_NUMBERS = ("xyz", "rpy", "rgba", "radius", "length", "size", "scale")
"""Attributes of <visual> and <collision> that hold numbers."""
SHOWN = 40
"""Characters of a name or a number that a message repeats."""


@dataclass(frozen=True)
class JointEntry:
    """One movable joint as the URDF states it; a limit that is absent or unusable is None.

    Attributes:
        name: Name of the joint.
        kind: "revolute", "continuous" or "prismatic".
        child: Name of the link that it moves.
        position: Lower and upper limit [rad or m].
        velocity: Limit of the speed [rad/s or m/s].
        torque: Limit of the torque or force [N m or N].
        viscous: Viscous friction [N m s/rad or N s/m].
        coulomb: Coulomb friction [N m or N].
        mimic: Joint that it follows, multiplier and offset; None for other joints.
        rotor_inertia: Reflected inertia of the rotor, from an <excite> element, as URDF has none
            [kg m² or kg].
        offset: Constant torque, from an <excite> element [N m or N].
        soft_position: The position limit narrowed by the <safety_controller>; None where it does
            not narrow it.
        unusable: For each stated limit that cannot be used the reason.
    """

    name: str
    kind: str
    child: str
    position: tuple[float, float] | None
    velocity: float | None
    torque: float | None
    viscous: float
    coulomb: float
    mimic: tuple[str, float, float] | None
    rotor_inertia: float = 0.0
    offset: float = 0.0
    soft_position: tuple[float, float] | None = None
    unusable: Mapping[str, str] = field(default_factory=dict)

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
    """The mechanical content of a URDF.

    Attributes:
        source: Path of the file.
        name: Name of the robot.
        joints: The movable joints by name.
        links: Names of all links.
        placements: Placement of all joints, fixed ones too.
        inertias: Inertia of the links that state one.
        remarks: Sentences on what was ignored.
        is_mjcf: True if the file is an MJCF.
    """

    source: str
    name: str
    joints: dict[str, JointEntry]
    links: tuple[str, ...]
    placements: tuple[JointPlacement, ...]
    inertias: dict[str, LinkInertia]
    remarks: tuple[str, ...]
    is_mjcf: bool = False

    @property
    def rounded(self) -> tuple[str, ...]:
        """Names of the joints, fixed ones too, whose placement is rounded; see
        `exact_placement`."""
        return tuple(joint.name for joint in self.placements if joint.exact() is not joint)

    @property
    def reach(self) -> float:
        """Sum of the lengths of the joint offsets [m]."""
        return sum(math.hypot(*joint.xyz) for joint in self.placements)

    def alias(self, link: str) -> str:
        """Name of a link in `text`: another one where a joint has the same name."""
        joints = {joint.name for joint in self.placements}
        alias = link
        while alias in joints:
            alias += ALIAS_SUFFIX
        return alias

    def text(self, *, exact: bool = False) -> str:
        """A URDF of joints and inertias alone, which Pinocchio parses without surprises.

        Args:
            exact: Whether placements are exact; see `exact_placement`.
        """
        aliases = {link: _escape(self.alias(link)) for link in self.links}
        joints = [joint.exact() if exact else joint for joint in self.placements]
        return "\n".join(
            [
                f'<robot name="{_escape(self.name)}">',
                *(joint.text(aliases) for joint in joints),
                *(_link_text(aliases[link], self.inertias.get(link)) for link in self.links),
                "</robot>\n",
            ]
        )


def read(path: Path) -> Urdf:
    """Parse the URDF, or the file of another format that can be converted to one, at `path`.

    Raises:
        UnusableRobot: Joints or links have faults: a number outside its `physical_ranges`, a joint
            of more than one degree of freedom.
        UnusableInput: The file is missing, is no valid XML or is not in the encoding that it
            declares; or its links form no tree.
    """
    converted = source_text.read_robot(path)
    raw = converted.text
    root = xml_file.parse_text(path, raw)
    source = str(path)
    links = tuple(_names(source, root, "link"))
    _names(source, root, "joint")
    if len(links) > MOST_LINKS:
        raise UnusableInput(
            f"{source}: has {len(links)} links, more than {MOST_LINKS}; leave out what does not "
            "belong to the robot"
        )
    name = _printable(source, "robot", root.get("name") or path.stem)
    faults: list[str] = []
    joints: dict[str, JointEntry] = {}
    placements: list[JointPlacement] = []
    inertias: dict[str, LinkInertia] = {}
    for element in root.findall("joint"):
        with _collected(faults):
            placement = _placement_of(source, element, set(links))
            entry = _joint(source, element)
            placements.append(placement)
            if entry is not None:
                joints[entry.name] = entry
    for element in root.findall("link"):
        with _collected(faults):
            inertia = _inertia_of(source, element)
            if inertia is not None:
                inertias[str(element.get("name"))] = inertia
    if faults:
        raise UnusableRobot(faults)
    _require_tree(source, root, links)
    undeclared = xml_file.undeclared_prefixes(raw)
    remarks = [
        f"{source}: elements and attributes of the undeclared XML prefix '{prefix}' are ignored"
        for prefix in undeclared
    ]
    remarks += converted.remarks
    return Urdf(
        source,
        name,
        joints,
        links,
        tuple(placements),
        inertias,
        tuple(remarks),
        converted.is_mjcf,
    )


@contextmanager
def _collected(faults: list[str]) -> Iterator[None]:
    """Append the message of an UnusableInput to a list instead of raising it."""
    try:
        yield
    except UnusableInput as error:
        faults.append(str(error))


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
    if tag == "joint" and name != name.strip():
        raise UnusableInput(
            f"{source}: joint '{name}': its name begins or ends with a space, which columns of "
            "recordings do not; rename it"
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
            "are known; correct its type"
        )
    limit, dynamics, mimic = element.find("limit"), element.find("dynamics"), element.find("mimic")
    unusable: dict[str, str] = {}
    position = None
    if kind != "continuous" and limit is not None:
        position = _position(source, owner, kind, limit, unusable)
    speed = _number(source, owner, limit, "velocity", ranges.VELOCITY)
    effort = _number(source, owner, limit, "effort", ranges.EFFORT)
    for quantity, value in (("velocity", speed), ("torque", effort)):
        if value is not None and value <= 0.0:
            unusable[quantity] = f"it states {value:g}"
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
        velocity=_positive(speed),
        torque=_positive(effort),
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
        soft_position=_soft_position(source, owner, element, position, unusable),
        unusable=unusable,
    )


def _position(
    source: str, owner: str, kind: str, limit: ElementTree.Element, unusable: dict[str, str]
) -> tuple[float, float] | None:
    """Position limits of a joint that has some; of others None, with the reason in `unusable`."""
    accepted = ranges.POSITION if kind == "prismatic" else ranges.STATED_POSITION
    lower, upper = (
        _number(source, owner, limit, key, accepted) or 0.0 for key in ("lower", "upper")
    )  # URDF: an omitted bound is 0
    if upper - lower < NARROWEST_RANGE:
        if lower or upper:
            unusable["position"] = f"it states {lower:g} to {upper:g}"
        return None
    if kind != "prismatic" and upper - lower > WIDEST_RANGE:
        unusable["position"] = range_in_turns((lower, upper))
        return None
    return lower, upper


def range_in_turns(position: tuple[float, float]) -> str:
    """A range of angles in words that doubt it: "from -177 to 177 rad is 56 turns (degrees?)"."""
    lower, upper = position
    turns = (upper - lower) / (2.0 * math.pi)
    return f"from {lower:g} to {upper:g} rad is {turns:.3g} turns (degrees?)"


def _soft_position(
    source: str,
    owner: str,
    element: ElementTree.Element,
    position: tuple[float, float] | None,
    unusable: dict[str, str],
) -> tuple[float, float] | None:
    """Position limits within the soft limits of a <safety_controller>, at which a controller that
    reads it stops the joint; None where they do not narrow the range."""
    safety = element.find("safety_controller")
    if safety is None or position is None:
        return None
    lower, upper = (
        _number(source, owner, safety, key, ranges.STATED_POSITION) or 0.0
        for key in ("soft_lower_limit", "soft_upper_limit")
    )
    if not lower < upper or (lower <= position[0] and upper >= position[1]):
        return None  # no soft limits are stated, or wider ones
    narrowed = max(lower, position[0]), min(upper, position[1])
    if narrowed[1] - narrowed[0] < NARROWEST_RANGE:
        unusable["soft position"] = f"the safety_controller states {lower:g} to {upper:g}"
        return None
    return narrowed


def _positive(value: float | None) -> float | None:
    return value if value is not None and value > 0.0 else None


def _placement(
    source: str, owner: str, element: ElementTree.Element
) -> tuple[list[float], list[float]]:
    """Position [m] and roll, pitch, yaw [rad] of an element's <origin>."""
    stated = {name: _origin_attribute(element, name) for name in ("xyz", "rpy")}
    xyz = numbers(source, f"{owner}, origin xyz", stated["xyz"], 3, ranges.LENGTH)
    rpy = numbers(source, f"{owner}, origin rpy", stated["rpy"], 3, ranges.ANGLE)
    return xyz, rpy


def _origin_attribute(element: ElementTree.Element, name: str) -> str:
    """Three numbers of an element's <origin>, as they are printed."""
    origin = element.find("origin")
    return "0 0 0" if origin is None else origin.get(name, "0 0 0")


def _origin(xyz: Sequence[float], rpy: Sequence[float]) -> str:
    return f'<origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>'


def _words(values: Sequence[float]) -> str:
    return " ".join(repr(value) for value in values)


@dataclass(frozen=True)
class JointPlacement:
    """Where a joint is, and along which axis it moves.

    Attributes:
        name: Name of the joint.
        kind: Its type in a URDF.
        parent: Name of its parent link.
        child: Name of its child link.
        xyz: Position of its frame in the parent link's [m].
        rpy: Roll, pitch and yaw of its frame [rad].
        axis: Unit vector along which it moves, in its frame.
        tolerances: Tolerances of the angles, see `exact_placement.angle_tolerance` [rad].
    """

    name: str
    kind: str
    parent: str
    child: str
    xyz: list[float]
    rpy: list[float]
    axis: list[float]
    tolerances: list[float]

    def text(self, links: Mapping[str, str]) -> str:
        """The joint as an element of a URDF; a continuous one is revolute, so that nq = nv.

        Args:
            links: Escaped names of the links in that URDF.
        """
        kind = "revolute" if self.kind == "continuous" else self.kind
        return (
            f'<joint name="{_escape(self.name)}" type="{kind}">'
            f'<parent link="{links[self.parent]}"/><child link="{links[self.child]}"/>'
            f"{_origin(self.xyz, self.rpy)}"
            f'<axis xyz="{_words(self.axis)}"/>'
            '<limit lower="-1e9" upper="1e9" velocity="1e9" effort="1e9"/></joint>'
        )

    def exact(self) -> JointPlacement:
        """The joint with its placement exact; itself where nothing is rounded."""
        xyz = exact_placement.exact_lengths(self.xyz)
        rpy = exact_placement.exact_angles(self.rpy, self.tolerances)
        axis = exact_placement.exact_direction(self.axis)
        stated, exact = [*self.xyz, *self.rpy, *self.axis], [*xyz, *rpy, *axis]
        if not exact_placement.is_rounded(stated, exact):
            return self
        return dataclasses.replace(self, xyz=xyz, rpy=rpy, axis=axis)


def _placement_of(source: str, element: ElementTree.Element, links: set[str]) -> JointPlacement:
    name, kind = _attribute(source, element, "name"), _attribute(source, element, "type")
    owner = f"joint '{name}'"
    parent, child = _ends(element)
    for tag, link in (("parent", parent), ("child", child)):
        if link not in links:
            raise UnusableInput(
                f"{source}: {owner}: its {tag} link '{link}' is not defined; add the <link>"
            )
    axis_element = element.find("axis")
    direction = "1 0 0" if axis_element is None else axis_element.get("xyz", "1 0 0")
    axis = numbers(source, f"{owner}, axis", direction, 3, ranges.AXIS)
    length = math.hypot(*axis)
    if kind != "fixed" and length < SHORTEST_AXIS:
        raise UnusableInput(f"{source}: {owner}: its axis is zero; give a direction in <axis xyz>")
    unit = [value / length for value in axis] if length else [1.0, 0.0, 0.0]
    xyz, rpy = _placement(source, owner, element)
    printed = _origin_attribute(element, "rpy").split()
    tolerances = [exact_placement.angle_tolerance(number) for number in printed]
    return JointPlacement(name, kind, parent, child, xyz, rpy, unit, tolerances)


def _inertia_of(source: str, element: ElementTree.Element) -> LinkInertia | None:
    """Inertia of a link; None where it states none."""
    name = _attribute(source, element, "name")
    _require_finite_shapes(source, element)
    owner = f"link '{name}'"
    inertial = element.find("inertial")
    if inertial is None:
        return None
    mass = _number(source, owner, inertial.find("mass"), "value", ranges.MASS) or 0.0
    tensor = inertial.find("inertia")
    keys = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
    moments = [_number(source, owner, tensor, key, ranges.INERTIA) or 0.0 for key in keys]
    xyz, rpy = _placement(source, owner, inertial)
    return LinkInertia(mass, tuple(xyz), tuple(moments), tuple(rpy))  # type: ignore[arg-type]


def _link_text(name: str, inertia: LinkInertia | None) -> str:
    if inertia is None:
        return f'<link name="{name}"/>'
    xx, xy, yy, xz, yz, zz = inertia.tensor
    return (
        f'<link name="{name}"><inertial>{_origin(inertia.centre, inertia.rpy)}'
        f'<mass value="{inertia.mass!r}"/><inertia ixx="{xx!r}" ixy="{xy!r}" ixz="{xz!r}" '
        f'iyy="{yy!r}" iyz="{yz!r}" izz="{zz!r}"/></inertial></link>'
    )
