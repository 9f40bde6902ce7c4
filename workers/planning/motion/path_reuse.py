"""Hand a way that the elaborator has found free to the binder, so that the binder need not plan it again. Pure.

A way is free for one planning request only: the arm, the joints of all arms, the goal, the scene and the rules. The
digest covers all of these. A worker uses the way if its own request has the same digest. Otherwise it plans anew, and
a way aside between the same postures is tested again before others are searched.
Versions of facts are not needed, because the digest covers the values of the facts.
"""

from __future__ import annotations

import hashlib
from typing import Any

import msgspec
import numpy as np

from rtc.programs.schema import OWN
from rtc.protocol.messages import PlannedPath
from rtc.spatial.geometry import Floats
from workers.planning.motion.blended import Blended
from workers.planning.motion.path import Path
from workers.planning.motion.request import FreeWay, PlanningRequest
from workers.planning.motion.spline import Spline

DIGEST_BYTES = 12


def request_digest(request: PlanningRequest, space: str, goal: Floats) -> bytes:
    """The digest of a request for a way of this arm to `goal` (rad, or a pose of the tcp in world axes).

    The pace is left out: the way does not depend on it. Planners are added if there is a choice of them.
    """
    asked: tuple[Any, ...] = (
        request.world.cell_digest,
        request.arm.name,
        space,
        np.asarray(goal, dtype=float),
        {arm: np.asarray(joints, dtype=float) for arm, joints in request.joints.items()},
        request.margin_rad,
        request.scene,
        request.path_constraints,
    )
    if request.algorithms.planners != [OWN]:
        asked = (*asked, request.algorithms.planners)
    return hashlib.blake2b(_encoder.encode(asked), digest_size=DIGEST_BYTES).digest()


def to_message(asked: bytes, found: FreeWay) -> PlannedPath:
    """The way as it is sent. `asked`: the digest of the request for which it was found."""
    path = found.path
    radii = path.curve.radii.tolist() if isinstance(path.curve, Blended) else []
    s, knots, notes = path.s.tolist(), path.knots.tolist(), list(found.notes)
    return PlannedPath(request_digest=asked, space=path.space, s=s, knots=knots, radii=radii, notes=notes)


def from_message(way: PlannedPath) -> FreeWay:
    """The way as it was found, with the same curve."""
    s, knots = np.array(way.s), np.array(way.knots)
    curve: Blended | Spline | None = None
    if way.space == "task":
        curve = Spline(s, knots)
    elif len(knots) > 2:
        curve = Blended(s, knots, np.array(way.radii))
    return FreeWay(Path(way.space, s, knots, curve), way.notes)


def _plain(array: Any) -> Any:
    return array.tobytes()


_encoder = msgspec.msgpack.Encoder(enc_hook=_plain)
