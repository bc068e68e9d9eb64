"""What a URDF says about motion: links, joints, the way between two links, and which joints mimic others.

The parser is urdfdom-py, the ROS project's own: it needs lxml alone, and keeps origins as they are written. It is given
links and joints only, so meshes are never looked at.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NoReturn

from eiwa.core.chain import Kind, Mimic
from eiwa.core.errors import SpecError, finding

KINDS: Mapping[str, Kind] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
}
READ = {
    "link": ("name",),
    "joint": ("name", "type"),
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "parent": ("link",),
    "child": ("link",),
    "limit": ("lower", "upper"),
    "mimic": ("joint", "multiplier", "offset"),
}
"""Elements and attributes that matter to motion."""
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class FileJoint:
    """A joint as it is written: origin [m, rad], axis, limits [rad or m], what it mimics."""

    name: str
    type: str
    parent: str
    child: str
    xyz: Vector
    rpy: Vector
    axis: Vector
    limits: tuple[float, float] | None
    mimic: Mimic | None


@dataclass(frozen=True)
class Model:
    """Links and joints of a file; ``above`` is the joint that a link is the child of."""

    links: tuple[str, ...]
    joints: Mapping[str, FileJoint]
    above: Mapping[str, FileJoint]


def refuse(key: str, problem: str, value: object = None, remedy: str = "") -> NoReturn:
    """Raise a SpecError about a key of the table ``arm``."""
    shown = {} if value is None else {"value": value}
    raise SpecError(finding(f"arm.{key}", problem, remedy=remedy, **shown))


@lru_cache(maxsize=16)
def model(path: Path, digest: str) -> Model:
    """The model of a file; ``digest`` tells its versions apart.

    Raises
    ------
    SpecError
        The parser is not installed, or the file is not a URDF: xacro, broken XML, names twice, loops.
    """
    robot, name = _parsed(path), path.name
    links, joints = [link.name for link in robot.links], [_joint(joint, name) for joint in robot.joints]
    for kind, names in (("links", links), ("joints", [joint.name for joint in joints])):
        if twice := sorted({n for n in names if names.count(n) > 1}):
            refuse("file", f"{kind} share the name {', '.join(twice)}.", name)
    above: dict[str, FileJoint] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                refuse("file", f"joint {joint.name!r} names a link {link!r} that the file does not have.", name)
        if joint.child in above:
            both = f"{above[joint.child].name!r} and {joint.name!r}"
            refuse("file", f"link {joint.child!r} is the child of two joints, {both}; a URDF is a tree.", name)
        above[joint.child] = joint
    return Model(tuple(links), {joint.name: joint for joint in joints}, above)


def _joint(joint: Any, file: str) -> FileJoint:
    """The parser's joint with its defaults: origin and rotation 0, axis x, limits 0 to 0, multiplier 1."""
    xyz, rpy = (joint.origin.xyz, joint.origin.rpy) if joint.origin is not None else (None, None)
    origin, angles, axis = _vector(xyz), _vector(rpy), _vector(joint.axis, (1.0, 0.0, 0.0))
    limits = None if joint.limit is None else (float(joint.limit.lower), float(joint.limit.upper))
    mimic = None
    if joint.mimic is not None:
        multiplier = 1.0 if joint.mimic.multiplier is None else joint.mimic.multiplier
        mimic = Mimic(joint.mimic.joint, multiplier, joint.mimic.offset or 0.0)
    drive = (mimic.multiplier, mimic.offset) if mimic is not None else ()
    if not all(math.isfinite(x) for x in (*origin, *angles, *axis, *(limits or ()), *drive)):
        refuse("file", f"joint {joint.name!r} has a number that is not finite.", file)
    if not any(axis):
        refuse("file", f"joint {joint.name!r} has an axis of zeros.", file)
    return FileJoint(joint.name, joint.type, joint.parent, joint.child, origin, angles, axis, limits, mimic)


def _vector(values: Any, default: Vector = (0.0, 0.0, 0.0)) -> Vector:
    x, y, z = values or default
    return float(x), float(y), float(z)


def _parsed(path: Path) -> Any:
    """The parser's robot, of the parts that matter to motion."""
    try:
        from lxml import etree
        from urdf_parser_py.urdf import Robot
    except ModuleNotFoundError as error:
        problem = f"needs a package that is not installed ({error.name})."
        refuse("kind", problem, "urdf", 'Install it: pip install "eiwa[urdf]".')
    try:
        parser = etree.XMLParser(remove_comments=True, remove_pis=True, resolve_entities=False, no_network=True)
        root = etree.fromstring(path.read_bytes(), parser)
    except etree.XMLSyntaxError as error:
        refuse("file", f"is not XML: {error}.", path.name)
    if any("xacro" in (etree.QName(element).namespace or "") for element in root.iter()):
        refuse("file", "is a xacro file.", path.name, f"Write the URDF first: xacro {path.name} > arm.urdf.")
    if root.tag != "robot":
        refuse("file", f"is not a URDF: it begins with <{root.tag}>, not <robot>.", path.name)
    try:
        return Robot.from_xml_string(etree.tostring(_bare(root)))
    # The parser raises errors of its own, and ValueError or AssertionError.
    except Exception as error:
        refuse("file", f"is not a URDF: {' '.join(str(error).split())}.", path.name)


def _bare(root: Any) -> Any:
    """The same tree with nothing but what :data:`READ` names."""
    root.attrib.clear()
    root.set("name", "arm")
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
            continue
        for part in list(element):
            if element.tag == "link" or part.tag not in READ:
                element.remove(part)
        for part in element.iter():
            kept = {key: part.get(key) for key in READ[part.tag] if part.get(key) is not None}
            part.attrib.clear()
            # The parser wants effort and velocity, which many files leave out.
            part.attrib.update(kept | ({"effort": "0", "velocity": "0"} if part.tag == "limit" else {}))
    return root


def way(model: Model, base: str | None, tip: str | None) -> tuple[FileJoint, ...]:
    """The joints from base to tip, which may be left out where they are unique.

    Raises
    ------
    SpecError
        No such links, no such way, or a joint on it that is floating or planar.
    """
    for key, link in (("base", base), ("tip", tip)):
        if link is not None and link not in model.links:
            refuse(key, f"the file has no such link. Links: {', '.join(model.links)}.", link)
    if base is None:
        roots = [link for link in model.links if link not in model.above]
        base = _only("base", roots, "links that are no joint's child")
    if tip is None:
        parents = {joint.parent for joint in model.above.values()}
        leaves = [link for link in model.links if link not in parents and base in _upwards(model, link)]
        tip = _only("tip", leaves, f"links below {base!r} without a joint on them")
    upwards = _upwards(model, tip)
    if base not in upwards[1:]:
        refuse("tip", f"does not lie below the base {base!r}. Upwards from it: {', '.join(upwards)}.", tip)
    joints = tuple(model.above[link] for link in reversed(upwards[: upwards.index(base)]))
    for joint in joints:
        if joint.type not in KINDS:
            allowed = f"between {base!r} and {tip!r} it must be {', '.join(KINDS)}."
            refuse("file", f"joint {joint.name!r} is {joint.type}; {allowed}", remedy="Choose another base or tip.")
    return joints


def _only(key: str, links: list[str], what: str) -> str:
    if len(links) != 1:
        known = f": {', '.join(links)}" if links else ""
        refuse(key, f"must be given: the file has {len(links)} {what}{known}.")
    return links[0]


def _upwards(model: Model, link: str) -> list[str]:
    """A link, its parent, and so on."""
    seen = [link]
    while seen[-1] in model.above:
        parent = model.above[seen[-1]].parent
        if parent in seen:
            refuse("file", f"the joints go round in a circle: {' <- '.join([*seen, parent])}.")
        seen.append(parent)
    return seen


@dataclass(frozen=True)
class Drive:
    """What moves a joint of the way: ``mimic`` of another one there, or none.

    ``limits`` are those of a joint outside the way that it mimics.
    """

    mimic: Mimic | None
    limits: tuple[float, float] | None = None


def drives(model: Model, joints: Sequence[FileJoint]) -> dict[str, Drive]:
    """What moves every joint of a way. A joint that mimics one outside the way moves by itself, others mimic it."""
    here = {joint.name for joint in joints}
    first: dict[str, Mimic] = {}
    found = {}
    for joint in joints:
        source = _source(model, joint)
        if source.joint == joint.name:
            found[joint.name] = Drive(None)
        elif source.joint in here or source.multiplier == 0.0:
            found[joint.name] = Drive(source)
        elif source.joint not in first:
            first[source.joint] = Mimic(joint.name, source.multiplier, source.offset)
            found[joint.name] = Drive(None, _mapped(model.joints[source.joint].limits, source))
        else:
            leader = first[source.joint]
            ratio = source.multiplier / leader.multiplier
            found[joint.name] = Drive(Mimic(leader.joint, ratio, source.offset - ratio * leader.offset))
    return found


def _source(model: Model, joint: FileJoint) -> Mimic:
    """The joint that moves by itself at the end of a row of mimics; itself for a joint that mimics none."""
    total, seen = Mimic(joint.name), [joint.name]
    while (mimic := model.joints[total.joint].mimic) is not None:
        path = f"joints.{joint.name}"
        if mimic.joint not in model.joints:
            refuse(path, f"mimics a joint {mimic.joint!r} that the file does not have.")
        if mimic.joint in seen:
            refuse(path, f"the mimics go round in a circle: {' <- '.join([*seen, mimic.joint])}.")
        if KINDS.get(model.joints[mimic.joint].type, "fixed") == "fixed":
            refuse(path, f"mimics {mimic.joint!r}, which is {model.joints[mimic.joint].type}.")
        seen.append(mimic.joint)
        offset = total.multiplier * mimic.offset + total.offset
        total = Mimic(mimic.joint, total.multiplier * mimic.multiplier, offset)
    return total


def _mapped(limits: tuple[float, float] | None, source: Mimic) -> tuple[float, float] | None:
    if limits is None:
        return None
    low, high = sorted(source.multiplier * limit + source.offset for limit in limits)
    return low, high
