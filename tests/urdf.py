"""URDF files as text: DH tables written out, and random trees."""

import numpy as np

from eiwa.plugins.arms.urdf import UrdfParameters, chain


def numbers(values):
    return " ".join(repr(float(v)) for v in values)


def joint(name, kind, parent, child, xyz=(0, 0, 0), rpy=(0, 0, 0), axis=(0, 0, 1), limits=None, mimic=None):
    lines = [f'<joint name="{name}" type="{kind}">', f'<parent link="{parent}"/><child link="{child}"/>']
    lines.append(f'<origin xyz="{numbers(xyz)}" rpy="{numbers(rpy)}"/>')
    if kind != "fixed":
        lines.append(f'<axis xyz="{numbers(axis)}"/>')
    if limits is not None:
        lines.append(f'<limit lower="{limits[0]!r}" upper="{limits[1]!r}" effort="1" velocity="1"/>')
    if mimic is not None:
        source, multiplier, offset = mimic
        lines.append(f'<mimic joint="{source}" multiplier="{multiplier!r}" offset="{offset!r}"/>')
    return "\n".join([*lines, "</joint>"])


def robot(*joints, links=()):
    """A robot of such joints, with the links that they name."""
    import re

    named = dict.fromkeys([*links, *re.findall(r'link="([^"]*)"', "".join(joints))])
    return "\n".join(['<robot name="test">', *(f'<link name="{link}"/>' for link in named), *joints, "</robot>"])


def from_table(parameters):
    """A DH table [rad] as a URDF: every row is a fixed joint for its link and a joint about z."""
    joints = []
    modified = parameters.convention == "modified"
    link = "base"

    def fixed(child, xyz, rpy):
        nonlocal link
        joints.append(joint(f"to_{child}", "fixed", link, child, xyz, rpy))
        link = child

    for row in parameters.joints:
        if modified:
            fixed(f"{row.name}_link", (row.a, 0, 0), (row.alpha, 0, 0))
        kind = "continuous" if row.limits is None else "revolute"
        turn = (0, 0, row.d), (0, 0, row.theta)
        joints.append(joint(row.name, kind, link, f"{row.name}_turned", *turn, limits=row.limits))
        link = f"{row.name}_turned"
        if not modified:
            fixed(f"{row.name}_link", (row.a, 0, 0), (row.alpha, 0, 0))
    fixed("tool", parameters.tool, parameters.tool_rpy)
    return robot(*joints)


def read(folder, text, **table):
    """Validated parameters of a file with this text."""
    (folder / "arm.urdf").write_text(text)
    return UrdfParameters.model_validate({"file": "arm.urdf", **table}, context={"locate": folder.joinpath})


def arm(folder, text, **table):
    return chain(read(folder, text, **table))


def random_tree(seed):
    """A tree of links with every kind of joint, mimics on the way and beside it; the text, and a link to reach."""
    rng = np.random.default_rng(seed)
    joints, movable, tip = [], [], "l0"
    links = ["l0"]
    for k in range(1, 12 + seed % 5):
        grows = rng.uniform() < 0.8
        parent = tip if grows else links[rng.integers(len(links))]
        kind = str(rng.choice(["revolute", "continuous", "prismatic", "fixed"], p=[0.4, 0.2, 0.2, 0.2]))
        axis = np.eye(3)[rng.integers(3)] * rng.choice([-1, 1]) if rng.uniform() < 0.3 else rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        mimic = None
        if movable and kind in ("revolute", "prismatic") and rng.uniform() < 0.4:
            mimic = (movable[rng.integers(len(movable))], float(rng.uniform(0.3, 2) * rng.choice([-1, 1])), 0.2)
        limits = (-2.0, 2.0) if kind in ("revolute", "prismatic") and mimic is None else None
        limits = (-50.0, 50.0) if mimic is not None else limits
        pose = rng.normal(size=3) / 3, rng.uniform(-np.pi, np.pi, 3)
        joints.append(joint(f"j{k}", kind, parent, f"l{k}", *pose, axis, limits, mimic))
        if kind != "fixed":
            movable.append(f"j{k}")
        links.append(f"l{k}")
        tip = f"l{k}" if grows else tip
    return robot(*joints), tip
