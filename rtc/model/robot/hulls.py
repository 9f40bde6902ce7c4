"""Convex hulls of an arm's links: small OBJ texts that are embedded in a cell, and their geometry for coal. Pure.

A hull file has vertices (`v x y z`, m, in the link's axes) and outward triangles (`f a b c`, counted from 1).
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin

from rtc.spatial.geometry import Array

SUFFIX = ".obj"


def convex(text: str) -> coal.Convex:
    """The hull as a convex shape. Raises ValueError for a text that is not a hull."""
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for line in text.splitlines():
        kind, *rest = line.split() or [""]
        if kind == "v":
            points.append(_vector(rest))
        elif kind == "f":
            a, b, c = (int(number) - 1 for number in rest)
            if not all(0 <= n < len(points) for n in (a, b, c)):
                raise ValueError(f"a triangle of unknown vertices: {line}")
            triangles.append(coal.Triangle(a, b, c))
    if len(points) < 4 or len(triangles) < 4:
        raise ValueError("a hull needs four vertices and four triangles, or more")
    return coal.Convex(points, triangles)


def files(urdf: str) -> list[str]:
    """The mesh files that the collision shapes of a URDF name, each once."""
    meshes = [str(mesh.get("filename")) for mesh in ElementTree.fromstring(urdf).findall("link/collision//mesh")]
    return sorted(set(meshes))


def shapes(model: pin.Model, urdf: str, texts: Mapping[str, str]) -> pin.GeometryModel:
    """The collision shapes of an arm. `texts`: hulls by file name; other meshes are read from their files."""
    robot = ElementTree.fromstring(urdf)
    embedded: dict[str, str] = {}  # name of the geometry object -> hull
    for link in robot.findall("link"):
        for n, collision in enumerate(link.findall("collision")):
            mesh = collision.find("geometry/mesh")
            if mesh is not None and (file := str(mesh.get("filename"))) in texts:
                embedded[f"{link.get('name')}_{n}"] = texts[file]
                box = collision.find("geometry")
                assert box is not None
                box.remove(mesh)
                ElementTree.SubElement(box, "sphere", radius="1")  # a placeholder, replaced below
    text = ElementTree.tostring(robot, encoding="unicode") if embedded else urdf
    found = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    for item in found.geometryObjects:
        if item.name in embedded:
            item.geometry = _built(embedded[item.name])
    return found


@lru_cache(maxsize=256)
def _built(text: str) -> coal.Convex:
    return convex(text)


def _vector(words: list[str]) -> Array:
    x, y, z = (float(word) for word in words)
    return np.array((x, y, z))
