"""One object in two hands: who holds it, whether one may move alone, and what changes when one lets go. Pure.

The facts `held_by` and `grasp` of an object refer to one hand, the leading one. Another hand that holds it too has it
as `holding` only.
"""

from __future__ import annotations

from collections.abc import Mapping

from rtc.language.hands import hand_in_words
from rtc.protocol import causes
from rtc.protocol.advice import Advice, fill_in
from rtc.protocol.messages import ScriptContext, Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.spatial import geometry
from workers.planning.world_query import WorldQuery


def held(
    arm: str,
    thing: str,
    grasp: list[float] | None,
    validity: Validity = Validity.VALID,
    spread: list[float] | None = None,
) -> list[WorldChange]:
    """The hand holds the object, at this pose in the frame of its tcp; None: in the hand as before."""
    return [
        WorldChange(key=f"{arm}.holding", value=thing, validity=validity),
        WorldChange(key=f"{thing}.held_by", value=arm, validity=validity),
        WorldChange(key=f"{thing}.grasp", value=grasp, keep_value=grasp is None, validity=validity, spread=spread),
    ]


def let_go(query: WorldQuery, arm: str, thing: str, validity: Validity = Validity.VALID) -> list[WorldChange]:
    """The hand no longer holds the object. If another hand holds it, its facts refer to that hand from now on."""
    changes = [WorldChange(key=f"{arm}.holding", value="")]
    if query.held_by(thing) not in ("", arm):
        doubt = WorldChange(key=f"{thing}.grasp", keep_value=True, validity=validity)
        return changes if validity is Validity.VALID else [*changes, doubt]
    keeps = next((a.name for a in query.cell.arms if a.name != arm and query.holding(a.name) == thing), "")
    frame = query.in_hand(thing, query.tcp(arm)) if keeps else None
    grasp = None if frame is None else geometry.normalise(geometry.relative(query.tcp(keeps), frame)).tolist()
    return [
        *changes,
        WorldChange(key=f"{thing}.held_by", value=keeps if grasp else "", validity=validity),
        WorldChange(key=f"{thing}.grasp", value=grasp, validity=validity if grasp else Validity.VALID),
    ]


def after_letting_go(query: WorldQuery, arm: str) -> WorldQuery:
    """The query as it is when this hand has let go of its object."""
    return query.after(let_go(query, arm, query.holding(arm)))


def free_points(query: WorldQuery, thing: str) -> list[str]:
    """The grasp points of the object at which no hand holds it."""
    used = points_in_use(query, thing).values()
    return [point.name for point in query.cell.object(thing).grasp_points if point.name not in used]


def points_in_use(query: WorldQuery, thing: str) -> dict[str, str]:
    """The grasp point that each hand holds the object at, by arm: the nearest one to the hand."""
    holders = [arm.name for arm in query.cell.arms if query.holding(arm.name) == thing]
    places = {
        point.name: geometry.compose(query.frame(thing), point.frame.pose)
        for point in query.cell.object(thing).grasp_points
    }
    if not places:
        return {}
    return {
        arm: min(places, key=lambda name: geometry.distance(query.tcp(arm), places[name]))
        for arm in dict.fromkeys((*filter(None, (query.held_by(thing),)), *holders))
    }


def refuse_alone(query: WorldQuery, arm: str, partner: str, clears: Mapping[str, Advice]) -> None:
    """Refuse a motion of one arm whose object another arm holds too."""
    sharing = query.sharers(arm)
    if partner or not sharing:
        return
    held = query.holding(arm)
    message = f"{arm} cannot move alone: {sharing[0]} holds {held} too"
    advice = fill_in(clears.get("shared", []), {"held": held, "other": hand_in_words(sharing[0])})
    cause = causes.NeedUnmet(need="shared", by=sharing[0])
    raise Refused.because(RefusalReason.STATE, message, clears=advice, cause=cause)


def offer(query: WorldQuery, context: ScriptContext) -> str:
    """The sentence that asks the operator instead; empty while another arm holds the same object."""
    return "" if query.sharers(context.arm) else context.by_operator
