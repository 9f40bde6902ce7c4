"""BOTH-ARMS: one command moves two arms that hold one object, as a closed chain."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from rtc.model.cells import parts
from rtc.protocol.advice import sentences_of
from rtc.protocol.causes import NeedUnmet
from rtc.protocol.messages import EndReport, Script, Validity
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.protocol.primitive import ClearanceBelow, ForceAbove, TcpOutside, TcpSpeedAbove, TcpTurned
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from rtc.world.facts import TRUSTED
from tests.campaigns.carry import CARRIED, Carrier
from tests.refusals import stated
from tests.workers.conftest import CELL, MODEL, Bench
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

RIGHT, LEFT, MODULE = "RIGHT-ARM", "LEFT-ARM", "MACS-NEW"
RIGHT_HALF = CellModel(
    msgspec.structs.replace(
        CELL,
        regions=[parts.Region(name="RIGHT-HALF", frame=parts.Frame(xyz=(0.5, -0.6, 0.8)), size_m=(1.0, 1.2, 1.0))],
        maintain=parts.Maintained(),
    )
)
UP = "MOVE BOTH-ARMS BY 40 CM ALONG UP"
TAKE = f"GRASP {MODULE} HANDLE-B WITH LEFT-ARM"


@pytest.fixture
def holding(bench: Bench) -> Bench:
    """Both hands at the handles of a module before the bay."""
    points = {RIGHT: "HANDLE-A", LEFT: "HANDLE-B"}
    frames = {arm: CELL.object(MODULE).grasp_point(name).frame.pose for arm, name in points.items()}
    hand = geometry.make_pose((0.46, -0.085, 0.60), (0.0, 2**-0.5, 0.0, 2**-0.5))
    module = geometry.compose(hand, geometry.inverse(frames[RIGHT]))
    for arm, frame in frames.items():
        joints = MODEL.arms[arm].ik(geometry.compose(module, frame).tolist(), CELL.arm(arm).home_rad, 0.06)[0]
        bench.subsystem.joints[arm] = np.array(joints)
        bench.subsystem.widths[arm] = 0.02
        bench.set_fact(f"{arm}.joints", joints.tolist())
        bench.set_fact(f"{arm}.hand_width", 0.02)
        bench.set_fact(f"{arm}.holding", MODULE)
    bench.set_fact(f"{MODULE}.held_by", RIGHT)
    bench.set_fact(f"{MODULE}.grasp", geometry.normalise(geometry.relative(hand, module)).tolist())
    bench.set_fact(f"{MODULE}.frame", geometry.normalise(module).tolist())
    bench.set_fact(f"{MODULE}.seat", "")
    bench.subsystem.poses[MODULE] = module
    return bench


@pytest.fixture
def one_holds(holding: Bench) -> Bench:
    """The right hand holds the module, the left one is open before the other handle."""
    model, now = MODEL.arms[LEFT], holding.subsystem.joints[LEFT]
    before = geometry.compose(model.fk(now), (0.0, 0.0, -0.13, 0.0, 0.0, 0.0, 1.0))
    joints = model.ik(before.tolist(), now, 0.06)[0]
    holding.subsystem.joints[LEFT], holding.subsystem.widths[LEFT] = joints, 0.08
    for name, value in (("joints", joints.tolist()), ("hand_width", 0.08), ("holding", "")):
        holding.set_fact(f"{LEFT}.{name}", value)
    return holding


def hands(bench: Bench) -> tuple[str, str, str]:
    """What the right and the left hand hold, and the hand that the module's facts refer to."""
    keys = (f"{RIGHT}.holding", f"{LEFT}.holding", f"{MODULE}.held_by")
    return tuple(bench.world.value(key) for key in keys)  # type: ignore[return-value]


@pytest.mark.parametrize("sentence", [TAKE, f"GRASP LEFT-END-EFF {MODULE}"])
def test_a_second_hand_takes_a_held_object_at_its_free_handle(one_holds, sentence):
    run = one_holds.do(sentence)
    assert run.succeeded, run.refusal or run.failure
    assert run.script.context.grasp_point == "HANDLE-B"
    assert set(run.script.resources) == {LEFT, MODULE, RIGHT}  # the first hand must stay
    assert hands(one_holds) == (MODULE, MODULE, RIGHT)
    assert one_holds.do(UP).succeeded


def test_the_second_arm_complies_while_its_hand_closes(one_holds):
    laws = [made.control_law for made in one_holds.do(TAKE).primitives]
    assert [law.compliance is not None for law in laws] == [False] * (len(laws) - 1) + [True]
    assert laws[-1].compliance.stiffness[0] == 600.0


@pytest.mark.parametrize(
    ("sentence", "facts", "clears"),
    [
        (f"GRASP {MODULE} HANDLE-A WITH LEFT-ARM", {"need": "other_handle", "by": "HANDLE-B"}, TAKE),
        (f"GRASP {MODULE} HANDLE-B WITH RIGHT-ARM", {"need": "hand_empty", "by": MODULE}, "PLACE"),
        (UP, {"need": "both_hands", "by": MODULE}, TAKE),
    ],
)
def test_a_wrong_second_grasp_is_refused_with_the_sentence_that_clears_it(one_holds, sentence, facts, clears):
    run = one_holds.do(sentence)
    assert stated(run.refusal, facts) == facts
    assert clears in in_one_line(run.refusal.clears)
    assert run.primitives == []


def test_a_module_in_a_doubtful_grasp_is_not_taken_by_a_second_hand(one_holds):
    one_holds.set_fact(f"{MODULE}.frame", one_holds.world.value(f"{MODULE}.frame"), Validity.SUSPECT)
    assert sentences_of(one_holds.do(TAKE).refusal.clears) == ["VERIFY MACS-NEW AT RIGHT-ARM"]


def test_a_close_of_the_second_hand_on_nothing_makes_the_grasp_of_the_first_one_doubtful(one_holds):
    one_holds.subsystem.closes = [0.0]
    run = one_holds.do(TAKE)
    assert run.failure.reason is StopReason.NO_CONTACT
    assert hands(one_holds) == (MODULE, "", RIGHT)
    assert one_holds.world.get(f"{MODULE}.grasp").validity not in TRUSTED
    assert "VERIFY MACS-NEW AT RIGHT-ARM" in in_one_line(run.failure.clears)


@pytest.mark.parametrize(("arm", "other"), [(RIGHT, LEFT), (LEFT, RIGHT)])
def test_one_of_two_hands_lets_go_and_the_other_carries_on(holding, arm, other):
    frame = holding.world.value(f"{MODULE}.frame")
    run = holding.do(f"RELEASE {MODULE} WITH {arm}")
    assert run.succeeded, run.refusal or run.failure
    assert hands(holding) == (*(MODULE if name == other else "" for name in (RIGHT, LEFT)), other)
    query = WorldQuery(MODEL, holding.world)
    assert geometry.distance(query.in_hand(MODULE, query.tcp(other)), frame) < 1e-6
    assert holding.do(f"MOVE {other} BY 5 CM ALONG UP").succeeded


@pytest.mark.parametrize(("arm", "other"), [(RIGHT, LEFT), (LEFT, RIGHT)])
def test_stow_lets_go_of_what_the_other_hand_goes_on_holding(holding, arm, other):
    run = holding.do(f"STOW {arm}")
    assert run.succeeded, run.refusal or run.failure
    assert hands(holding) == (*(MODULE if name == other else "" for name in (RIGHT, LEFT)), other)
    assert np.allclose(holding.subsystem.joints[arm], CELL.arm(arm).stow_rad)


@pytest.mark.parametrize("arm", [RIGHT, LEFT])
def test_each_of_two_hands_can_be_verified(holding, arm):
    before = holding.world.value(f"{MODULE}.frame")
    assert holding.do(f"VERIFY {MODULE} AT {arm}").succeeded
    assert hands(holding) == (MODULE, MODULE, RIGHT)
    assert geometry.distance(holding.world.value(f"{MODULE}.frame"), before) < 1e-9


@pytest.mark.parametrize("loser", [RIGHT, LEFT])
@pytest.mark.parametrize(
    ("reason", "lost_m"),
    [
        (StopReason.OBJECT_LOST, 0.0),
        (StopReason.SLIP, 0.08),  # the hand opens
    ],
)
def test_a_hand_that_loses_the_object_leaves_it_to_the_other(holding, loser, reason, lost_m):
    script = holding.elaborate(UP)
    made = holding.bind(script, script.steps[0])
    at = {arm: holding.subsystem.joints[arm].tolist() for arm in (RIGHT, LEFT)}
    widths = {arm: lost_m if arm == loser else 0.02 for arm in at}
    reports = {
        arm: EndReport(
            primitive=made.primitive.id,
            performer=arm,
            reason=reason,
            measured=2.9 if arm == loser else None,
            at_s=1.0,
            duration_s=1.0,
            joints=at[arm],
            tcp_pose=MODEL.arms[arm].fk(at[arm]).tolist(),
            wrench=[0.0] * 6,
            hand_width_m=widths[arm],
            hand_force_n=0.0,
        )
        for arm in at
    }
    report = msgspec.structs.replace(reports[RIGHT], partner=reports[LEFT])
    assessment = holding.analyze(made, report)
    assert reason is assessment.reason
    holding.world = holding.world.overlay(assessment.changes)
    keeps = LEFT if loser == RIGHT else RIGHT
    assert hands(holding) == (*(MODULE if name == keeps else "" for name in (RIGHT, LEFT)), keeps)
    assert holding.world.get(f"{MODULE}.grasp").validity not in TRUSTED


def bound(bench: Bench, sentence: str) -> Any:
    script = bench.elaborate(sentence)
    assert isinstance(script, Script), script
    return bench.bind(script, script.steps[0])


def test_both_hands_keep_their_places_at_the_object(holding):
    made = bound(holding, UP).primitive
    assert made.performers == [RIGHT, LEFT]
    paths = [np.asarray(made.paths[arm].positions) for arm in (RIGHT, LEFT)]
    hands = [geometry.relative(MODEL.arms[RIGHT].fk(q), MODEL.arms[LEFT].fk(p)) for q, p in zip(*paths, strict=True)]
    assert max(geometry.distance(hands[0], hand) for hand in hands) < 1e-6
    rise = MODEL.arms[LEFT].fk(paths[1][-1])[2] - MODEL.arms[LEFT].fk(paths[1][0])[2]
    assert rise == pytest.approx(0.40, abs=1e-6)
    assert made.paths[RIGHT].time_s == made.paths[LEFT].time_s


@pytest.mark.parametrize("place", ["CLEAR-POINT-1", "POSITION 48 -8.5 95 CM STRAIGHT-LINE"])
def test_both_arms_carry_the_object_to_where_the_leading_hand_is_at_the_place(holding, place):
    run = holding.do(f"MOVE BOTH-ARMS TO {place}")
    assert run.succeeded, run.refusal or run.failure
    query = WorldQuery(MODEL, holding.world)
    assert query.tcp(RIGHT)[:3].tolist() == pytest.approx([0.48, -0.085, 0.95], abs=1e-6)
    assert run.primitives[0].performers == [RIGHT, LEFT]
    across = geometry.relative(query.tcp(RIGHT), MODEL.arms[LEFT].fk(run.primitives[0].paths[LEFT].positions[-1]))
    assert across[:3].tolist() == pytest.approx([0.0, 0.17, 0.0], abs=1e-4)


@pytest.fixture
def crowded(holding: Bench) -> Bench:
    """A body beside the line upwards: the module passes it at 3.6 mm, where 5 mm are needed."""
    place = geometry.translate(holding.world.value(f"{MODULE}.frame"), [0.24, 0.0, 0.25]).tolist()
    for name, value in (("frame", place), ("seat", "")):
        holding.set_fact(f"MACS-OLD.{name}", value)
    return holding


def test_both_arms_go_round_what_is_too_near_to_the_line(crowded):
    """A doubt that is two millimetres larger is a reason to go aside, not to refuse."""
    run = crowded.do("MOVE BOTH-ARMS TO POSITION 46 -8.5 100 CM")
    assert run.succeeded, run.refusal or run.failure
    leads, follows = run.primitives[0].paths[RIGHT].positions, run.primitives[0].paths[LEFT].positions
    hands = [MODEL.arms[RIGHT].fk(q) for q in leads]
    across = [geometry.relative(a, MODEL.arms[LEFT].fk(q)) for a, q in zip(hands, follows, strict=True)]
    assert max(geometry.distance(across[0], one) for one in across) < 1e-4
    start, goal = hands[0][:3], hands[-1][:3]
    along = (goal - start) / np.linalg.norm(goal - start)
    aside_m = max(float(np.linalg.norm(np.cross(one[:3] - start, along))) for one in hands)
    assert 0.005 < aside_m < 0.2


def test_both_arms_leave_no_line_that_the_sentence_states(crowded):
    run = crowded.do("MOVE BOTH-ARMS TO POSITION 46 -8.5 100 CM STRAIGHT-LINE")
    assert run.refusal is not None
    assert "MACS-OLD" in run.refusal.cause.owners
    assert "way round" not in run.refusal.message  # wording: none was sought


def test_one_leads_the_other_complies_and_each_carries_half(holding):
    made = bound(holding, UP).primitive
    assert made.control_law.compliance is None
    assert made.partner.control_law.compliance.stiffness[0] == 600.0
    assert [law.load.mass_kg for law in (made.control_law, made.partner.control_law)] == [1.0, 1.0]
    reasons = {stop.reason for stop in made.partner.stop_functions}
    assert {StopReason.GOAL, StopReason.TIMEOUT, StopReason.FORCE_LIMIT, StopReason.SLIP} <= reasons


def test_the_stiffness_of_the_sentence_is_that_of_the_second_arm(holding):
    made = bound(holding, f"{UP} MAINTAIN STIFFNESS 300 N/M").primitive
    assert made.control_law.compliance is None
    assert made.partner.control_law.compliance.stiffness[0] == 300.0


def test_a_condition_of_the_sentence_stops_both_arms_at_either_hand(holding):
    made = bound(holding, f"{UP} UNLESS FORCE EXCEEDS 10 N THEN STOP").primitive
    for stops in (made.stop_functions, made.partner.stop_functions):
        assert min(stop.when.limit_n for stop in stops if isinstance(stop.when, ForceAbove)) == 10.0


def test_what_is_maintained_is_watched_at_both_hands_and_the_attitude_at_the_first(holding):
    made = bound(holding, f"{UP} MAINTAIN SAFE-WORK-RANGE AVOID-NEIGHBORS POSE-DURING-MOTION SPEED 20 CM/S").primitive
    kinds = [{type(stop.when) for stop in stops} for stops in (made.stop_functions, made.partner.stop_functions)]
    watched = {TcpOutside, ClearanceBelow, TcpSpeedAbove}
    assert kinds[0] >= watched | {TcpTurned}
    assert kinds[1] >= watched
    assert TcpTurned not in kinds[1]


def test_the_second_hand_may_not_leave_a_range_either(holding):
    refusal = holding.elaborate(f"{UP} MAINTAIN SAFE-WORK-RANGE RIGHT-HALF", RIGHT_HALF)
    assert isinstance(refusal, Refusal)
    assert refusal.cause.region == "RIGHT-HALF"
    second = MODEL.arms[LEFT].fk(holding.world.value(f"{LEFT}.joints"))
    assert refusal.cause.y_m == pytest.approx(second[1])


def test_both_arms_and_the_object_are_claimed_and_written(holding):
    script = holding.elaborate(UP)
    assert set(script.resources) == set(script.writes) == {RIGHT, LEFT, MODULE}


@pytest.mark.parametrize(
    ("sentence", "facts"),
    [
        ("MOVE RIGHT-ARM BY 10 CM ALONG UP", {"need": "shared", "by": LEFT}),
        ("EXTRACT MACS-NEW FROM RACK-1 WITH BOTH-ARMS", {"reason": RefusalReason.NO_SCRIPT}),
        (f"{UP} UNLESS FORCE EXCEEDS 10 N THEN BACK-OFF", {"reason": RefusalReason.NO_SCRIPT}),
        ("MOVE BOTH-ARMS BY 90 CM ALONG UP", {"cause": "reach", "arm": RIGHT}),
        ("MOVE BOTH-ARMS BY 40 CM ALONG FORWARD", {"cause": "collision", "body_b": "SATELLITE lower-panel"}),
        ("MOVE BOTH-ARMS TO POSITION 90 0 60 CM", {"cause": "collision", "body_b": "SATELLITE lower-panel"}),
        ("MOVE BOTH-ARMS TO RACK-2-FRONT", {"cause": "place", "arm": RIGHT, "place": "RACK-2-FRONT"}),
        ("MOVE BOTH-ARMS TO JOINTS 0 0 0 0 0 0 DEG", {"where": "MOVE"}),
        ("MOVE BOTH-ARMS TO CLEAR-POINT-1 JOINT-MOTION", {"where": "MOVE"}),
        (
            "MOVE BOTH-ARMS TO CLEAR-POINT-1 THROUGH RACK-2-FRONT",
            {"cause": "place", "arm": RIGHT, "place": "RACK-2-FRONT"},
        ),
    ],
)
def test_what_two_arms_at_one_object_cannot_do_is_refused(holding, sentence, facts):
    run = holding.do(sentence)
    assert run.refusal is not None
    assert stated(run.refusal, facts) == facts
    assert run.primitives == []
    assert "RETRACT" not in in_one_line(run.refusal.clears)  # of one arm, which cannot move alone


@pytest.mark.parametrize("holder", [{}, {RIGHT: MODULE}, {RIGHT: MODULE, LEFT: "MACS-OLD"}])
def test_both_arms_must_hold_one_object(bench, holder):
    for arm, thing in holder.items():
        bench.set_fact(f"{arm}.holding", thing)
        bench.set_fact(f"{thing}.held_by", arm)
    refusal = bench.elaborate(UP)
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.STATE
    assert refusal.cause == NeedUnmet(need="both_hands", by=next(iter(holder.values()), ""))


def test_an_end_without_the_second_arm_leaves_its_position_in_doubt(holding):
    script = holding.elaborate(UP)
    made = holding.bind(script, script.steps[0])
    holding.subsystem.instead[made.primitive.id] = StopReason.HALT
    report = holding.subsystem.perform(made.primitive, made)
    assert report.partner is None
    changes = {change.key: change for change in holding.analyze(made, report).changes}
    assert changes[f"{LEFT}.joints"].validity is Validity.SUSPECT
    assert changes[f"{RIGHT}.joints"].validity is Validity.VALID


def test_the_joints_of_both_arms_are_read_after_a_loss(holding):
    for arm in (RIGHT, LEFT):
        holding.set_fact(f"{arm}.joints", holding.world.value(f"{arm}.joints"), Validity.SUSPECT)
    run = holding.do(UP.replace("40", "10"))
    assert run.succeeded, run
    assert [label for label in run.labels if label.startswith("read")] == [
        f"read the joints of {RIGHT}",
        f"read the joints of {LEFT}",
    ]


def test_a_step_that_moves_one_arm_leaves_the_joints_of_the_second_trusted(holding):
    holding.set_fact(f"{RIGHT}.joints", holding.world.value(f"{RIGHT}.joints"), Validity.SUSPECT)
    script = holding.elaborate(UP)
    made = holding.bind(script, script.steps[0])
    report = holding.subsystem.perform(made.primitive, made)
    assert f"{LEFT}.joints" not in {change.key for change in holding.analyze(made, report).changes}


@pytest.mark.physics
def test_a_second_hand_takes_a_module_which_is_carried_halted_carried_on_and_let_go_in_physics():
    carrier = Carrier()
    try:
        run = carrier.run(np.array([0.001, -0.002, 0.001, 0.005, 0.005, 0.005]), lift_m=0.06)
    finally:
        carrier.close()
    assert run.outcomes == CARRIED, run.causes
    assert max(run.between_n, run.resting_n) <= 5.0
    assert run.path_m == pytest.approx(0.06, abs=1e-3)
    assert run.slip_m < 0.002


def test_an_advice_for_each_arm_that_cannot_be_written_is_not_given(bench) -> None:
    refused = bench.elaborate("GIVE BOTH-ARMS TO OPERATOR")
    assert isinstance(refused, Refusal)
    assert sentences_of(refused.clears) == []


@pytest.mark.parametrize("verb", ["STOW", "RETRACT", "OPEN", "HOLD"])
def test_a_verb_without_a_script_for_two_arms_names_one_sentence_for_each(bench, verb) -> None:
    assert bench.do("MOVE RIGHT-ARM TO CLEAR-POINT-1").succeeded
    refused = bench.elaborate(f"{verb} BOTH-ARMS")
    assert isinstance(refused, Refusal)
    offered = sentences_of(refused.clears)
    assert offered == [f"{verb} {RIGHT}", f"{verb} {LEFT}"]
    for sentence in offered:
        assert bench.do(sentence).succeeded, sentence
