"""What cameras are expected to see of a body, and with what accuracy, if it is where it is believed to be. Pure.

A tag counts if it faces the camera, is large enough in its picture, and nothing that the cell knows is before it.
"""

from __future__ import annotations

import math

import numpy as np

from rtc.model.robot.collision_scene import Scene
from rtc.protocol.messages import Limits
from rtc.protocol.outcomes import Sighting
from rtc.protocol.primitive import Look, Primitive
from rtc.sensing import absence, optics
from rtc.sensing.locate import corners
from rtc.sensing.pose_fit import CONFUSED, TagObservation, between, fit
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning import scenes, sight
from workers.planning.world_query import WorldQuery

NO_MOTION = [0.0] * 6
# Error of corners in drawn pictures: less in 95 of 100 (n 138, two tags or more). Two attitudes that fit ideal corners
# with 0.43 px (n 10) were confused in pictures, from 0.55 px on (n 6) none were.
PICTURE_PX = 0.28
# Points of a tag between which nothing is small enough to be overlooked: corners, middles of the sides, centre.
GRID = np.array([(x, y, 0.0) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])


def sighting(query: WorldQuery, made: Primitive, body: str) -> tuple[Sighting | None, str]:
    """(what the cameras of a look see of a body, with the accuracy of its tags in their pictures; "").
    (None, why): they cannot see it where it is believed to be."""
    look, pose = made.trajectory, query.pose(body)
    assert isinstance(look, Look)
    cameras = [query.cell.camera(name) for name in made.performers]
    views = [optics.view(camera, query.tcp(camera.arm) if camera.arm else None) for camera in cameras]
    scene = scenes.scene_of(query, query.cell.arms[0].name, Limits(), unsure=False)
    seen: list[TagObservation] = []
    why: list[str] = []
    for view in views:
        shown, hides = observations(query, scene, view, body, pose)
        seen += shown
        if not shown:
            words = f"{hides} is before it" if hides else absence.Cause.OUT_OF_VIEW.value
            why.append(f"{view.camera}: {words}" if len(views) > 1 else words)
    found = fit(seen * look.pictures, geometry.to_matrix(pose))  # one pose from all pictures of a look
    if found is None:
        return None, "; ".join(why)
    follows, covariance, second = look.duration_s is not None, found.covariance, found.second
    ambiguous = second is not None and math.hypot(second.error_px, PICTURE_PX) < CONFUSED * PICTURE_PX
    if second is not None and ambiguous and not found.ambiguous:
        covariance = covariance + between(found.best, second)
    expected = Sighting(
        pose=pose.tolist(),
        covariance=covariance.ravel().tolist(),
        tags=sorted({one.tag for one in found.used}),
        error_px=0.0,
        age_s=0.0,
        pictures=look.pictures,
        ambiguous=ambiguous,
        velocity=NO_MOTION if follows else None,
        cameras=sorted({one.view.camera for one in found.used}) if len(views) > 1 else [],
    )
    return expected, ""


def observations(
    query: WorldQuery, scene: Scene, view: optics.View, body: str, pose: Array
) -> tuple[list[TagObservation], str]:
    """The tags of a body that a camera sees, and what hides one that it would see; "" if nothing hides any."""
    large = [
        tag for tag in sight.tags(query.cell, body) if (absence.across_px(tag, pose, view) or 0.0) >= absence.MIN_PX
    ]
    if not large:
        return [], ""
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
    return found, next(filter(None, before), "")
