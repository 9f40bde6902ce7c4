"""Convex hulls of meshes with few vertices, as texts for a cell. Pure.

The hull of a mesh may have thousands of vertices. Those farthest out in evenly spread directions are kept, and more
until the mesh exceeds the hull by less than a millimetre.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from rtc.protocol.outcomes import ProgramError
from rtc.spatial.geometry import Array

DIRECTIONS = 64  # at first the farthest vertex in each is kept
CLOSE_M, MAX_CORNERS, AT_ONCE = 0.001, 220, 6  # then as many more until this close, or this many


class Hull(NamedTuple):
    text: str  # OBJ
    left_out_m: float  # greatest distance of a vertex of the mesh outside of the hull
    vertices: Array


def hull_of(points: Array, name: str) -> Hull:
    """The hull of points (m, [n][3]). Raises ProgramError if they lie in one plane."""
    try:
        whole = points[ConvexHull(points).vertices]
        middle = whole.mean(axis=0)
        kept = np.unique(((whole - middle) @ _directions().T).argmax(axis=0))
        while True:
            few = whole[kept]
            solid = ConvexHull(few)
            beyond = (whole @ solid.equations[:, :3].T + solid.equations[:, 3]).max(axis=1)
            if beyond.max() <= CLOSE_M or len(kept) >= MAX_CORNERS:
                break
            kept = np.union1d(kept, np.argsort(-beyond, kind="stable")[:AT_ONCE])
    except (QhullError, ValueError) as error:
        raise ProgramError(f"{name}: the mesh has no volume, so it has no hull") from error
    number = {vertex: n for n, vertex in enumerate(solid.vertices)}
    lines = [f"# {name}"]
    lines += ["v " + " ".join(f"{x:.5f}" for x in few[vertex]) for vertex in solid.vertices]
    for corners, plane in zip(solid.simplices, solid.equations, strict=True):
        a, b, c = few[corners]
        outward = np.dot(np.cross(b - a, c - a), plane[:3]) > 0
        order = corners if outward else corners[::-1]
        lines.append("f " + " ".join(str(number[vertex] + 1) for vertex in order))
    return Hull("\n".join(lines) + "\n", float(max(beyond.max(), 0.0)), few[solid.vertices])


def _directions() -> Array:
    """Evenly spread unit vectors: a Fibonacci lattice."""
    n = np.arange(DIRECTIONS) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * n / DIRECTIONS), np.pi * (1.0 + 5.0**0.5) * n
    return np.stack((np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)), axis=1)
