"""A tool changer: the coupler of an arm takes a hand from its rack, and lays it down there."""

from __future__ import annotations

from rtc.protocol.messages import BoundStep, EvaluationContext, Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, Refused
from rtc.protocol.primitive import Coupling
from rtc.spatial import geometry
from rtc.spatial.geometry import Array
from workers.conditions.prediction import Expected
from workers.mechanisms.mechanism import Mechanism
from workers.planning.world_query import WorldQuery
from workers.tasks import assemble
from workers.tasks.analyze_task import AnalyzeTask, Changes
from workers.tasks.anchor import Anchor, refused
from workers.tasks.bind_task import BindTask
from workers.tasks.candidate import AskedTask, TaskCandidate
from workers.tasks.seated import CAUGHT_M, CAUGHT_RAD, seat_at
from workers.tasks.unmet import UnmetPrecondition

LOCKS_S = 0.25  # from the order until the coupler has locked or let go, and its fingers rest
LAID_DOWN = "tool_changer.laid_down"  # effect of a step that lets go


def coupling(query: WorldQuery, hand: str) -> Array:
    """Where the jaws of a coupler take a hand, in the axes of its object. Raises Refused."""
    for arm in query.cell.arms:
        for one in arm.hands:
            if one.name == hand:
                return query.cell.object(hand).grasp_point(one.coupling).frame.pose
    raise Refused.because(RefusalReason.STATE, f"no arm can have {hand or 'nothing'} in its coupler", clears="a hand")


def with_hand(query: WorldQuery, arm: str, hand: str) -> WorldQuery:
    return query.after([WorldChange(key=f"{arm}.hand", value=hand)])


# --- elaborate -------------------------------------------------------------------------------------------


def arms(asked: AskedTask) -> list[str]:
    """The arm that a hand is for."""
    return [arm.name for arm in asked.query.cell.arms if asked.parsed.object in {hand.name for hand in arm.hands}]


def empty(candidate: TaskCandidate) -> UnmetPrecondition | None:
    hand = candidate.query.hand(candidate.arm.name)
    return UnmetPrecondition(f"{candidate.arm.name} has {hand} in its coupler", hand) if hand else None


def coupled(candidate: TaskCandidate) -> UnmetPrecondition | None:
    assert candidate.thing is not None
    has, name = candidate.query.hand(candidate.arm.name), candidate.thing.name
    return None if has == name else UnmetPrecondition(f"{candidate.arm.name} has {has or 'no hand'}, not {name}", name)


def rack(candidate: TaskCandidate) -> Anchor:
    """The tcp of the arm with the hand when this lies in the rack."""
    if candidate.thing is None or candidate.target is None:
        raise refused("a hand and its rack are needed", "UNCOUPLE a hand ON its rack")
    query, arm, name, seat = candidate.query, candidate.arm, candidate.thing.name, candidate.target
    ends = [with_hand(query, arm.name, hand).model.arms[arm.name].fk(arm.home_rad) for hand in ("", name)]
    tool = geometry.compose(coupling(query, name), geometry.relative(*ends))
    pose = geometry.compose(seat.module_frame.pose, tool)
    return Anchor(pose=pose.tolist(), frame=seat.name, relies_on=(f"{seat.name}.frame",))


def will_be_taken(candidate: TaskCandidate, query: WorldQuery) -> Changes:
    assert candidate.thing is not None
    return [WorldChange(key=f"{candidate.arm.name}.hand", value=candidate.thing.name), *_gone(candidate.thing.name)]


def will_be_laid_down(candidate: TaskCandidate, query: WorldQuery) -> Changes:
    assert candidate.thing is not None
    assert candidate.target is not None
    name, seat = candidate.thing.name, candidate.target.name
    return [
        WorldChange(key=f"{candidate.arm.name}.hand", value=""),
        WorldChange(key=f"{name}.seat", value=seat),
        WorldChange(key=f"{name}.frame", value=query.seated_pose(seat).tolist()),
    ]


def _gone(hand: str) -> Changes:
    """A hand in a coupler is no object: it has no seat, and its frame is not followed."""
    frame = WorldChange(key=f"{hand}.frame", keep_value=True, validity=Validity.UNKNOWN)
    return [WorldChange(key=f"{hand}.seat", value=""), frame]


# --- bind ------------------------------------------------------------------------------------------------


def work(task: BindTask) -> BoundStep:
    """Lock the hand of the command, or let go of it."""
    ruled, hand = task.under(task.data.step.stop), task.data.context.object
    coupling(task.query, hand)
    evaluation = EvaluationContext(
        context=task.data.context, step=task.data.step, arm=task.arm, start_joints=task.query.joints(task.arm)
    )
    wanted = Coupling(hand="" if task.data.step.effect == LAID_DOWN else hand)
    return assemble.of_arm(ruled, wanted, evaluation, Expected(LOCKS_S, LOCKS_S))


# --- assess ----------------------------------------------------------------------------------------------


def gripped(task: AnalyzeTask, validity: Validity) -> Changes:
    """The jaws have a hand that is not locked yet: it stays in its rack."""
    return []


def taken(task: AnalyzeTask, validity: Validity) -> Changes:
    return _gone(task.context.object)


def laid_down(task: AnalyzeTask, validity: Validity) -> Changes:
    hand, frame = task.context.object, _lies_at(task)
    return [
        WorldChange(key=f"{hand}.frame", value=geometry.normalise(frame).tolist(), validity=validity),
        WorldChange(key=f"{hand}.seat", value=task.context.target, validity=validity),
    ]


def _lies_at(task: AnalyzeTask) -> Array:
    """The hand that was let go of: the jaws of the coupler are still closed on it."""
    return geometry.compose(task.report.tcp_pose, geometry.inverse(coupling(task.query, task.context.object)))


def not_taken(task: AnalyzeTask) -> str:
    """The coupler reads another hand than the one of the step; empty: it is that."""
    return "" if task.report.hand == task.context.object else "not_locked"


def adrift(task: AnalyzeTask) -> str:
    """The hand still is in the coupler, or no catch holds it; empty: it is in its rack."""
    if task.report.hand:
        return "not_let_go"
    return "" if seat_at(_lies_at(task), task.query, CAUGHT_M, CAUGHT_RAD) == task.context.target else "adrift"


def in_doubt(task: AnalyzeTask, retried: bool) -> Changes:
    """After a failure: unless the coupler reads the hand, it is in doubt where that is."""
    hand = task.context.object
    if task.report.hand == hand:
        return _gone(hand)
    return [WorldChange(key=f"{hand}.{name}", keep_value=True, validity=Validity.SUSPECT) for name in ("frame", "seat")]


MECHANISM = Mechanism(
    name="tool_changer",
    arms=arms,
    needs={"tool_changer.empty": empty, "tool_changer.coupled": coupled},
    anchors={"tool_changer.rack": rack},
    foreseen={"tool_changer.taken": will_be_taken, LAID_DOWN: will_be_laid_down},
    actions={"tool_changer.work": work},
    effects={
        "tool_changer.gripped": gripped,
        "tool_changer.taken": taken,
        LAID_DOWN: laid_down,
    },
    violated={"tool_changer.taken": not_taken, LAID_DOWN: adrift},
    after_failure={"tool_changer.taken": in_doubt, LAID_DOWN: in_doubt},
)
