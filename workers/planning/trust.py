"""Which facts are trusted, how uncertain poses are, and what would clear a doubt. Pure.

A fact that is not trusted yields a Refusal that states what would clear it. So does a held object whose pose is too
uncertain for a step. A step states the requirement: `needs_m` and `needs_rad` for all axes, or `needs`, a
seat with its own bounds (`needs_within` in the cell). The elaborator and the binder both check it, because uncertainty
grows with each motion and with impacts. The elaborator adds the time of the motions before the step, so that an
accepted command can end. No time of a clock enters: a doubt is as large after an hour of rest as before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from rtc.language.hands import hand_in_words
from rtc.model.cells.parts import Numbers
from rtc.protocol import causes
from rtc.protocol.advice import Advice, by_person, fill_in
from rtc.protocol.messages import ArmStep, BaseStep, Limits
from rtc.protocol.outcomes import Refusal, RefusalReason, Sighting
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from rtc.world.facts import TRUSTED
from rtc.world.spread import Spread, even, exceeded
from workers.planning import pose_spread
from workers.planning.world_query import WorldQuery

SIGMAS = 5.0  # half-width of a bound, in standard deviations; the errors of corners in one picture are not independent
UNSURE_STEP_M = 0.001  # spreads are rounded up to a multiple of this: a way stays valid while a grasp creeps a little
# Time allowed for a motion at the cell's speed, in which a held object creeps. A carry across the default cell takes
# 7.5 s.
AHEAD_S = 10.0
THERE_M, THERE_RAD = 0.05, 0.2  # a body that has gone farther may be seen with another accuracy


def distrusted(query: WorldQuery, key: str, clears: Mapping[str, Advice], own: str = "") -> Refusal | None:
    """The refusal for a fact that is not trusted; None if it is trusted.

    `own`: the id of the running command. A fact that this command itself made suspect is accepted, because its
    script is about to correct it. A fact that another arm changes now is waited for (`in_the_way`). What is mounted on
    a body is trusted no more than the frame of that body, which is `where` then.
    """
    if arm := query.mover_of(key):
        return _changing(key, arm)
    location, _, attribute = key.rpartition(".")
    fact = query.world.get(key)
    if fact is None or fact.validity in TRUSTED or (own and fact.source.partition("/")[0] == own):
        body = query.bodies.get(location) if attribute == "frame" else None
        return distrusted(query, f"{body}.frame", clears, own) if body is not None else None
    return Refusal(
        reason=RefusalReason.SUSPECT,
        message=f"the {attribute} of {location} is {fact.validity.value} since {fact.source.partition('/')[0]}",
        where=key,
        clears=remedy(query, key, clears),
        cause=causes.Distrusted(fact=key, validity=fact.validity.value, source=fact.source, version=fact.version),
    )


def _changing(key: str, arm: str) -> Refusal:
    location, _, attribute = key.rpartition(".")
    return Refusal(
        reason=RefusalReason.SUSPECT,
        message=f"the {attribute} of {location} is changing: {arm} moves",
        where=key,
        clears=by_person(f"wait until {arm} is at rest"),
        cause=causes.Changing(fact=key),
        in_the_way=arm,
    )


def remedy(query: WorldQuery, key: str, clears: Mapping[str, Advice]) -> Advice:
    """The remedy that would make this fact trusted again. For a held object, clearing the grasp also clears the
    frame."""
    location, _, attribute = key.rpartition(".")
    holder = query.held_by(location)
    row = attribute
    if attribute in ("frame", "angle"):
        row = "grasp" if holder else "angle" if query.hinge(location) and "angle" in clears else attribute
    if attribute in ("frame", "turns", "state") and query.thread(location) is not None:
        row = "turns"
    if row == "frame" and "seen" in clears and _look_helps(query, location):
        row = "seat_seen" if "seat_seen" in clears and query.is_seat(location) else "seen"
    elif row == "frame" and not query.placed(location):
        row = "unplaced" if "unplaced" in clears else row
    texts = {"location": location, "holder": [hand_in_words(holder)] if holder else []}
    if any(location == part.name for group in (query.cell.objects, query.cell.seats) for part in group):
        frame = query.pose(location)
        texts |= {"position": _figures(100 * frame[:3]), "attitude": _figures(np.degrees(geometry.to_rpy(frame)))}
    texts["angle"] = _figures(np.degrees([query.angle(location)]))
    return fill_in(clears.get(row, []), texts) or by_person(f"sense {location} again")


def narrows(
    query: WorldQuery, key: str, clears: Mapping[str, Advice], suffices: Callable[[Spread], bool] = lambda _: True
) -> Advice:
    """The remedy that makes the spread of the pose of an object or seat small enough: a look, or a statement.

    `suffices`: whether a spread is. A look knows as much as the last one from there."""
    location, _, _ = key.rpartition(".")
    row, place, seen = "spread", "", last_look(query, location)
    tells_more = seen is None or (not as_seen(query, key) and suffices(seen))
    if "spread_seen" in clears and tells_more and _look_helps(query, location):
        row = "spread_seen"
    elif "spread_shown" in clears and not query.cameras(location) and (place := shown_at(query, location)):
        row = "spread_shown"
    texts = {"location": location, "place": place, "holder": hand_in_words(query.held_by(location))}
    stated = suffices(stated_spread(query.cell.numbers))
    advice = [one for one in fill_in(clears.get(row, []), texts) if stated or not one.states]
    down = query.held_by(location) and not stated
    return advice or by_person(f"put {location} down, and grasp it again" if down else f"sense {location} again")


def stated_spread(numbers: Numbers) -> list[float]:
    """Of a pose that a person states."""
    return even(numbers.stated_m, numbers.stated_rad)


def last_look(query: WorldQuery, body: str) -> list[float] | None:
    """The spread of the pose of a body as the last look has measured it; None: it has not been seen about there."""
    seen = query.world.value(f"{body}.sighting")
    if seen is None or "spread" not in seen:
        return None
    here = query.pose(body)
    near = geometry.distance(seen["pose"], here) <= THERE_M and geometry.angle(seen["pose"], here) <= THERE_RAD
    return seen["spread"] if near else None


def as_seen(query: WorldQuery, key: str) -> bool:
    """Whether the pose of an object or seat is known as well as the last look has measured it, or better: by a
    statement, say. Then another look does not help."""
    body = key.rpartition(".")[0]
    seen = last_look(query, body)
    return seen is not None and 0.0 < off_m(query, body, query.spread(key)) <= off_m(query, body, seen)


def sees_within_m(query: WorldQuery, body: str, sighting: Sighting) -> float:
    """The same of a look with this accuracy."""
    return _within_m(query, body, *deviations(sighting))


def _within_m(query: WorldQuery, body: str, metres: float, radians: float) -> float:
    return off_m(query, body, even(SIGMAS * metres, SIGMAS * radians))


def deviations(sighting: Sighting) -> tuple[float, float]:
    """The largest standard deviation of its position along a world axis (m), and of its attitude about one (rad)."""
    variances = [max(0.0, sighting.covariance[7 * n]) for n in range(6)]
    return math.sqrt(max(variances[:3])), math.sqrt(max(variances[3:]))


def shown_at(query: WorldQuery, held: str) -> str:
    """The place to which its hand may bring a held object so that a camera sees it; empty if there is none."""
    arm, grasp = query.held_by(held), query.grasp(held)
    if not arm or grasp is None or query.sharers(arm) or query.seat(held):
        return ""
    for place in query.places:
        joints = place.joints_rad(arm)
        if joints is None and arm not in place.poses:
            continue
        tcp = query.model.arms[arm].fk(joints) if joints is not None else place.poses[arm].pose
        hands = {**{one.name: query.tcp(one.name) for one in query.cell.arms}, arm: tcp}
        if query.model.sight.cameras(held, geometry.compose(tcp, grasp), hands.__getitem__):
            return place.name
    return ""


def _look_helps(query: WorldQuery, body: str) -> bool:
    """Whether a camera can see the body, and a look may say more than is known: a seat stays where one saw it, and what
    the last look has missed the next one misses too."""
    seen = query.is_seat(body) and query.world.get(f"{body}.sighting") is not None
    return not seen and query.finds(body)


def unsure_key(query: WorldQuery, body: str) -> str:
    """The fact whose spread makes the place of a body uncertain; empty if it is exact."""
    inside = query.inside(body)
    keys = [f"{body}.grasp" if query.held_by(body) else f"{body}.frame", *(f"{name}.frame" for name in inside)]
    return max((key for key in keys if any(query.spread(key))), key=lambda key: max(query.spread(key)), default="")


def grasp_spread(query: WorldQuery, thing: str, ahead_s: float = 0.0) -> Spread:
    """Uncertainty of a held object's pose after `ahead_s` more of motion."""
    return pose_spread.crept_spread(query.spread(f"{thing}.grasp"), ahead_s, query.cell.numbers)


def unsure_m(query: WorldQuery, poses: Iterable[str], held: Iterable[str]) -> dict[str, float]:
    """How far any point of a body may be from its believed place: of objects, of the seats that hold them, and of
    held objects."""
    found = {name: off_m(query, name, query.spread(f"{name}.frame")) for name in poses}
    found |= {name: off_m(query, name, grasp_spread(query, name, AHEAD_S)) for name in held}
    for name in list(found):
        if (seat := query.seat(name)) and name not in held:
            found[seat] = max(found[name], found.get(seat, 0.0))
    return {name: most_m for name, most_m in found.items() if most_m > 0.0}


def off_m(query: WorldQuery, body: str, spread: Spread) -> float:
    """How far a point of a body is from its place at most, if its pose has this spread."""
    if not any(spread):
        return 0.0
    turns, most_m = spread[3:], math.hypot(*spread[:3])
    driver = query.model.drivers.get(body)
    if driver is not None:  # a turn about its spindle, by the torque of a bolt, moves its tip nowhere
        most_m += float(np.asarray(turns) @ driver.axis) * driver.aside_m
        turns = (np.asarray(turns) * (1.0 - driver.axis)).tolist()
    most_m += math.hypot(*turns) * query.model.collision.radius_m(body)
    return UNSURE_STEP_M * math.ceil(most_m / UNSURE_STEP_M - 1e-9)


def motion_time_s(query: WorldQuery, limits: Limits) -> float:
    """Time allowed for one motion, in proportion to the speed stated in the command."""
    free_m_s = query.cell.numbers.free_speed_m_s
    speed_m_s = min(limits.speed_m_s or free_m_s, free_m_s * (limits.speed_ratio or 1.0))
    return AHEAD_S * max(1.0, free_m_s / speed_m_s)


def why_uncertain(
    query: WorldQuery, arm: str, step: BaseStep, clears: Mapping[str, Advice], ahead_s: float = 0.0
) -> Refusal | None:
    """The refusal of a step for which the grasp of the held object is too uncertain; None: certain, or an empty hand.

    `ahead_s`: how long the arm moves before the step begins.
    """
    held = query.holding(arm)
    within = needed(query, step) if held else None
    if within is None:
        return None
    key = f"{held}.grasp"
    axes = _too_wide(query, query.spread(key), within, ahead_s)
    if not axes:
        return None
    return Refusal(
        reason=RefusalReason.SUSPECT,
        message=f"the grasp of {held} by {arm} is too uncertain for this: {', '.join(axes)}",
        where=key,
        clears=narrows(query, key, clears, lambda spread: not _too_wide(query, spread, within, ahead_s)),
        cause=causes.TooUncertain(fact=key),
    )


def _too_wide(query: WorldQuery, spread: Spread, within: Spread, ahead_s: float) -> list[str]:
    return exceeded(pose_spread.crept_spread(spread, ahead_s, query.cell.numbers), within)


def needed(query: WorldQuery, step: BaseStep) -> Spread | None:
    """The maximum spread that a step accepts; None if it has no requirement."""
    if not isinstance(step, ArmStep):
        return None
    if step.needs:
        within = query.cell.seat(step.needs).needs_within
        return within.spread if within is not None else None
    metres, radians = step.needs_m, step.needs_rad
    if metres is None and radians is None:
        return None
    return even(*(math.inf if n is None else n for n in (metres, radians)))


def _figures(values: Array) -> str:
    """Numbers for a sentence: two decimals, without negative zero."""
    return " ".join(f"{round(float(x), 2) + 0:g}" for x in values)
