"""Which tags of a body a camera sees by what the cell knows, and what is before the others. Pure.

A tag counts if it faces the camera, is large enough in its picture, and nothing that the cell knows is before it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from rtc.model.robot.collision_scene import Scene
from rtc.protocol.messages import Limits
from rtc.sensing import absence, optics
from rtc.sensing.locate import corners
from rtc.sensing.pose_fit import TagObservation
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning import scenes, sight
from workers.planning.world_query import WorldQuery

# Points of a tag between which nothing is small enough to be overlooked: corners, middles of the sides, centre.
GRID = np.array([(x, y, 0.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])


def hiders(query: WorldQuery, cameras: Iterable[str], body: str) -> tuple[bool, list[str]]:
    """(whether one of the cameras sees a tag of a body that is where it is believed to be; what is before its tags:
    bodies and arms by name)."""
    scene, seen = scene_of(query), False
    found: list[str] = []
    for name in cameras:
        camera = query.cell.camera(name)
        view = optics.view(camera, query.tcp(camera.arm) if camera.arm else None)
        shown, labels = observations(query, scene, view, body, query.pose(body))
        seen, found = seen or bool(shown), [*found, *labels]
    return seen, [*dict.fromkeys(label.partition(" ")[0] for label in found)]


def scene_of(query: WorldQuery) -> Scene:
    """Everything where it is believed to be."""
    return scenes.scene_of(query, query.cell.arms[0].name, Limits(), unsure=False)


def observations(
    query: WorldQuery, scene: Scene, view: optics.CameraView, body: str, pose: Array
) -> tuple[list[TagObservation], list[str]]:
    """The tags of a body that a camera sees, and what hides others that it would see."""
    large = [
        tag for tag in sight.tags(query.cell, body) if (absence.across_px(tag, pose, view) or 0.0) >= absence.MIN_PX
    ]
    if not large:
        return [], []
    matrix, eye = geometry.to_matrix(pose), -view.rotation.T @ view.translation
    places = [matrix @ geometry.to_matrix(tag.frame.pose) for tag in large]
    points = [0.5 * tag.size_m * GRID @ at[:3, :3].T + at[:3, 3] for tag, at in zip(large, places, strict=True)]
    joints = {arm.name: query.joints(arm.name) for arm in query.cell.arms}
    met = query.model.collision.hidden_by(joints, scene, eye, np.concatenate(points))
    before = [next(filter(None, met[n * len(GRID) : (n + 1) * len(GRID)]), "") for n in range(len(large))]
    found = []
    for tag in (tag for tag, hides in zip(large, before, strict=True) if not hides):
        own = corners(tag)
        found.append(TagObservation(tag.id, view, view.pixels(own @ matrix[:3, :3].T + matrix[:3, 3]), own))
    return found, [*dict.fromkeys(filter(None, before))]
