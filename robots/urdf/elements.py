"""Elements of a URDF: reading a file, joining arms to one robot, and a parallel gripper of boxes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from foldcell.robots.example_data import read_description
from foldcell.robots.gripper_geometry import GripperGeometry
from foldcell.robots.ports import Side

Numbers = Sequence[float]


def mesh_path(name: str, meshes: Path) -> Path:
    """Return the path of a mesh that a URDF names by a `package://` or `file://` URI or by a path. meshes: folder
    from which packages and relative paths start."""
    return meshes / name.removeprefix("package://").removeprefix("file://")


def resolved(urdf: str, meshes: Path) -> str:
    """Return the text of a URDF with absolute paths of its meshes."""
    root = ET.fromstring(urdf)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(mesh_path(mesh.attrib["filename"], meshes)))
    return ET.tostring(root, encoding="unicode")


def stripped(urdf: str, *tags: str) -> ET.Element:
    """Parse the text of a URDF, without the elements `tags` of its links, and without what only Gazebo and ROS
    use."""
    root = ET.fromstring(urdf)
    for link in root.iter("link"):
        for tag in tags:
            for element in link.findall(tag):
                link.remove(element)
    for tag in ("gazebo", "transmission"):
        for element in root.findall(tag):
            root.remove(element)
    return root


def srdf_disabled_pairs(path: Path) -> frozenset[frozenset[str]]:
    """Return the pairs of links that an SRDF excludes from collision checks. Raises ConfigurationError if the file
    is missing."""
    pairs = ET.fromstring(read_description(path)).iter("disable_collisions")
    return frozenset(frozenset((pair.attrib["link1"], pair.attrib["link2"])) for pair in pairs)


def neighbours(urdf: str) -> frozenset[frozenset[str]]:
    """Return the pairs of links that are fixed to each other, or that a single moving joint connects. Such links
    touch at the joint, so their collisions mean nothing."""
    joints = ET.fromstring(urdf).findall("joint")
    above = {joint.find("child").attrib["link"]: joint for joint in joints}  # type: ignore[union-attr]

    def body(link: str) -> str:
        """The uppermost link to which `link` is fixed."""
        while link in above and above[link].attrib["type"] == "fixed":
            link = parent(link)
        return link

    def parent(link: str) -> str:
        return above[link].find("parent").attrib["link"]  # type: ignore[union-attr]

    links = [link.attrib["name"] for link in ET.fromstring(urdf).findall("link")]
    bodies = {link: body(link) for link in links}
    carrier = {link: bodies[parent(bodies[link])] for link in links if bodies[link] in above}
    return frozenset(
        frozenset((a, b))
        for i, a in enumerate(links)
        for b in links[:i]
        if bodies[a] == bodies[b] or carrier.get(a) == bodies[b] or carrier.get(b) == bodies[a]
    )


def prefixed_arm(arm: ET.Element, prefix: str) -> list[ET.Element]:
    """Return copies of an arm's links and joints, whose names begin with `prefix`."""
    copies = [ET.fromstring(ET.tostring(element)) for element in arm if element.tag in ("link", "joint")]
    for element in copies:
        element.set("name", prefix + element.attrib["name"])
        for reference in element:
            if reference.tag in ("parent", "child"):
                reference.set("link", prefix + reference.attrib["link"])
    return copies


def fixed_joint(name: str, parent: str, child: str, xyz: Numbers, rpy: Numbers = (0.0, 0.0, 0.0)) -> ET.Element:
    """Return a joint that fixes a link to its parent at xyz [m], rpy [rad]."""
    joint = ET.Element("joint", name=name, type="fixed")
    _placed(joint, parent, child, xyz, rpy)
    return joint


def box_link(
    name: str, boxes: Sequence[tuple[Numbers, Numbers]], mass: float, rgb: Numbers = (0.25, 0.26, 0.28)
) -> ET.Element:
    """Return a link of boxes, each as (size, centre) [m], with visuals and collision shapes. mass [kg]: 0 for a
    link that never moves."""
    link = ET.Element("link", name=name)
    if mass > 0.0:
        size, centre = boxes[0]
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value=f"{mass}")
        ET.SubElement(inertial, "origin", xyz=_text(centre), rpy="0 0 0")
        x, y, z = (mass * side**2 / 12.0 for side in size)
        ET.SubElement(
            inertial,
            "inertia",
            ixx=f"{y + z:.3e}",
            iyy=f"{x + z:.3e}",
            izz=f"{x + y:.3e}",
            ixy="0",
            ixz="0",
            iyz="0",
        )
    for size, centre in boxes:
        for tag in ("visual", "collision"):
            element = ET.SubElement(link, tag)
            ET.SubElement(element, "origin", xyz=_text(centre), rpy="0 0 0")
            ET.SubElement(ET.SubElement(element, "geometry"), "box", size=_text(size))
            if tag == "visual":
                material = ET.SubElement(element, "material", name=f"{name}_colour")
                ET.SubElement(material, "color", rgba=f"{_text(rgb)} 1")
    return link


def parallel_gripper(side: Side, flange: str, length: float, gripper: GripperGeometry) -> list[ET.Element]:
    """Return a gripper of boxes at the link `flange`, whose z axis points out of the arm: a body, two fingers with
    the joints that `gripper` names, and the tool frame `{side}_tool` between the tips, `length` [m] from the
    flange. The fingers move along the tool's y."""
    body, tool = f"{side}_gripper_body", f"{side}_tool"
    deep = length - gripper.finger_length
    width = gripper.max_opening + 4.0 * gripper.finger_radius
    elements = [
        box_link(body, [((0.06, width, deep), (0.0, 0.0, 0.5 * deep))], 0.6),
        fixed_joint(f"{body}_joint", flange, body, (0.0, 0.0, 0.0)),
        ET.Element("link", name=tool),
        fixed_joint(f"{tool}_joint", body, tool, (0.0, 0.0, length)),
    ]
    thick, long = 2.0 * gripper.finger_radius, gripper.finger_length
    for number, (name, travel) in enumerate(gripper.finger_joints[side]):
        sign = 1.0 if travel > 0.0 else -1.0
        finger = f"{side}_finger_{number}"
        elements.append(box_link(finger, [((0.02, thick, long), (0.0, 0.5 * sign * thick, 0.5 * long))], 0.1))
        joint = ET.Element("joint", name=name, type="prismatic")
        _placed(joint, body, finger, (0.0, 0.0, deep), (0.0, 0.0, 0.0))
        ET.SubElement(joint, "axis", xyz="0 1 0")
        ends = sorted((0.0, travel * gripper.max_opening))
        ET.SubElement(joint, "limit", lower=f"{ends[0]}", upper=f"{ends[1]}", effort="50", velocity="0.2")
        elements.append(joint)
    return elements


def _placed(joint: ET.Element, parent: str, child: str, xyz: Numbers, rpy: Numbers) -> None:
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_text(xyz), rpy=_text(rpy))


def _text(numbers: Numbers) -> str:
    return " ".join(f"{x:.9g}" for x in numbers)
