"""What cameras are expected to see of a body, and with what accuracy, if it is where it is believed to be. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable

from rtc.protocol.outcomes import Sighting
from rtc.sensing import absence, optics
from rtc.sensing.pose_fit import CONFUSED, TagObservation, between, fit
from rtc.spatial import geometry
from workers.planning.lines_of_sight import observations, scene_of
from workers.planning.world_query import WorldQuery

NO_MOTION = [0.0] * 6
# Error of corners in drawn pictures: less in 95 of 100 (n 138, two tags or more). Two attitudes that fit ideal corners
# with 0.43 px (n 10) were confused in pictures, from 0.55 px on (n 6) none were.
PICTURE_PX = 0.28


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
