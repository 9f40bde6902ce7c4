"""Bolts in a script: the figures of a thread, a driver in the hand, anchors on a head, and what is refused. Pure."""

from __future__ import annotations

import math
from typing import Any

from rtc.programs import expressions
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol import causes
from rtc.protocol.advice import by_sentence, fill_in, in_order
from rtc.protocol.messages import Validity
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry, hinges
from rtc.spatial.geometry import Array
from rtc.world.model import LOOSE, TIGHT
from workers.mechanisms.mechanism import Thing
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery
from workers.tasks.anchor import Anchor, refused
from workers.tasks.candidate import AskedTask, TaskCandidate, lets_go_first
from workers.tasks.unmet import UnmetPrecondition

LEAST_TURNS = 0.02  # a smaller turn is none
SHARE = 0.8  # of the greatest torque, that advised sentences use
ALONG_BOLT = (0.0, 0.0, 1.0)  # z of the tip of a spindle


def figures(candidate: TaskCandidate) -> dict[str, float]:
    """Whether the object is a driver or a bolt, and how far a bolt is out."""
    thing = candidate.thing
    if thing is None:
        return {}
    found = {"has_spindle": float(thing.spindle is not None), "threaded": float(thing.thread is not None)}
    if thing.thread is not None:
        found |= {"out_turns": candidate.query.turns(thing.name), "thread_turns": thing.thread.turns}
        found["thread_m"] = thing.thread.pitch_m * thing.thread.turns
    return found


def arms_with_driver(asked: AskedTask) -> list[str]:
    """The arms that hold a driver, for a bolt."""
    query, thing = asked.query, asked.parsed.object
    turns = thing is not None and asked.parsed.hand is None and query.thread(thing) is not None
    return [arm.name for arm in query.cell.arms if query.driver(arm.name)] if turns else []


def driver_held(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The hand holds an object with a spindle."""
    query, arm = candidate.query, candidate.arm.name
    if query.driver(arm) is not None:
        return None
    drivers = [thing.name for thing in query.cell.objects if thing.spindle is not None]
    if not drivers:
        return UnmetPrecondition(f"{query.cell.name} has no driver", "", "driver_there")
    driver = drivers[0]
    if holder := query.held_by(driver):
        return UnmetPrecondition(f"{driver} is held by {holder}, not by {arm}", holder, "held_by_another", driver)
    if held := query.holding(arm):
        return UnmetPrecondition(f"{arm} holds {held}, and no driver", driver, "driver_hand_full", held)
    return UnmetPrecondition(f"{arm} holds no driver", driver)


def stated_state(_: ElaboratorProgram, values: list[Any], thing: Thing, query: WorldQuery) -> dict[str, Any]:
    """The state of a bolt; another object has none. Its turns and its frame follow from it."""
    stated = (TIGHT, LOOSE)
    if query.thread(thing.name) is not None and values[0] not in stated:
        raise suggestions.unknown("state of a bolt", values[0], stated, where=values[0])
    return {f"{thing.name}.state": values[0]}


def bolt(candidate: TaskCandidate) -> Anchor:
    """The tcp pose at which the spindle of the held driver is on the head of the bolt, in the bolt's frame.

    A bolt may be turned from any side: the hand keeps the attitude nearest to that of its home."""
    name, grasp, pose = _on_head(candidate)
    driver = candidate.query.holding(candidate.arm.name)
    relies_on = (f"{driver}.grasp", f"{name}.frame")
    return Anchor(pose=pose.tolist(), frame=name, grasp=grasp.tolist(), relies_on=relies_on)


def bolt_out(candidate: TaskCandidate) -> Anchor:
    """The same on the head of the bolt when it is out by all its turns, whether it is or not (world frame)."""
    name, grasp, pose = _on_head(candidate)
    thread = candidate.query.thread(name)
    assert thread is not None
    out = geometry.compose(candidate.query.turned_out(name, thread.turns), pose)
    driver = candidate.query.holding(candidate.arm.name)
    return Anchor(pose=out.tolist(), grasp=grasp.tolist(), relies_on=(f"{driver}.grasp",))


def _on_head(candidate: TaskCandidate) -> tuple[str, Array, Array]:
    """The bolt, the grasp of the driver, and the tcp pose on the head in the bolt's frame."""
    assert candidate.thing is not None
    name, query = candidate.thing.name, candidate.query
    driver = query.driver(candidate.arm.name)
    grasp = query.grasp(driver.name) if driver is not None else None
    if candidate.thing.thread is None or driver is None or driver.spindle is None or grasp is None:
        raise refused(f"{candidate.arm.name} cannot turn {name}", "an object with a thread, and a driver in the hand")
    tip = geometry.compose(grasp, driver.spindle.frame.pose)
    facing = geometry.from_rpy((0.0, 0.0, 0.0), (math.pi, 0.0, 0.0))  # the axes of tip and bolt are opposed
    home = query.model.arms[candidate.arm.name].fk(candidate.arm.home_rad)
    angle = hinges.angle_of(geometry.compose(query.frame(name), facing), ALONG_BOLT, geometry.compose(home, tip))
    return name, grasp, geometry.compose(hinges.turned(facing, ALONG_BOLT, angle), geometry.inverse(tip))


def refuse_beyond_thread(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to turn a bolt beyond the ends of its thread, or not at all. A turn that a torque ends may go on."""
    thing, parsed = candidate.thing, candidate.parsed
    steps = [step for step in script.steps if "to_turns" in step.args]
    if thing is None or thing.thread is None or not steps:
        return
    now, most = candidate.query.turns(thing.name), thing.thread.turns
    for step in steps:
        there = expressions.number(step.args["to_turns"], candidate.figures)
        ends = parsed.amount is None  # by the end of the thread, or a condition
        if (there > now and now > most - LEAST_TURNS) or (abs(there - now) < LEAST_TURNS and not ends):
            raise _there(candidate, now, most)
        if not ends and not -LEAST_TURNS <= there <= most + LEAST_TURNS:
            raise _beyond(candidate, there, now, most)


def refuse_too_much_torque(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse a turn until a torque that the driver does not have, or that the sentence forbids."""
    until, thing, most_nm = candidate.parsed.until, candidate.thing, candidate.figures.get("most_nm")
    if thing is None or thing.thread is None or until is None or most_nm is None or until.quantity is None:
        return
    driver = candidate.query.driver(candidate.arm.name)
    limits = [most_nm, candidate.limits.torque_nm, driver.spindle.most_nm if driver and driver.spindle else None]
    limit_nm = min(limit for limit in limits if limit is not None)
    if until.measure != "TORQUE" or until.bound != "above" or until.quantity.value < limit_nm:
        return
    raise Refused.because(
        RefusalReason.INFEASIBLE,
        f"UNTIL {until.sentence}: {candidate.arm.name} turns {thing.name} with {limit_nm:g} N.m at most",
        where="UNTIL",
        clears=f"a value below {limit_nm:g} NM: UNTIL TORQUE EXCEEDS {SHARE * limit_nm:.2g} NM",
        cause=causes.UntilTorque(value_nm=until.quantity.value, limit_nm=limit_nm),
    )


def _there(candidate: TaskCandidate, now: float, most: float) -> Refused:
    message = f"{candidate.body} is {now:g} of {most:g} turns out: nothing to turn"
    clears = candidate.program.needs.get("turned_out" if now > most - LEAST_TURNS else "turned_in", [])
    return Refused.because(RefusalReason.STATE, message, clears=fill_in(clears, {"bolt": candidate.body}))


def _beyond(candidate: TaskCandidate, there: float, now: float, most: float) -> Refused:
    left = most - now if there > most else now
    if left < LEAST_TURNS:
        raise _there(candidate, now, most)
    return Refused.because(
        RefusalReason.INFEASIBLE,
        f"{candidate.body} has {most:g} turns, and is {now:g} out: it does not turn to {there:g}",
        clears=by_sentence(f"{candidate.parsed.verb} {candidate.body} BY {left:g} TURNS", instead=True),
        cause=causes.BeyondThread(value_turns=there, most_turns=most),
    )


def refuse_fastened(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to move a held object that bolts fasten in its seat, or to bring it into a seat whose bolts are in."""
    if candidate.hand is None or not any(step.to for step in script.steps) or lets_go_first(script):
        return
    query = candidate.query
    held = query.holding(candidate.arm.name)
    if not held or query.hinge(held) is not None:
        return
    seats = [query.seat(held) or query.seat_around(held), candidate.target.name if candidate.target else ""]
    for seat in filter(None, seats):
        bolts = query.fastening(seat)
        if not bolts:
            continue
        fact = query.world.get(f"{bolts[0]}.state")
        known = fact is None or fact.validity is Validity.VALID
        names = ", ".join(bolts)
        inside = f"{held} is fastened in {seat} by {names}"
        words = inside if seat == seats[0] else f"{held} does not go into {seat}: {names} must be turned out first"
        row = "bolts_loose" if known else "bolts_known"
        raise Refused.because(
            RefusalReason.STATE if known else RefusalReason.SUSPECT,
            words if known else f"{names} may not be turned out of {seat}",
            where=seat,
            clears=in_order(*(fill_in(candidate.program.needs.get(row, []), {"bolt": bolt}) for bolt in bolts)),
            cause=causes.Fastened(seat=seat),
        )
