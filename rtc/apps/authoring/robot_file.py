"""A URDF file as one tree of links and joints, with its meshes. Reads mesh files, changes nothing."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from rtc.model.cells.urdf import Urdf, numbers
from rtc.protocol.outcomes import ProgramError
from rtc.spatial.geometry import Array

PACKAGE = "package://"
ANCESTORS = 4  # directories above a URDF in which the packages of its meshes are looked for
LFS = b"version https://git-lfs"
PULL = "fetch the file itself: git lfs pull"
EXPAND = "expand it first: xacro FILE > arm.urdf"
COLLADA_UNIT = re.compile(r"""<unit\b[^>]*?\bmeter\s*=\s*["']\s*([0-9.]+(?:[eE][-+]?[0-9]+)?)\s*["']""")
LARGE_M, SMALL_M = 5.0, 0.0005  # a mesh of a link is between them
Element = ElementTree.Element


class RobotFile(Urdf):
    """A parsed URDF. Raises ProgramError for a file that cannot be read, or is not one tree of links."""

    def __init__(self, path: Path, text: str | None = None) -> None:
        """`text`: instead of that of the file."""
        self.path = path
        try:
            text = path.read_text(encoding="utf-8") if text is None else text
            robot = ElementTree.fromstring(text)
        except OSError as error:
            raise ProgramError(f"cannot read {path}: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ProgramError(f"{path} is not XML: {error}") from error
        except ElementTree.ParseError as error:
            raise ProgramError(f"{path} {_why_not_xml(text or '') or f'is not XML: {error}'}") from error
        if macro := _macro(robot):
            raise ProgramError(f"{path} has {macro}: it is a xacro; {EXPAND}")
        if robot.tag != "robot":
            raise ProgramError(f"{path} is not a URDF: its outermost element is <{robot.tag}>, not <robot>")
        self.name = robot.get("name", path.stem)
        super().__init__(robot)

    def index(self) -> None:
        """Builds the tables of links and joints. Raises ProgramError if they are not one tree."""
        super().index()
        for faulty in self._broken():
            raise ProgramError(f"{self.path}: {faulty}")
        self.root = next(link for link in self.links if link not in self.carrier)

    def _broken(self) -> Iterator[str]:
        for name, count in Counter(joint.get("name") for joint in self.robot.findall("joint")).items():
            if name and count > 1:
                yield f"joint {name}: {count} of them have this name; expected: a name of its own for each"
        for ends, what in ((self.parent, "parent"), (self.child, "child")):
            for joint, link in ends.items():
                if link not in self.links:
                    yield f"joint {joint}: there is no link {link or '(none)'}, its {what}"
        children = list(self.child.values())
        for link in children:
            if children.count(link) > 1:
                yield f"link {link} has more than one joint that carries it"
        roots = [link for link in self.links if link not in children]
        if len(roots) != 1:
            none = "none, the joints form a ring" if self.links else "no links"
            yield f"one root link is needed; there are {', '.join(roots) or none}"
            return
        reached = self.below(roots[0])
        if len(reached) < len(self.links):
            ring = ", ".join(link for link in self.links if link not in reached)
            yield f"one tree is needed; the joints of {ring} form a ring"

    def below(self, link: str) -> list[str]:
        """The links carried by a link, itself first."""
        found = [link]
        for one in found:
            found += [self.child[joint] for joint in self.joints if self.parent[joint] == one]
        return found

    def pose_in(self, link: str, ancestor: str) -> Array:
        """Pose of a link in the axes of an ancestor, all joints at zero."""
        pose = np.eye(4)
        while link != ancestor:
            pose = self.placement(self.carrier[link]) @ pose
            link = self.parent[self.carrier[link]]
        return pose

    def mesh_file(self, name: str) -> Path | None:
        """The file of a mesh: relative to the URDF, in a package beside or above it, or absolute. None: not found.

        A path of a package that leads out of it is not followed.
        """
        plain = name.removeprefix("file://")
        if plain.startswith(PACKAGE):
            plain = plain.removeprefix(PACKAGE)
            if ".." in Path(plain).parts or plain.startswith("/"):
                return None
        candidates = [Path(plain)] if plain.startswith("/") else []
        rest = plain.partition("/")[2]
        for folder in [self.path.parent, *self.path.absolute().parents[1:ANCESTORS]]:
            candidates += [folder / plain, folder / rest]
        candidates += [Path(root) / rest for root in _package(plain.partition("/")[0])]
        return next((file for file in candidates if file.is_file()), None)

    def vertices(self, mesh: Element) -> Array:
        """The vertices of a <mesh>, scaled, [n][3]. Raises ProgramError if its file is missing or unreadable."""
        name = str(mesh.get("filename"))
        file = self.mesh_file(name)
        if file is None:
            raise ProgramError(f"{self.path}: the mesh {name} is not found beside the URDF or in a package above it")
        with file.open("rb") as opened:
            if opened.read(len(LFS)) == LFS:
                raise ProgramError(f"{self.path}: the mesh {file} is a Git LFS pointer; {PULL}")
        scale = _unit_m(file) * np.array(numbers(mesh, "scale", (1.0, 1.0, 1.0)))
        try:
            solid = coal.MeshLoader().load(str(file), scale)
        except (RuntimeError, ValueError) as error:
            why = str(error).rpartition("message: ")[2].replace("\n", " ")  # before it: lines of the library
            raise ProgramError(f"{self.path}: the mesh {file} cannot be read: {why:.200}") from error
        vertices = np.array(solid.vertices(), dtype=float).reshape(-1, 3)
        if not len(vertices) or not np.isfinite(vertices).all():
            raise ProgramError(f"{self.path}: the mesh {file} has vertices that are no finite numbers, or none")
        return vertices


def _why_not_xml(text: str) -> str:
    """The cause, if it is a known one."""
    if text.startswith(LFS.decode()):
        return f"is a Git LFS pointer; {PULL}"
    return f"is a xacro; {EXPAND}" if "<xacro:" in text or "xmlns:xacro" in text else ""


def _macro(robot: Element) -> str:
    """What a xacro has and a URDF has not: the first of its elements or expressions; or ''."""
    for element in robot.iter():
        if "xacro}" in str(element.tag):
            return f"<xacro:{str(element.tag).partition('}')[2]}>"
        for key, value in element.attrib.items():
            if "${" in value or "$(" in value:
                return f'<{element.tag} {key}="{value}">'
    return ""


def implausible(points: Array, mesh: str) -> str:
    """Why the vertices of a mesh cannot be those of a link of an arm; or ''."""
    size_m = float((points.max(axis=0) - points.min(axis=0)).max())
    if size_m > LARGE_M:
        return f'the mesh {mesh} is {size_m:.0f} m long: if it is in mm, give it scale="0.001 0.001 0.001"'
    if size_m < SMALL_M:
        return f"the mesh {mesh} is {1e3 * size_m:.2g} mm long: if it is in m, it needs no scale"
    return ""


def _unit_m(file: Path) -> float:
    """The unit of a COLLADA file, which coal leaves out; 1 for other files."""
    if file.suffix.lower() != ".dae":
        return 1.0
    found = COLLADA_UNIT.search(file.read_text(encoding="utf-8", errors="replace"))
    return float(found[1]) if found is not None else 1.0


def _package(name: str) -> list[str]:
    """The folders of an installed Python package that has the name of a mesh's package."""
    try:
        found = find_spec(name) if name.isidentifier() else None
    except (ImportError, ValueError):
        return []
    return list(found.submodule_search_locations or []) if found is not None else []


def kinematics(urdf: str, path: Path) -> pin.Model:
    """The model of a URDF text. `path`: of its file. Raises ProgramError if pinocchio cannot read it."""
    try:
        return pin.buildModelFromXML(urdf)
    except (ValueError, RuntimeError, IndexError) as error:
        raise ProgramError(
            f"{path}: pinocchio cannot read it: {error} Expected: a URDF that `check_urdf` accepts"
        ) from error
