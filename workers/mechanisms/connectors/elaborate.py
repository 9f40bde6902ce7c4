"""Connectors in a script: whether a plug fits a socket, where it meets the contacts, and what is refused. Pure."""

from __future__ import annotations

import math
from typing import Any

from rtc.model.cells import parts
from rtc.programs.schema import ElaboratorProgram, ScriptFile
from rtc.protocol import causes
from rtc.protocol.advice import fill_in
from rtc.protocol.outcomes import RefusalReason, Refused
from workers.mechanisms.connectors.state import MATED, STATES, may_be_mated, plug, socket, state
from workers.mechanisms.mechanism import Thing
from workers.planning import suggestions
from workers.planning.world_query import WorldQuery
from workers.tasks.candidate import TaskCandidate, lets_go_first
from workers.tasks.unmet import UnmetPrecondition

CLICKED, DEMATED = "clicked", "demated"  # effects of the steps that press a plug in, and pull it out


def figures(candidate: TaskCandidate) -> dict[str, float]:
    """Where a plug meets the contacts of the socket that it goes to, or is in, and what the latch bears."""
    thing = candidate.thing
    if thing is None or thing.plug is None:
        return {}
    seat = candidate.target or socket(candidate.query, thing.name)
    if seat is None or seat.mating is None:
        return {}
    return {"contacts_m": seat.mating.depth_m, "holds_n": seat.mating.holds_n}


def plug_fits(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The target is a socket of the connector whose plug the object is."""
    thing, target = candidate.thing, candidate.target
    assert thing is not None
    assert target is not None
    if target.mating is not None and thing.plug == target.mating.connector:
        return None
    what = f"a {thing.plug} plug" if thing.plug is not None else "no plug"
    where = f"a {target.mating.connector} socket" if target.mating is not None else "no socket"
    return UnmetPrecondition(f"{thing.name} is {what}, and {target.name} is {where}", target.name)


def in_socket(candidate: TaskCandidate) -> UnmetPrecondition | None:
    """The object is a plug in a socket, wholly or in part."""
    assert candidate.thing is not None
    name = candidate.thing.name
    if plug(candidate.query, name) is not None and socket(candidate.query, name) is not None:
        return None
    return UnmetPrecondition(f"{name} is in no socket", name)


def mated_already(script: ScriptFile, candidate: TaskCandidate) -> tuple[str, str] | None:
    """That a plug is mated before the script that mates it, and the row of `needs`."""
    query, thing, target = candidate.query, candidate.thing, candidate.target
    if thing is None or target is None or not _has(script, CLICKED):
        return None
    known = state(query, thing.name) == MATED and query.trusts(f"{thing.name}.mating")
    inside = query.seat(thing.name) == target.name
    return (f"{thing.name} is mated with {target.name} already", "mated_already") if known and inside else None


def refuse_latched(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to move a held plug that its latch holds, or may hold, but to pull it out."""
    if candidate.hand is None or not any(step.to for step in script.steps) or lets_go_first(script):
        return
    query = candidate.query
    held = query.holding(candidate.arm.name)
    if plug(query, held) is None or _has(script, DEMATED) or not may_be_mated(query, held):
        return
    seat = socket(query, held)
    if seat is None or (_has(script, CLICKED) and candidate.target == seat):
        return
    known = query.trusts(f"{held}.mating")
    raise Refused.because(
        RefusalReason.STATE if known else RefusalReason.SUSPECT,
        f"the latch of {seat.name} {'holds' if known else 'may hold'} {held}",
        where=held,
        clears=fill_in(candidate.program.needs.get("demated", []), {"plug": held}),
        cause=causes.InSeat(arm=candidate.arm.name, seat=seat.name),
    )


def refuse_other_way_in(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse to put a plug into a socket without the proof of its latch."""
    thing, target = candidate.thing, candidate.target
    enters = any(step.words.get("seat") for step in script.steps)
    if thing is None or thing.plug is None or target is None or target.mating is None or not enters:
        return
    texts = {"plug": thing.name, "socket": target.name}
    raise Refused.because(
        RefusalReason.NOT_ALLOWED,
        f"{target.name} is a socket: what is put into it must click",
        where=target.name,
        clears=fill_in(candidate.program.needs.get("by_mating", []), texts),
    )


def refuse_too_weak(script: ScriptFile, candidate: TaskCandidate) -> None:
    """Refuse limits with which a plug cannot be pressed through its latch: a force that is too small, or a spring that
    is softer than the latch when it gives way."""
    target, limits = candidate.target, candidate.limits
    if target is None or target.mating is None or not _has(script, CLICKED):
        return
    mating, stiffness_n_m = target.mating, limits.stiffness_n_m
    most_n = mating.most_n / candidate.figures["spring_share"]
    if limits.force_n is not None and limits.force_n < most_n:
        raise Refused.because(
            RefusalReason.INFEASIBLE,
            f"the latch of {target.name} resists with {mating.most_n:g} N; "
            f"FORCE-LIMIT {limits.force_n:g} N is too little",
            where="FORCE-LIMIT",
            clears=f"FORCE-LIMIT of at least {math.ceil(most_n)} N, or none",
            cause=causes.ForceExceeded(limit_n=limits.force_n, value_n=most_n, arm=candidate.arm.name),
        )
    if stiffness_n_m is not None and stiffness_n_m <= mating.gives_way_n_m:
        raise Refused.because(
            RefusalReason.INFEASIBLE,
            f"the latch of {target.name} gives way by {mating.gives_way_n_m:g} N/m; a softer arm would strike its end",
            where="STIFFNESS",
            clears=f"STIFFNESS above {mating.gives_way_n_m:g} N/M, or none",
        )


def stated_mating(_: ElaboratorProgram, values: list[Any], thing: Thing, __: WorldQuery) -> dict[str, Any]:
    """Whether a plug is mated; another object is neither."""
    if isinstance(thing, parts.Object) and thing.plug is not None and values[0] not in STATES:
        raise suggestions.unknown("state of a plug", values[0], STATES, where=values[0])
    return {f"{thing.name}.mating": values[0]}


def _has(script: ScriptFile, effect: str) -> bool:
    return any(step.words.get("effect") == effect for step in script.steps)
