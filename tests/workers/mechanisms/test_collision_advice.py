"""What a refusal for a blocked way advises leads on, word for word."""

from __future__ import annotations

import msgspec
import pytest

from rtc.model.cells.cell import Cell
from rtc.programs.loader import decode
from rtc.programs.schema import BinderProgram, ElaboratorProgram
from rtc.protocol import causes
from rtc.protocol.advice import ANOTHER_ARM, sentences_of
from rtc.protocol.messages import EndReport, WorldChange
from rtc.protocol.outcomes import Refusal, RefusalReason, Refused, StopReason
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from tests.workers.conftest import Bench, Reporter, record
from workers.elaborator import backtrack
from workers.mechanisms.collision_advice import advise_on_collision
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
LIFT = "LIFT MACS-NEW BY 15 CM"
BODIES = causes.Collides(body_a="RIGHT-ARM palm", body_b="SATELLITE right-panel")


def in_hand(bench, *sentences):
    for sentence in (GRASP, *sentences):
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal)


@pytest.mark.parametrize(
    "sentence", ["STOW RIGHT-ARM", "MOVE RIGHT-ARM TO CLEAR-POINT-1", "MOVE RIGHT-ARM BY 5 CM ALONG LEFT"]
)
def test_a_module_that_is_still_in_its_seat_is_lifted_first(bench, sentence):
    in_hand(bench)
    refusal = bench.do(sentence).refusal
    assert sentences_of(refusal.clears) == ["LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM"]
    assert bench.do("LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM").succeeded
    assert bench.do(sentence).refusal is None


def test_a_blocked_goal_is_named_as_the_goal(bench):
    in_hand(bench, LIFT)
    refusal = bench.do("MOVE RIGHT-ARM TO POSITION 80 -80 70 CM").refusal
    assert in_one_line(refusal.clears).startswith("another goal: RACK-1 is there")


def test_a_way_that_is_blocked_goes_by_another_place(bench):
    blocked = Refusal(
        reason=RefusalReason.INFEASIBLE,
        message="MACS-NEW case collides with SATELLITE right-panel (40% along the way)",
        cause=causes.Collides(body_a="MACS-NEW case", body_b="SATELLITE right-panel"),
        fraction=0.4,
    )
    clears = decode(bench.programs["binder"], BinderProgram).clears

    advised = advise_on_collision(blocked, WorldQuery(bench.model, bench.world), "RIGHT-ARM", clears)

    places = ["BAY-2-FRONT", "CLEAR-POINT-1", "RACK-1-FRONT"]
    assert [f"MOVE RIGHT-ARM TO {place}" for place in places] == sentences_of(advised.clears)[1:]


@pytest.mark.parametrize(
    ("sentence", "cause"),
    [
        ("MOVE RIGHT-ARM TO POSITION 80 -30 120 CM", " MAINTAIN AVOID-TASK-REGION SOLAR-ARRAY"),
        ("MOVE RIGHT-ARM TO BAY-2-FRONT", " MAINTAIN AVOID-NEIGHBORS BY 30 CM"),
    ],
)
def test_a_motion_that_only_a_maintain_blocks_is_done_without_it(bench, sentence, cause):
    advised = bench.do(sentence + cause).refusal.clears

    assert any(f"leave out {cause.split()[1]}" in one.words for one in advised)
    assert bench.elaborate(sentence).steps


def test_the_advised_distance_from_neighbours_is_one_for_which_there_is_room(bench):
    given = ["MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN AVOID-NEIGHBORS BY 30 CM"]
    while (refusal := bench.do(given[-1]).refusal) is not None:
        given.append(next(text for text in sentences_of(refusal.clears) if "AVOID-NEIGHBORS BY" in text))
        assert len(given) <= 4, given
    assert len(given) > 1
    assert record(given[-1]).constraints[0].value.value > 0.005


def test_a_goal_with_less_room_than_the_usual_clearance_is_reached_with_the_advised_one(bench):
    aim = "MOVE RIGHT-ARM TO POSITION 80 -80 70.8 CM"  # 3 mm above a module; 5 mm are usual
    refusal = bench.elaborate(aim)
    closer = sentences_of(refusal.clears)[0]

    assert refusal.cause.distance_m == pytest.approx(0.003, abs=5e-4)
    assert bench.do(closer).succeeded
    assert not isinstance(bench.elaborate("MOVE RIGHT-ARM BY 2 CM ALONG UP"), Refusal)  # it can leave again
    inside = bench.elaborate("MOVE RIGHT-ARM TO POSITION 80 -80 70 CM")
    assert not any("AVOID-NEIGHBORS" in text for text in sentences_of(inside.clears))


@pytest.mark.parametrize(
    ("distance_m", "seen", "first"), [(0.022, True, "LOCATE"), (0.022, False, "GRASP"), (0.002, True, "GRASP")]
)
def test_a_door_that_lacks_room_only_for_its_angle_is_looked_at_if_a_camera_sees_it(distance_m, seen, first):
    cell = Cell.load("servicing")
    cell = cell if seen else msgspec.structs.replace(cell, cameras=[])
    bench = Bench(Reporter(cell), CellModel(cell))
    door = WorldQuery(bench.model, bench.world).frame("DOOR-2").tolist()
    bench.world = bench.world.overlay([WorldChange(key="DOOR-2.frame", value=door, spread=[0.0] * 5 + [0.03])])
    cause = causes.Collides(body_a="RIGHT-ARM palm", body_b="DOOR-2 panel", distance_m=distance_m)
    blocked = Refusal(reason=RefusalReason.INFEASIBLE, message="too near", cause=cause)
    clears = decode(bench.programs["binder"], BinderProgram).clears

    advised = advise_on_collision(blocked, WorldQuery(bench.model, bench.world), "RIGHT-ARM", clears)

    assert advised.clears[0].sentences[0] == f"{first} DOOR-2"


def test_a_segment_that_is_blocked_whatever_way_leads_to_it_is_the_reason(bench, monkeypatch):
    """Not the direct way before it, round which a way would be sought."""

    def blocked(*args):
        detours = args[-1]
        message = "the goal is taken" if detours else "the direct way is blocked"
        raise Refused.because(RefusalReason.INFEASIBLE, message, cause=BODIES)

    monkeypatch.setattr(backtrack, "_try", blocked)
    assert bench.elaborate("MOVE RIGHT-ARM TO BAY-2-FRONT").cause == BODIES


@pytest.mark.parametrize("aim", ["GRASP MACS-OLD", "GRASP RIGHT-END-EFF MACS-OLD HANDLE-A"])
def test_a_closed_door_is_named_and_following_the_advice_leads_to_the_aim(aim):
    """An arm beside the path is not the obstacle if the path stays blocked without it."""
    cell = Cell.load("servicing")
    bench = Bench(Reporter(cell), CellModel(cell))
    refusals = []
    while (refusal := bench.do(aim).refusal) is not None:
        refusals.append(refusal)
        assert len(refusals) <= 4, [in_one_line(each.clears) for each in refusals]
        for sentence in refusal.clears[0].sentences:
            done = bench.do(sentence)
            assert done.succeeded, (sentence, done.refusal)

    assert "DOOR-2" in refusals[0].cause.body_b
    assert len({in_one_line(refusal.clears) for refusal in refusals}) == len(refusals)  # no advice twice


def test_a_module_beside_the_satellite_finds_its_way_into_the_bay(bench):
    """None of the direct ways is free from there."""
    in_hand(bench, "LIFT MACS-NEW BY 20 CM", "MOVE RIGHT-ARM TO POSITION 57 -62 52 CM")

    assert bench.do("PLACE MACS-NEW ON BAY-2").succeeded


@pytest.mark.parametrize("sentence", ["PLACE MACS-NEW ON RACK-1", LIFT])
def test_an_arm_that_has_crept_is_looked_at_and_the_step_done_again(bench, sentence):
    in_hand(bench, LIFT) if sentence != LIFT else in_hand(bench)
    perform, refused = bench.subsystem.perform, []

    def crept(made, bound):
        report = perform(made, bound) if bound.evaluation.step.do != "move" or refused else None
        if report is None:  # the first way is refused: the arm is 0.014 rad from where it began
            refused.append(made.id)
            joints = bench.subsystem.joints["RIGHT-ARM"]
            joints[5] += 0.014
            return EndReport(
                primitive=made.id,
                performer="RIGHT-ARM",
                reason=StopReason.REFUSED,
                at_s=0.0,
                duration_s=0.0,
                joints=joints.tolist(),
                tcp_pose=bench.model.arms["RIGHT-ARM"].fk(joints).tolist(),
                wrench=[0.0] * 6,
                hand_width_m=bench.subsystem.widths["RIGHT-ARM"],
                hand_force_n=45.0,
            )
        return report

    bench.subsystem.perform = crept
    run = bench.do(sentence)

    assert len(refused) == 1
    assert run.trims == [1]
    assert run.succeeded, (run.refusal, run.assessments)
    assert geometry.distance(bench.world.value("MACS-NEW.frame"), [0, 0, 0]) > 0


@pytest.mark.parametrize(
    ("held", "goal", "other_arm"),
    [("", "BAY-2-FRONT", True), ("MACS-NEW", "BAY-2-FRONT", False), ("", "RACK-1-FRONT", False)],
)
def test_neither_the_goal_nor_an_arm_without_the_object_is_advised(bench, held, goal, other_arm):
    """Nor an arm for which the place has no posture: RACK-1-FRONT is beyond its reach."""
    bench.set_fact("RIGHT-ARM.holding", held)
    blocked = Refusal(
        reason=RefusalReason.INFEASIBLE,
        message="RIGHT-ARM link_2 collides with SATELLITE right-panel (40% along the way)",
        cause=causes.Collides(body_a="RIGHT-ARM link_2", body_b="SATELLITE right-panel"),
        fraction=0.4,
    )
    clears = decode(bench.programs["elaborator"], ElaboratorProgram).clears

    query = WorldQuery(bench.model, bench.world)
    advised = advise_on_collision(blocked, query, "RIGHT-ARM", clears, goal=goal).clears

    assert f"MOVE RIGHT-ARM TO {goal}" not in sentences_of(advised)
    assert "MOVE RIGHT-ARM TO CLEAR-POINT-1" in sentences_of(advised)
    assert (ANOTHER_ARM in advised) is other_arm


def inside_the_handle(bench):
    """A GRASP of a module that may be 35 mm off is halted while the fingers are around the handle."""
    bench.unsurveyed()
    bench.without_cameras()
    script = bench.elaborate(GRASP)
    bindings = dict(script.bindings)
    for n, step in enumerate(script.steps, 1):
        bound = bench.bind(script, step, bindings, n)
        bindings |= bound.bindings
        if bound.primitive is not None:
            report = bench.subsystem.perform(bound.primitive, bound)
            bench.world = bench.world.overlay(bench.analyze(bound, report).changes)
        if step.label.startswith("straddle"):
            return


@pytest.mark.parametrize(
    "sentence", ["STOW RIGHT-ARM", "MOVE RIGHT-ARM TO CLEAR-POINT-1 MAINTAIN AVOID-NEIGHBORS BY 1 CM"]
)
def test_a_hand_at_a_handle_that_may_be_elsewhere_backs_off_before_it_leaves(bench, sentence):
    """On a free path the fingers could meet the bar, which is up to 35 mm from its believed place."""
    inside_the_handle(bench)
    refusal = bench.elaborate(sentence)
    assert sentences_of(refusal.clears) == ["RETRACT RIGHT-ARM", *filter(None, [refusal.by_operator])]
    assert bench.do("RETRACT RIGHT-ARM").succeeded
    assert bench.do(sentence).succeeded


def test_a_hand_at_a_handle_may_grasp_again(bench):
    inside_the_handle(bench)
    run = bench.do(GRASP)
    assert "straddle HANDLE-A" in run.labels


def test_a_hand_at_a_handle_whose_place_is_known_leaves_on_any_free_path(bench):
    inside_the_handle(bench)
    fact = bench.world.get("MACS-NEW.frame")
    bench.set_fact("MACS-NEW.frame", fact.value)  # without a spread
    assert bench.do("STOW RIGHT-ARM").succeeded
