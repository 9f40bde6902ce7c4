"""An unmet precondition of a script, and the advice that empties a hand. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from rtc.programs.schema import ElaboratorProgram
from rtc.protocol.advice import Advice, Texts, fill_in
from rtc.protocol.causes import NeedUnmet
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from workers.planning.motion import ik
from workers.planning.world_query import WorldQuery
from workers.tasks.seated import IN_SEAT_M, seat_at


class UnmetPrecondition(NamedTuple):
    """An unmet precondition, the object or arm that causes it, and the row of `needs` that clears it (else its own)."""

    message: str
    held: str
    row: str = ""
    thing: str = ""  # the object to let go of, if it is not `held`


def let_go(rows: Mapping[str, Advice], query: WorldQuery, thing: str) -> Advice:
    """The command that empties the hand: in place if the object stays there; else into a free seat in its reach."""
    exists = thing in {one.name for one in query.cell.objects}
    if not exists or query.hinge(thing) is not None or seat_at(query.frame(thing), query, IN_SEAT_M):
        return fill_in(rows.get("let_go", []), {"held": thing})
    taken = {query.seat(known.name) for known in query.cell.objects if known.name != thing}
    open_to_place = [seat.name for seat in query.cell.seats if seat.mating is None and seat.name not in taken]
    free = [seat for seat in open_to_place if _reaches(query, thing, seat)]
    row = "let_go_in_air" if free else "let_go"
    return fill_in(rows.get(row, []), {"held": thing, "free": free})


def _reaches(query: WorldQuery, thing: str, seat: str) -> bool:
    """Whether the arm that holds the object has a posture with it in the seat; true if its place in the hand is not
    known."""
    arm, grasp = query.held_by(thing), query.grasp(thing)
    if arm not in query.model.arms or grasp is None:
        return True
    tcp = geometry.compose(query.seated_pose(seat), geometry.inverse(grasp))
    return bool(ik.solutions(query.algorithms.ik, query.model.arms[arm], tcp.tolist()).found)


def refuse_held(program: ElaboratorProgram, thing: str, query: WorldQuery) -> None:
    """Refuse to state the place of an object that a hand has."""
    if holder := query.held_by(thing):
        texts: Texts = {"let_go": let_go(program.needs, query, thing), "object": thing}
        clears = fill_in(program.needs["object_free"], texts)
        cause = NeedUnmet(need="object_free", by=holder)
        raise Refused.because(RefusalReason.STATE, f"{thing} is held by {holder}", clears=clears, cause=cause)
