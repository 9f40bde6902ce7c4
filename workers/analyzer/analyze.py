"""Analyzer worker function: (program, expected result, end report) -> continue, trim or abort, with world changes.

Evaluate, then trim (paper, Figure 3). A step succeeds if it expects the stop reason and its post-conditions hold. Any
other end is a failure of the class that the program's table names. The first applicable trim that this step has not
used may correct it. Memoryless: it uses only this report and its context, no other command (R139).
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from rtc.language.hands import hand_in_words
from rtc.programs.compatibility import row_of
from rtc.programs.loader import decode
from rtc.programs.schema import AnalyzerProgram, OutcomeClass
from rtc.protocol.messages import AnalyzerInput, Assessment, Binding, EndReport, Validity, WorldChange
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason, Refused, StopReason
from rtc.protocol.sentence import ReflexItem
from rtc.spatial import geometry
from rtc.world.model import World
from rtc.world.spread import even, widened
from workers.analyzer import nearby, reported_facts, sighting
from workers.analyzer.world_changes import EFFECTS, Changes, angles, perhaps_taken
from workers.conditions import reflexes
from workers.planning import in_seat, pose_spread, shared_hold
from workers.planning.robot_models import CellModel
from workers.planning.world_query import TRUSTED, WorldQuery

INPUT = AnalyzerInput
NEEDS_WORLD = True
NEEDS_CELL = True

#: measured values that `keep` of a step may name
SOURCES = {"report.trip_pose", "report.pose", "report.hand_width"}
UNITS = {StopReason.FORCE_LIMIT: "N", StopReason.CONTACT: "N", StopReason.TORQUE_LIMIT: "N.m", StopReason.TIMEOUT: "s"}


CLOSING = ("taken", "pinched")  # effects of steps that close the hand on the object
SEEN = "sighted"  # effect of steps that look
MOVES = "moves"  # finding of a look that needs the body at rest
BOTH = "move_both"  # space of the steps that move both arms
#: stop reasons of a hand that pressed on something: this may turn a held object between the fingers
PRESSED = frozenset(
    {
        *(StopReason.CONTACT, StopReason.COLLISION, StopReason.ARM_CONTACT, StopReason.FORCE_LIMIT),
        *(StopReason.TORQUE_LIMIT, StopReason.FOLLOWING_ERROR, StopReason.SLIP),
    }
)
SHORT_M = 0.003  # the direction of a shorter way means nothing
AWAY_CM = 5.0  # by how much an arm is to move away from what it has pressed on
BACK = "leave_back"  # row of `clears`
IN_SLOT_M = 0.010  # a shorter way back into a slot frees nothing
BACKWARDS = 0.7  # cosine of the angle between the way of a hand and its tool axis from which on it went back
STILL_RAD, TRAVEL_RAD = 0.001, 0.02  # turn of a joint that is stuck, and of one that has moved
THIN_M = 0.002  # fingers closer together than this hold nothing

#: figures that the program must define
VALUES = (
    *(
        "position_m",
        "angle_rad",
        "opened_m",
        "touched_n",
        "pressing_n",
        "reach_m",
        "seated_m",
        "stated_m",
        "stated_rad",
    ),
    *("seated_rad", "in_hand_m", "misplaced_m", "misplaced_rad"),
    *("struck_n", "struck_m", "struck_rad", "twisted_n", "twisted_rad", "pressed_m", "pressed_rad"),
    *("tilted_m", "unforeseen_m", "rolled_m", "pad_m"),
)
#: figures of the cell, which the elaborator and the binder use too; in this program they would have no effect there
OF_CELL = {"creep_m_s", "creep_rad_s"}


def compile(program: bytes) -> AnalyzerProgram:
    """Check the program. Raises ProgramError."""
    document = decode(program, AnalyzerProgram)
    for name in VALUES:
        if name not in document.values:
            raise ProgramError(f"$.values: no {name}")
    for name in OF_CELL & document.values.keys():
        raise ProgramError(f"$.values.{name}: it is one of the cell's `numbers`; state it there")
    return document


def run(
    compiled: AnalyzerProgram, cell: CellModel | None, world: World | None, data: AnalyzerInput
) -> Assessment | Refusal:
    """Evaluate an end report."""
    assert cell is not None
    assert world is not None
    try:
        return _assessed(compiled, WorldQuery(cell, world), data)
    except Refused as refused:
        return refused.refusal


def _assessed(compiled: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput) -> Assessment:
    evaluation = data.evaluation
    row = row_of(evaluation.step)
    if row not in compiled.outcomes:
        known = ", ".join(compiled.outcomes)
        message = f"the analyzer has no row {row}; there are {known}"
        raise Refused.because(RefusalReason.PROGRAM, message, where=row, clears="LOAD a program that has it")
    wrong = _wrong(compiled, data) or ("dropped" if _dropped(query, data) else "")
    reason = compiled.derived.get(row, {}).get(wrong, data.report.reason)
    if not wrong and data.report.reason in evaluation.step.expect:
        return _success(compiled, query, data)
    if still := _unmoved_joint(query, data):
        reason = StopReason.FOLLOWING_ERROR
        words = f"{still} of {evaluation.arm} has not moved while others have; {data.report.message}".rstrip("; ")
        data = msgspec.structs.replace(data, report=msgspec.structs.replace(data.report, message=words))
    return _failure(compiled, query, data, reason, compiled.classes[compiled.outcomes[row][reason]])


# --- evaluate --------------------------------------------------------------------------------------------


def _wrong(program: AnalyzerProgram, data: AnalyzerInput) -> str:
    """The violated post-condition of an end with an expected stop reason; empty if there is none."""
    evaluation, report = data.evaluation, data.report
    if report.reason is StopReason.GOAL and evaluation.no_contact_is_failure:
        return "nothing_felt"
    if report.reason not in evaluation.step.expect:
        return ""
    if evaluation.width_m is not None:
        least, most = evaluation.width_m
        return "narrow" if report.hand_width_m < least else "wide" if report.hand_width_m > most else ""
    if evaluation.body_pose is not None:
        return "displaced" if _is_displaced(data) else ""
    if evaluation.step.args.get("effect") == SEEN and report.reason is StopReason.GOAL and report.sighting is None:
        return "unseen"
    if evaluation.step.args.get("at_rest") and report.sighting is not None and sighting.moves(report.sighting):
        return MOVES
    within_m = evaluation.step.args.get("within_m")
    if isinstance(within_m, float):  # instead of the tolerance of the program
        return "elsewhere" if _off_m(data) > within_m else ""
    pressed = "press_n" in evaluation.step.args  # it ends where the obstacle is
    if report.reason is StopReason.GOAL and evaluation.goal_pose is not None and not pressed:
        turned = geometry.angle(report.tcp_pose, evaluation.goal_pose)
        if _off_m(data) > program.values["position_m"] or turned > program.values["angle_rad"]:
            return "off_goal"
    return ""


def _unmoved_joint(query: WorldQuery, data: AnalyzerInput) -> str:
    """The joint that a jammed motion into a seat has not moved although its path needs it; empty if there is none.

    A compliant arm whose joint is stuck does not follow its path, as if the seat were blocked.
    """
    evaluation, report = data.evaluation, data.report
    start, goal = evaluation.start_joints, evaluation.goal_pose
    jammed = report.reason in (StopReason.FORCE_LIMIT, StopReason.TIMEOUT) and evaluation.context.target
    if not jammed or goal is None or not start or len(report.joints) != len(start):
        return ""
    ends = query.model.arms[evaluation.arm].nearest_ik(goal, start)
    if ends is None:
        return ""
    moved = [abs(a - b) for a, b in zip(report.joints, start, strict=True)]
    if max(moved) < TRAVEL_RAD:
        return ""  # the arm is back where it began
    needed = [abs(a - b) for a, b in zip(ends, start, strict=True)]
    still = [n for n, rad in enumerate(moved) if rad < STILL_RAD and needed[n] > TRAVEL_RAD]
    names = query.cell.arm(evaluation.arm).joints
    return names[max(still, key=needed.__getitem__)] if still else ""


def _dropped(query: WorldQuery, data: AnalyzerInput) -> bool:
    """Whether a camera has found the object that the arm of this command should hold elsewhere."""
    evaluation, holder = data.evaluation, data.evaluation.context.arm
    if evaluation.step.args.get("effect") != SEEN or data.report.sighting is None or not holder:
        return False
    return query.held_by(evaluation.body) == holder and not sighting.is_in_hand(query, holder, data)


def _is_displaced(data: AnalyzerInput) -> bool:
    """Whether a sensed body is not where it should be."""
    args = data.evaluation.step.args
    most_m, most_rad = (float(args.get(name, 0.0)) for name in ("within_m", "within_rad"))
    return _off_m(data) > most_m or _turned_rad(data) > most_rad


def _turned_rad(data: AnalyzerInput) -> float:
    place, sighting = data.evaluation.body_pose, data.report.sighting
    return geometry.angle(sighting.pose, place) if place is not None and sighting is not None else 0.0


def _off_m(data: AnalyzerInput) -> float:
    place, sighting = data.evaluation.body_pose, data.report.sighting
    if place is not None:
        return geometry.distance(sighting.pose, place) if sighting is not None else 0.0
    goal = data.evaluation.goal_pose
    return geometry.distance(data.report.tcp_pose, goal) if goal is not None and data.report.tcp_pose else 0.0


def _success(program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput) -> Assessment:
    step = data.evaluation.step
    changes = _arm_changes(program, query, data) + _partner_changes(program, query, data)
    changes += reported_facts.changes_from(data.report.facts, query, program.values)
    effect = step.args.get("effect")
    if isinstance(effect, str) and effect:
        if effect not in EFFECTS:
            message = f"unknown effect {effect}; there are {', '.join(EFFECTS)}"
            raise Refused.because(RefusalReason.PROGRAM, message, where=step.label)
        changes += EFFECTS[effect](query, data, Validity.VALID)
    changes += _held_object_changes(program, query, data, changes, suspect=False)
    changes += _pressed_on(program, query, data)
    return Assessment(
        verdict="abort" if data.closing else "continue",
        reason=data.report.reason,
        message="; ".join(
            filter(
                None,
                (step.label, data.evaluation.remark, sighting.in_words(query, data) if data.evaluation.body else ""),
            )
        ),
        keep={name: _kept(source, data.report) for name, source in step.keep.items()},
        remark=_remark(query, data),
        changes=angles(query, _with_spread(program, query, data, _merged(changes))),
    )


def _remark(query: WorldQuery, data: AnalyzerInput) -> str:
    """What the outcome of a command states after this step: how far the object is from free of the seat it leaves."""
    leaves = data.evaluation.step.args.get("leaves") == "seat"
    return in_seat.remark_on_slot(query, data.evaluation.arm, data.report.tcp_pose) if leaves else ""


def _is_held_askew(data: AnalyzerInput) -> bool:
    """Whether the fingers have closed on the held object, but not to its width: to close them again does not help."""
    evaluation, report = data.evaluation, data.report
    if not evaluation.held or evaluation.width_m is None or report.reason is not StopReason.GOAL:
        return False
    return report.hand_width_m > evaluation.width_m[1]


def _kept(source: str, report: EndReport) -> Binding:
    """A measured value as a binding. Poses are in the world frame: a contact position does not depend on facts."""
    if source == "report.hand_width":
        return Binding(number=report.hand_width_m)
    assert source in SOURCES, source
    tripped = report.trip_pose if source == "report.trip_pose" else None
    return Binding(pose=tripped or report.tcp_pose)


def _failure(
    program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput, reason: StopReason, failure: OutcomeClass
) -> Assessment:
    evaluation = data.evaluation
    changes = _arm_changes(program, query, data) + _partner_changes(program, query, data)
    changes += _interrupted_grasp(program, query, data)
    changes += _held_object_changes(
        program, query, data, changes, suspect="held" in failure.suspect, drops=failure.drops
    )
    changes += _touched_object_changes(program, query, data, failure)
    changes += nearby.doubtful(query, data) if "near" in failure.suspect else []
    changes += _target_changes(query, data) if "target" in failure.suspect else []
    if evaluation.step.args.get("effect") == SEEN and _wrong(program, data) in ("", MOVES):
        changes += EFFECTS[SEEN](query, data, Validity.VALID)  # it was stopped, or the body moves, but it was seen
    missed = evaluation.step.args.get("missed")
    if isinstance(missed, str) and missed in EFFECTS and failure.retriable and not data.closing and not data.trims_used:
        changes += EFFECTS[missed](query, data, Validity.SUSPECT)
    changes = angles(query, _with_spread(program, query, data, _merged(changes)))
    trim = 0 if data.closing or not failure.retriable else _trim(data, reason)
    pressed = not trim and reason in PRESSED
    changes = _moved_in_hand(program, query, data, changes, failure, pressed=pressed)
    asked = reflexes.find_requested(evaluation.context.reflexes, data.report)
    short = _short(program, data)
    words = _words(failure.message, data, reason, short) if asked is None else _stopped_as_requested(asked, data)
    if done := reflexes.describe_action(data.report):
        words = f"{words}; {done}"
    if reason is StopReason.OUT_OF_RANGE and _seen_as_believed(query, data):
        words = f"{words}; it is where it is believed to be"
    if evaluation.remark and reason in (StopReason.FORCE_LIMIT, StopReason.CONTACT):
        words = f"{words}; {evaluation.remark}"
    # A seat needs a better known pose in the hand than VERIFY leaves after that, and a free motion more room.
    misplaced = failure.misplaced or _is_held_askew(data) or (pressed and bool(evaluation.context.target))
    cures = _ways_to_clear(program, query, changes, moved=pressed or misplaced, misplaced=misplaced)
    template = failure.pressing if asked is None else program.clears.get("asked", "")
    pressing, doubtful = _leaving(program, query, data, template)
    held = [cure for key, cure in cures.items() if doubtful and key.rpartition(".")[0] == evaluation.held]
    own: tuple[str, ...] = (*held, pressing)
    again = ""
    if asked is None:
        own += (_felt(program, query, data, reason) or failure.clears, *_higher_limit(data))
        again = "" if _is_held_askew(data) else failure.again  # the fingers close no further
    if "{target_cure}" in again:
        cure = cures.pop(f"{evaluation.context.target}.frame", "")
        again = again.replace("{target_cure}; ", f"{cure}; " if cure else "")
    todo = dict.fromkeys(word for word in (*own, *cures.values(), again) if word)
    return Assessment(
        verdict="trim" if trim else "abort",
        reason=reason,
        message=f"{evaluation.step.label}: {words}",
        trim=trim,
        changes=changes,
        clears=_words("; ".join(todo), data, reason, short),
    )


def _felt(program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput, reason: StopReason) -> str:
    """The advice if cameras do not see a body that is believed in a hand: to look again would not help, its fingers
    tell whether it is there."""
    body = data.evaluation.body
    if reason is not StopReason.NOT_SEEN or not body or not query.held_by(body):
        return ""
    return query.clears(f"{body}.grasp", {"grasp": program.clears.get("unseen_in_hand", "")})


def _pressing_n(program: AnalyzerProgram, data: AnalyzerInput) -> float:
    """The force (N) of an arm that pressed on something when it was stopped; 0 if it did not press."""
    report = data.report
    if report.partner is not None or not report.trip_wrench or data.evaluation.goal_pose is None:
        return 0.0
    force_n = math.hypot(*report.trip_wrench[:3])
    return force_n if force_n >= program.values["touched_n"] else 0.0


def _short(program: AnalyzerProgram, data: AnalyzerInput) -> str:
    """How far from its goal a motion has ended, and with what force; empty without a goal or near it."""
    off_m, force_n = _off_m(data), _pressing_n(program, data)
    if off_m <= program.values["position_m"]:
        return ""
    pressing = f", and pressed with {force_n:.3g} N" if force_n and data.report.reason is StopReason.TIMEOUT else ""
    return f": the hand was {off_m * 1000:.0f} mm from the end of its path{pressing}"


def _higher_limit(data: AnalyzerInput) -> list[str]:
    """The advice if the force or the time that ended the step is the limit of the sentence."""
    limits, report = data.evaluation.context.limits, data.report
    if limits.time_s is not None and report.reason is StopReason.TIMEOUT:
        return [f"a TIME-LIMIT above {limits.time_s:g} S, if it needs more time"]
    limit_n = limits.force_n
    if limit_n is None or report.limit is None or report.reason is not StopReason.FORCE_LIMIT:
        return []
    own = math.isclose(report.limit, limit_n)
    return [f"a FORCE-LIMIT above {limit_n:g} N, if nothing is in the way"] if own else []


def _ways_to_clear(
    program: AnalyzerProgram, query: WorldQuery, changes: Changes, *, moved: bool, misplaced: bool
) -> dict[str, str]:
    """The advice that clears the facts made suspect by these changes, by the first fact that it clears.

    `moved`: what is held may have moved in the hand. `misplaced`: its fingers do not help."""
    after = WorldQuery(query.model, query.world.overlay(changes))
    suspect = [change.key for change in changes if change.validity is Validity.SUSPECT]
    if any(key.endswith(".holding") for key in suspect):  # what it may hold is neither looked for nor taken before that
        suspect = [key for key in suspect if not key.endswith(".frame") or after.held_by(key.rpartition(".")[0])]
    clears = program.clears
    if moved:
        held = next((change.key for change in changes if change.key.endswith(".grasp")), "").rpartition(".")[0]
        seen = "seen" in clears and held and after.cameras(held)
        row = "seen" if seen else "misplaced" if misplaced else "grasp"
        clears = {**clears, "grasp": clears[row]}
    first: dict[str, str] = {}
    for key in suspect:
        if key.rpartition(".")[2] in clears:
            first.setdefault(after.clears(key, clears), key)
    return {key: advice for advice, key in first.items()}


# --- trim ------------------------------------------------------------------------------------------------


def _trim(data: AnalyzerInput, reason: StopReason) -> int:
    """The first of the step's trims that fits the stop reason and is not yet used; 0 = none."""
    fits = data.evaluation.context.fits
    for entry in data.evaluation.step.trims:
        if entry not in data.trims_used and reason in fits.get(entry, [reason]):
            return entry
    return 0


# --- world changes ---------------------------------------------------------------------------------------


def _arm_changes(program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput) -> Changes:
    """The facts of the arm of the step."""
    commanded = bool(data.evaluation.step.op) or data.evaluation.step.do == "proc"
    return _reported(program, query, data.report, data.evaluation.arm, hand_commanded=commanded)


def _reported(
    program: AnalyzerProgram, query: WorldQuery, report: EndReport, arm: str, *, hand_commanded: bool
) -> Changes:
    """Joints and hand width as reported; suspect and unchanged, like what it holds, if the report has no joints.

    The width of a hand that has opened or closed without a command is suspect: the fingers may still move.
    """
    if not arm:
        return []  # a stated or observed fact moves no arm
    if len(report.joints) != len(query.cell.arm(arm).joints):
        return [
            WorldChange(key=f"{arm}.{attribute}", keep_value=True, validity=Validity.SUSPECT)
            for attribute in ("joints", "hand_width", "holding")
        ]
    width_m = max(0.0, report.hand_width_m)
    moves = not hand_commanded and abs(width_m - query.hand_width(arm)) > program.values["unforeseen_m"]
    return [
        WorldChange(key=f"{arm}.joints", value=list(report.joints)),
        WorldChange(key=f"{arm}.hand_width", value=width_m, validity=Validity.SUSPECT if moves else Validity.VALID),
    ]


def _partner_changes(program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput) -> Changes:
    """The same for the second arm of a primitive; unchanged if nothing was started."""
    partner, report = data.evaluation.context.partner, data.report
    if not partner or data.evaluation.step.space != BOTH:
        return []  # only one arm moves in this step, or a camera looks
    if report.partner is None and report.reason in (StopReason.REFUSED, StopReason.BLOCKED):
        return []
    second = report.partner or msgspec.structs.replace(report, joints=[])
    return _reported(program, query, second, partner, hand_commanded=False)


def _held_object_changes(
    program: AnalyzerProgram,
    query: WorldQuery,
    data: AnalyzerInput,
    changes: Changes,
    *,
    suspect: bool,
    drops: bool = False,
) -> Changes:
    """Frame and grasp of the held object after the motion; an opened hand no longer holds it."""
    arm, thing = data.evaluation.arm, data.evaluation.held
    grasp = query.grasp(thing) if thing else None
    let_go = any(change.key == f"{arm}.holding" and not change.keep_value for change in changes)
    if grasp is None or let_go or any(change.key == f"{thing}.grasp" for change in changes):
        return []
    if not data.report.tcp_pose:  # hand position unknown, so the held object's too
        doubtful = ("frame", "grasp", "held_by", "seat") if suspect else ()  # the hand may have opened, in a seat
        return [WorldChange(key=f"{thing}.{name}", keep_value=True, validity=Validity.SUSPECT) for name in doubtful]
    widened_m = _widened_m(query, data)
    opened = max(widened_m.values()) > program.values["opened_m"]
    tilted = max(widened_m.values()) > program.values["tilted_m"]
    fact = query.world.get(f"{thing}.grasp")
    trusted = fact is None or fact.validity in TRUSTED
    first = query.held_by(thing) in ("", arm)  # else another hand leads, and this arm was at rest
    tcp = data.report.tcp_pose if first else query.tcp(query.held_by(thing))
    held = query.in_hand(thing, tcp)
    assert held is not None
    frame = geometry.normalise(held)
    validity = Validity.SUSPECT if suspect or drops or tilted or not trusted else Validity.VALID
    moved = [WorldChange(key=f"{thing}.frame", value=frame.tolist(), validity=validity)]
    if drops or opened:
        if query.seat(thing):
            moved.append(WorldChange(key=f"{thing}.seat", keep_value=True, validity=Validity.SUSPECT))
        return [*moved, *shared_hold.let_go(query, _loser(widened_m, opened), thing, Validity.SUSPECT)]
    turned = query.grasp_after(thing, frame, tcp)
    moved.append(WorldChange(key=f"{thing}.grasp", value=turned, keep_value=turned is None, validity=validity))
    seat = query.seat(thing)
    if seat and geometry.distance(frame, query.seated_pose(seat)) >= query.cell.seat(seat).depth_m:
        moved.append(WorldChange(key=f"{thing}.seat", value=""))
    return moved


def _widened_m(query: WorldQuery, data: AnalyzerInput) -> dict[str, float]:
    """By how much each hand of the primitive is wider open than believed (m)."""
    arm, partner, second = data.evaluation.arm, data.evaluation.context.partner, data.report.partner
    found = {arm: data.report.hand_width_m - query.hand_width(arm)}
    if second is not None and second.joints:
        found[partner] = second.hand_width_m - query.hand_width(partner)
    return found


def _loser(widened_m: dict[str, float], opened: bool) -> str:
    """The arm whose hand has lost the object: the one that is open, or else the one whose fingers have come closer."""
    return max(widened_m, key=widened_m.__getitem__) if opened else min(widened_m, key=widened_m.__getitem__)


def _with_spread(program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput, changes: Changes) -> Changes:
    """The changes, with the current uncertainty of an object held during the whole step."""
    thing, report = data.evaluation.held, data.report
    fact = query.world.get(f"{thing}.grasp")
    if fact is None or fact.value is None:
        return changes
    if query.hinge(thing) is not None:
        spread = _rolled(program, query, thing, changes)
    else:
        held_s = max(report.at_s - fact.at_s, report.duration_s)
        spread = pose_spread.crept_spread(query.spread(fact.key), held_s, query.cell.numbers)
        spread = pose_spread.struck_spread(spread, report.peak_force_n, program.values)
        if report.peak_force_n > program.values["twisted_n"]:
            spread = pose_spread.twisted_spread(spread, fact.value, program.values["twisted_rad"])
        wider_m = max(map(abs, _widened_m(query, data).values()))
        if wider_m <= program.values["opened_m"]:  # else they have let go of it
            spread = pose_spread.askew_spread(spread, fact.value, wider_m, program.values["pad_m"])
    keys = {f"{thing}.frame", f"{thing}.grasp"}
    return [
        msgspec.structs.replace(change, spread=spread)
        if change.key in keys and change.spread is None and (change.keep_value or change.value is not None)
        else change
        for change in changes
    ]


def _rolled(program: AnalyzerProgram, query: WorldQuery, thing: str, changes: Changes) -> list[float]:
    """The spread of a held object with a hinge: it keeps its place, and a round bar rolls when its hand turns it."""
    hinge, fact = query.hinge(thing), query.world.get(f"{thing}.grasp")
    turned = next((change.value for change in changes if change.key == f"{thing}.frame"), None)
    assert hinge is not None
    assert fact is not None
    spread = query.spread(fact.key)
    points = query.cell.object(thing).grasp_points
    point = min(points, key=lambda one: geometry.distance(one.frame.pose, geometry.inverse(fact.value)), default=None)
    if turned is None or point is None or not point.round:
        return list(spread)
    lever_m = float(np.linalg.norm(np.cross(point.frame.xyz, hinge.axis)))
    rolled_m = 0.5 * point.width_m * geometry.angle(query.frame(thing), turned)
    return pose_spread.rolled_spread(spread, hinge.axis, rolled_m, program.values["rolled_m"], lever_m)


def _moved_in_hand(
    program: AnalyzerProgram,
    query: WorldQuery,
    data: AnalyzerInput,
    changes: Changes,
    failure: OutcomeClass,
    *,
    pressed: bool,
) -> Changes:
    """The changes, with increased uncertainty of a held object that the failure may have moved in the hand.

    `pressed`: the hand or the object pressed on something. A hinge keeps its object in place.
    """
    values, held = program.values, data.evaluation.held
    if query.hinge(held) is not None:
        return changes
    if failure.misplaced:
        more = even(values["misplaced_m"], values["misplaced_rad"])
    elif pressed:
        more = even(values["pressed_m"], values["pressed_rad"])
    else:
        return changes
    keys = {f"{held}.{attribute}" for attribute in ("frame", "grasp")}
    return [
        msgspec.structs.replace(change, spread=widened(change.spread or query.spread(change.key), more))
        if change.key in keys and change.validity is Validity.SUSPECT
        else change
        for change in changes
    ]


def _pressed_on(program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput) -> Changes:
    """A close step without an object that presses on something: objects near the hand become suspect.

    They may move with the hand, so their frames are not trusted.
    """
    evaluation, report = data.evaluation, data.report
    if evaluation.step.op != "close" or evaluation.context.object or evaluation.held:
        return []
    if report.hand_force_n < program.values["pressing_n"] or report.hand_width_m < THIN_M:
        return []
    near = []
    for thing in query.cell.objects:
        points = [geometry.compose(query.frame(thing.name), point.frame.pose) for point in thing.grasp_points]
        if any(geometry.distance(report.tcp_pose, point) < program.values["in_hand_m"] for point in points):
            near.append(thing.name)
    return [WorldChange(key=f"{name}.frame", keep_value=True, validity=Validity.SUSPECT) for name in near]


def _interrupted_grasp(program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput) -> Changes:
    """Fingers that were stopped while they closed, and press at the expected width, hold the object (suspect).

    Without a report of the hand the fingers may press too.
    """
    evaluation, report = data.evaluation, data.report
    if evaluation.step.args.get("effect") not in CLOSING or evaluation.width_m is None:
        return []
    if not report.tcp_pose:
        begun = report.reason not in (StopReason.REFUSED, StopReason.BLOCKED)
        return perhaps_taken(query, data) if begun else []
    least, most = evaluation.width_m
    pressing = report.hand_force_n >= program.values["pressing_n"]
    return EFFECTS["taken"](query, data, Validity.SUSPECT) if pressing and least <= report.hand_width_m <= most else []


def _touched_object_changes(
    program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput, failure: OutcomeClass
) -> Changes:
    """After a failure the touched object is suspect until it is sensed again (R151)."""
    thing = data.evaluation.context.object
    if not thing or thing == data.evaluation.held or _seen_as_believed(query, data):
        return []
    pressed = data.report.peak_force_n > program.values["touched_n"] or not query.seat(thing)
    if "object" in failure.suspect or ("if_touched" in failure.suspect and pressed):
        doubtful = ("frame", "grasp") if query.held_by(thing) else ("frame",)
        return [WorldChange(key=f"{thing}.{name}", keep_value=True, validity=Validity.SUSPECT) for name in doubtful]
    return []


def _target_changes(query: WorldQuery, data: AnalyzerInput) -> Changes:
    """The seat may not be where it is believed to be: an object did not meet it as expected."""
    seat = data.evaluation.context.target
    if not seat:
        return []
    return [WorldChange(key=f"{seat}.frame", value=query.seat_frame(seat).tolist(), validity=Validity.SUSPECT)]


def _seen_as_believed(query: WorldQuery, data: AnalyzerInput) -> bool:
    """Whether a camera that looked for a body in another place has seen it where it is believed to be."""
    sighting, args = data.report.sighting, data.evaluation.step.args
    if sighting is None or data.evaluation.body_pose is None:
        return False
    believed = query.pose(data.evaluation.body)
    near = geometry.distance(sighting.pose, believed) <= float(args.get("within_m", 0.0))
    return near and geometry.angle(sighting.pose, believed) <= float(args.get("within_rad", 0.0))


def _merged(changes: Changes) -> Changes:
    """One change per fact. A later change that only sets the validity keeps the value of an earlier one."""
    merged: dict[str, WorldChange] = {}
    for change in changes:
        earlier = merged.get(change.key)
        if change.keep_value and earlier is not None and not earlier.keep_value:
            change = msgspec.structs.replace(earlier, validity=change.validity)
        merged[change.key] = change
    return list(merged.values())


# --- words -----------------------------------------------------------------------------------------------


def _stopped_as_requested(reflex: ReflexItem, data: AnalyzerInput) -> str:
    """Message for a stop by a reflex of the command: the goal is not reached, but there is no fault."""
    value, measured = data.report.measured, ""
    if value is not None:
        by_reason = _words("{measured} {unit}", data, data.report.reason).rstrip()
        measured = f" at {reflex.condition.measured_in_words(value) or by_reason}"
    return f"stopped{measured} as asked: {reflexes.in_words(reflex)}"


def _stopped_by(data: AnalyzerInput) -> str:
    """The arm whose stop function has ended the primitive: of two arms the one with a measured value."""
    second = data.report.partner
    caused = second is not None and second.measured is not None and second.reason is data.report.reason
    return data.evaluation.context.partner if caused else data.evaluation.arm


def _jam(report: EndReport) -> str:
    """The figures of a jam: a force or torque above its limit, or the distance (m) of a hand behind its path."""
    value, limit, force_n = report.measured or 0.0, report.limit or 0.0, math.hypot(*(report.trip_wrench or [])[:3])
    if report.reason is StopReason.FORCE_LIMIT and not math.isclose(value, force_n, rel_tol=0.01):
        return f"the hand was {value * 1000:.0f} mm behind its path, and pressed with {force_n:.3g} N"
    return f"{value:.3g} {UNITS.get(report.reason, '')} where {limit:.3g} is the limit"


def _excess(data: AnalyzerInput) -> str:
    """What is beyond its limit: a force or torque, or the width of a hand that has reached its goal."""
    report = data.report
    if report.reason not in (StopReason.FORCE_LIMIT, StopReason.TORQUE_LIMIT):
        least, most = (1000 * width_m for width_m in data.evaluation.width_m or (0.0, 0.0))
        return f"the hand is at {1000 * report.hand_width_m:.1f} mm instead of {least:.0f} to {most:.0f} mm"
    unit = UNITS[report.reason]
    if report.measured is None or report.limit is None:
        return f"more {unit} than the limit"
    value = next((text for n in (3, 4, 5) if float(text := f"{report.measured:.{n}g}") > report.limit), "more")
    return f"{value} {unit} where {report.limit:.5g} {unit} is the limit"


def _leaving(program: AnalyzerProgram, query: WorldQuery, data: AnalyzerInput, template: str) -> tuple[str, bool]:
    """The advice for an arm that pressed on something, and whether it moves no object in the hand that is in doubt."""
    if not template or not _pressing_n(program, data):
        return "", False
    row, back = _way_to_leave(query, data)
    words = template.replace("{leave}", program.clears.get(row, "")).replace("{back}", back)
    return words.replace("{away}", _away(query, data)), row != BACK or "{leave}" not in template


def _way_to_leave(query: WorldQuery, data: AnalyzerInput) -> tuple[str, str]:
    """How an arm leaves what it presses on where it may touch something: the row of `clears`, and the way (cm).

    Back along its tool. Where it came to a stop on that way: back into the slot that an object was leaving, or along
    another line."""
    evaluation, report = data.evaluation, data.report
    if evaluation.start_joints is None:
        return BACK, ""
    came = query.model.arms[evaluation.arm].fk(evaluation.start_joints)[:3] - np.asarray(report.tcp_pose[:3])
    came_m, held = float(np.linalg.norm(came)), evaluation.held
    frame = query.in_hand(held, report.tcp_pose) if held and evaluation.step.args.get("leaves") == "seat" else None
    if frame is not None and query.slot_at(frame) and came_m >= IN_SLOT_M:
        return "leave_slot", f"{min(AWAY_CM, 100.0 * came_m):.2g}"
    backwards = float(came @ geometry.rotate(report.tcp_pose, [0.0, 0.0, 1.0])) > BACKWARDS * came_m
    return "leave_line" if came_m > SHORT_M and backwards else BACK, ""


def _away(query: WorldQuery, data: AnalyzerInput) -> str:
    """The line along an axis of the world that leads away from what the arm presses on, in words.

    It goes back the way that the hand came, and not beyond its start, rather than with the force: an object that turns
    in the hand may press aside."""
    evaluation, report = data.evaluation, data.report
    assert report.trip_wrench is not None
    pose = report.trip_pose or report.tcp_pose
    force = geometry.rotate(pose, report.trip_wrench[:3])
    away, most_m = force / np.linalg.norm(force), np.full(3, math.inf)
    if evaluation.start_joints is not None:
        came = query.model.arms[evaluation.arm].fk(evaluation.start_joints)[:3] - np.asarray(pose[:3])
        if (came_m := float(np.linalg.norm(came))) > SHORT_M:
            away = away + 2.0 * came / came_m
            most_m = np.where(came * away > SHORT_M * np.abs(away), np.abs(came), math.inf)
    axis = int(np.abs(away).argmax())
    way_cm = min(AWAY_CM, 100.0 * float(most_m[axis]))
    return f"{math.copysign(way_cm, away[axis]):.2g} CM ALONG {'XYZ'[axis]}"


def _words(message: str, data: AnalyzerInput, reason: StopReason, short: str = "") -> str:
    evaluation, report = data.evaluation, data.report
    least, most = evaluation.width_m or (0.0, 0.0)
    figures = {
        "reason": reason.value,
        "measured": "?" if report.measured is None else f"{report.measured:.3g}",
        "limit": "the" if report.limit is None else f"{report.limit:.3g}",
        "unit": UNITS.get(report.reason, ""),
        "message": report.message or evaluation.arm or report.performer,
        "arm": hand_in_words(_stopped_by(data)),
        "camera": report.performer,
        "object": evaluation.body or evaluation.context.object or evaluation.held or "the object",
        "target": evaluation.context.target or "the seat",
        "or_load": f", or {evaluation.held} is heavier than stated and slips" if evaluation.held else "",
        "point": evaluation.context.grasp_point,
        "width": f"{report.hand_width_m * 1000:.1f}",
        "wanted": f"{least * 1000:.0f} to {most * 1000:.0f}",
        "off": f"{_off_m(data) * 1000:.1f}",
        "turned": f"{math.degrees(_turned_rad(data)):.1f}",
        "speed": sighting.speed_in_words(report.sighting),
        "jam": _jam(report),
        "excess": _excess(data),
        "short": short,
    }
    for name, text in figures.items():
        message = message.replace("{" + name + "}", text)
    return message
