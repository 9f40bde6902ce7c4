"""What cameras are expected to see of a body where it is believed to be, and what is before its tags. Pure.

A tag counts if it faces the camera, is large enough in its picture, and nothing that the cell knows is before it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from rtc.model.robot.collision_scene import Scene
from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import Sighting
from rtc.sensing import absence, optics
from rtc.sensing.locate import corners
from rtc.sensing.pose_fit import CONFUSED, TagObservation, between, fit
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning import scenes, sight
from workers.planning.world_query import WorldQuery

# Points of a tag between which nothing is small enough to be overlooked: corners, middles of the sides, centre.
GRID = np.array([(x, y, 0.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
NO_MOTION = [0.0] * 6
# Error of corners in drawn pictures: less in 95 of 100 (n 138, two tags or more). Two attitudes that fit ideal corners
# with 0.43 px (n 10) were confused in pictures, from 0.55 px on (n 6) none were.
PICTURE_PX = 0.28


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


def sighting(
    query: WorldQuery, cameras: Iterable[str], body: str, pictures: int, *, follows: bool = False
) -> tuple[Sighting | None, str]:
    """(what these cameras see of a body in so many pictures, with the accuracy of its tags there; "").
    (None, why): they cannot see it where it is believed to be."""
    pose, known = query.pose(body), [query.cell.camera(name) for name in cameras]
    views = [optics.view(camera, query.tcp(camera.arm) if camera.arm else None) for camera in known]
    scene = scene_of(query)
    seen: list[TagObservation] = []
    why: list[str] = []
    for view in views:
        shown, hides = observations(query, scene, view, body, pose)
        seen += shown
        if not shown:
            words = f"{hides[0]} is before it" if hides else absence.Cause.OUT_OF_VIEW.value
            why.append(f"{view.camera}: {words}" if len(views) > 1 else words)
    found = fit(seen * pictures, geometry.to_matrix(pose))  # one pose from all pictures of a look
    if found is None:
        return None, "; ".join(why)
    covariance, second = found.covariance, found.second
    ambiguous = second is not None and math.hypot(second.error_px, PICTURE_PX) < CONFUSED * PICTURE_PX
    if second is not None and ambiguous and not found.ambiguous:
        covariance = covariance + between(found.best, second)
    expected = Sighting(
        pose=pose.tolist(),
        covariance=covariance.ravel().tolist(),
        tags=sorted({one.tag for one in found.used}),
        error_px=0.0,
        age_s=0.0,
        pictures=pictures,
        ambiguous=ambiguous,
        velocity=NO_MOTION if follows else None,
        cameras=sorted({one.view.camera for one in found.used}) if len(views) > 1 else [],
    )
    return expected, ""
