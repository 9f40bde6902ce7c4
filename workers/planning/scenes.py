"""The collision scene of the current facts, and the request to a planner in it. Pure."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from rtc.model.robot.collision_scene import AttachedBody, Held, Scene
from rtc.protocol.messages import Limits
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.planning import trust
from workers.planning.motion.constraints import ATTITUDE_RAD, PathConstraints, attitude_tolerance_rad, loaded
from workers.planning.motion.request import PlanningRequest
from workers.planning.motion.timing import SpeedLimits
from workers.planning.world_query import WorldQuery

# Least distance of arms and held objects from all that a command does not mean to touch, if it states none. The hand
# tracks a path to tenths of a millimetre.
CLEARANCE_M = 0.005
ARMS_APART_M = 0.005  # least distance of a planned path from another arm


def scene_of(
    query: WorldQuery,
    arm: str,
    limits: Limits,
    *,
    touching: str = "",
    seated: bool = False,
    ignore_suspect: bool = False,
    opening_m: float | None = None,
    exempt: Iterable[str] = (),
    unsure: bool = True,
) -> Scene:
    """The collision scene from the current facts.

    `touching`: the object that this arm's hand may touch. `seated`: the held object may be in the seat that it is
    in now, or enter a seat of `exempt`.
    `ignore_suspect`: objects with suspect frames are not obstacles. `opening_m`: opening of this arm's hand, if it
    differs from the current one. `exempt`: bodies that the command means to touch. `unsure`: keep as much distance
    as poses are uncertain.
    """
    held: dict[str, Held] = {}
    attached: dict[str, AttachedBody] = {}
    ignore: list[tuple[str, str]] = []
    moved_seats = [seat.name for seat in query.cell.seats if query.world.get(f"{seat.name}.frame") is not None]
    poses: dict[str, Array] = {name: query.seat_frame(name) for name in moved_seats}
    coupled = query.model.coupled
    for thing in query.cell.objects:
        if thing.name in coupled:
            continue
        holder, grasp = query.held_by(thing.name), query.grasp(thing.name)
        if holder and grasp is not None and thing.hinge is None:
            held[thing.name] = Held(holder, grasp)
        elif thing.thread is not None:
            poses[thing.name] = query.frame(thing.name)
        elif not thing.fixed or thing.name in query.displaced:
            if holder and grasp is not None and thing.hinge is not None:
                grip = geometry.inverse(grasp)[:3]
                if thing.mounted_on is not None:  # its stops say how far it turns there
                    ignore.append((thing.name, thing.mounted_on))
                attached[thing.name] = AttachedBody(
                    holder, query.hinge_home(thing.name), thing.hinge.axis, thing.hinge.range_rad, grip
                )
            poses[thing.name] = query.frame(thing.name)
    openings = {a.name: query.hand_width(a.name) for a in query.cell.arms}
    if opening_m is not None:
        openings[arm] = opening_m
    carried = query.holding(arm)
    close = [name for name in dict.fromkeys((touching, *exempt)) if name and name not in {*held, *coupled}]
    if touching:
        ignore += hand_contacts(query, arm, touching)
    doubtful = [
        name for name in poses if ignore_suspect and name not in moved_seats and not query.trusts(f"{name}.frame")
    ]
    ignore += [pair for name in doubtful for pair in ((arm, name), *([(carried, name)] if carried else []))]
    if carried and ignore_suspect and not query.trusts(f"{carried}.grasp"):
        ignore += [(carried, seat.name) for seat in query.cell.seats]
    elif carried and seated:
        ignore += seat_contacts(query, carried, exempt)
    return Scene(
        poses=poses,
        held=held,
        attached=attached,
        openings_m=openings,
        ignore=ignore,
        clearance_m=clearance_of(limits),
        near=[*close, *(seat for seat in map(query.seat, filter(None, (*close, carried))) if seat), *attached],
        close=beside_bolt(query, arm, touching),
        pose_tolerance_m=trust.unsure_m(query, poses, held) if unsure else {},
        keep_out=limits.keep_out,
        arms_apart_m=ARMS_APART_M,
        moving=arm,
    )


def clearance_of(limits: Limits) -> float:
    """The clearance (m) that a command asks for: that of AVOID-NEIGHBORS, which may be less than the default."""
    return CLEARANCE_M if limits.clearance_m is None else limits.clearance_m


def beside_bolt(query: WorldQuery, arm: str, touching: str) -> dict[tuple[str, str], float]:
    """Pairs of bodies with a smaller clearance (m), as in `Scene.close`: a driver that feels for the head of a bolt
    comes near to what the bolt is in. Empty for other objects."""
    driver = query.driver(arm) if touching and query.thread(touching) is not None else None
    if driver is None:
        return {}
    return {(driver.name, thing.name): 0.0 for thing in query.cell.objects if thing.fixed and thing.thread is None}


def seat_contacts(query: WorldQuery, carried: str, entered: Iterable[str] = ()) -> list[tuple[str, str]]:
    """The pairs of a held object and a seat that may touch: the seat that it is in, and these ones."""
    seats = {query.seat(carried), query.seat_around(carried), *entered}
    return [(carried, seat.name) for seat in query.cell.seats if seat.name in seats]


def hand_contacts(query: WorldQuery, arm: str, thing: str) -> list[tuple[str, str]]:
    """The pairs of this arm's hand, or of the driver in it, and an object that may touch; its seat too, because both
    poses share an error."""
    hand, driver = query.cell.arm(arm).gripper, query.driver(arm)
    met = [name for name in (thing, query.seat(thing)) if name and name not in query.model.coupled]
    touching = [f"{arm} {link}" for link in (*hand.finger_links, hand.palm_link)]
    if driver is not None:
        touching.append(driver.name)
    return [(one, name) for name in met for one in touching]


def planning_request(
    query: WorldQuery, arm: str, scene: Scene, limits: Limits, pace: SpeedLimits, margin_rad: float
) -> PlanningRequest:
    attitude = query.cell.attitudes[limits.attitude] if limits.attitude else None
    carries = arm in {held.arm for held in scene.held.values()}
    within = PathConstraints(
        work_range=query.cell.region(limits.work_range) if limits.work_range else None,
        attitude=attitude,
        attitude_name=limits.attitude or "",
        attitude_tolerance_rad=attitude_tolerance_rad(query.tcp(arm), attitude) if attitude else ATTITUDE_RAD,
    )
    return PlanningRequest(
        arm=query.model.arms[arm],
        world=query.model.collision,
        joints={a.name: np.array(query.joints(a.name), dtype=float) for a in query.cell.arms},
        scene=scene,
        path_constraints=loaded(within, query.load_boxes(arm) if carries else [], query.tcp(arm)),
        pace=pace,
        margin_rad=margin_rad,
        load=query.load(arm) if carries else None,
        seed=query.seed,
        algorithms=query.algorithms,
    )
