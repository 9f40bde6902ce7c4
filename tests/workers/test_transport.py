"""A held object on its way: EXTRACT, CARRY, HANDOFF, LIFT with both arms, PUSH, PULL, ALIGN; the pieces of AND TRY."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol.causes import BeyondStop, NeedUnmet, OutOfReach
from rtc.protocol.messages import Script, Validity
from rtc.protocol.outcomes import Refusal, RefusalReason, StopReason
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from rtc.world.model import World, initial_facts
from tests.refusals import stated
from tests.workers.conftest import CELL, MODEL, Bench, Reporter
from tests.workers.eyes import Ideal
from tests.workers.one_process import OneProcess
from workers.planning.robot_models import CellModel
from workers.planning.world_query import WorldQuery

RIGHT, LEFT, MODULE, DOOR = "RIGHT-ARM", "LEFT-ARM", "MACS-NEW", "DOOR-2"
GRASP = f"GRASP RIGHT-END-EFF {MODULE} HANDLE-A"
EXTRACT = f"EXTRACT {MODULE} FROM RACK-1"
GIVE = f"HANDOFF {MODULE} FROM {RIGHT} TO {LEFT}"
BOTH = f"CARRY {MODULE} TO BAY-2-FRONT WITH BOTH-ARMS"
SERVICING = CellModel(Cell.load("servicing"))


def done(bench: Bench, *sentences: str) -> Any:
    for sentence in sentences:
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, run.failure)
    return run


@pytest.fixture
def held(bench: Bench) -> Bench:
    """The right hand holds a module that is out of its rack."""
    done(bench, GRASP, EXTRACT)
    return bench


@pytest.fixture
def door() -> Bench:
    """The left hand holds the bar of a closed door."""
    bench = Bench(Reporter(SERVICING.cell), SERVICING)
    done(bench, f"GRASP LEFT-END-EFF {DOOR} LATCH-PULL")
    return bench


def who_holds(bench: Bench) -> tuple[str, str, str]:
    """What the right and the left hand hold, and the hand that the facts of the module refer to."""
    keys = (f"{RIGHT}.holding", f"{LEFT}.holding", f"{MODULE}.held_by")
    return tuple(bench.world.value(key) for key in keys)  # type: ignore[return-value]


def place(bench: Bench) -> geometry.Array:
    return WorldQuery(bench.model, bench.world).frame(MODULE)


def refusal_of(bench: Bench, sentence: str) -> Refusal:
    refusal = bench.elaborate(sentence)
    assert isinstance(refusal, Refusal), refusal
    return refusal


# --- EXTRACT, ALIGN, PUSH, PULL ----------------------------------------------------------------------------


def test_extract_leaves_the_slot_along_its_way_out(bench: Bench) -> None:
    done(bench, GRASP)
    before = place(bench)
    run = done(bench, EXTRACT)
    assert (place(bench) - before)[:3].tolist() == pytest.approx([0.0, 0.0, 0.17], abs=1e-3)
    assert bench.world.value(f"{MODULE}.seat") == ""
    assert run.primitives[1].control_law.compliance is not None


def test_an_extraction_that_is_given_again_goes_only_the_rest_of_the_way(bench: Bench) -> None:
    done(bench, GRASP, f"LIFT {MODULE} BY 10 CM")
    start = place(bench)[2]
    done(bench, EXTRACT)
    assert place(bench)[2] - start == pytest.approx(0.07, abs=1e-3)


def test_a_jammed_extraction_wiggles_and_ends_where_it_would_have_ended(bench: Bench) -> None:
    done(bench, GRASP)
    start = place(bench)[2]
    bench.subsystem.instead[f"C-{bench.commands + 1}.2"] = StopReason.FORCE_LIMIT
    run = done(bench, EXTRACT)
    assert run.trims == [1]
    assert [label for label in run.labels if label.startswith("turn")] == [
        f"turn {MODULE} a little to one side",
        f"turn {MODULE} to the other side",
        f"turn {MODULE} back",
    ]
    assert place(bench)[2] - start == pytest.approx(0.17, abs=1e-3)


@pytest.mark.parametrize(
    ("sentence", "facts"),
    [
        (f"EXTRACT {MODULE} FROM RACK-2", {"need": "object_in_target", "by": "RACK-1"}),
        ("EXTRACT MACS-OLD FROM RACK-2 WITH RIGHT-ARM", {"need": "hand_full", "by": MODULE}),
        ("EXTRACT SATELLITE FROM RACK-2", {"reason": RefusalReason.NO_SCRIPT, "where": "SATELLITE"}),
        ("PUSH MACS-OLD BY 3 CM", {"need": "object_held", "by": "MACS-OLD"}),
        (f"ALIGN {MODULE} TO RACK-2", {"need": "seat_free", "by": "MACS-OLD"}),
        (f"CARRY {MODULE} TO BAY-3", {"what": "place or seat", "name": "BAY-3"}),
        (f"HANDOFF {MODULE} FROM {LEFT} TO {RIGHT}", {"cause": "already", "object": MODULE}),
        (f"HANDOFF {MODULE} FROM {RIGHT} TO ARM GANTRY", {"what": "arm", "name": "GANTRY"}),
        (f"LIFT {MODULE} BY 10 CM WITH BOTH-ARMS", {"need": "both_hands", "by": MODULE}),
    ],
)
def test_what_is_impossible_is_refused_before_anything_moves(
    bench: Bench, sentence: str, facts: dict[str, object]
) -> None:
    done(bench, GRASP)
    refusal = refusal_of(bench, sentence)
    assert stated(refusal, facts) == facts
    assert refusal.clears


def test_align_brings_the_object_to_the_mouth_in_the_attitude_of_the_seat(held: Bench) -> None:
    done(held, f"ALIGN {MODULE} TO BAY-2")
    seated = WorldQuery(MODEL, held.world).seated_pose("BAY-2")
    assert (place(held) - seated)[:3].tolist() == pytest.approx([-0.25, 0.0, 0.0], abs=1e-3)
    assert geometry.angle(place(held), seated) < 1e-3


@pytest.mark.parametrize(("verb", "by_m"), [("PULL", -0.03), ("PUSH", 0.02)])
def test_a_held_object_is_pushed_and_pulled_along_its_axis(held: Bench, verb: str, by_m: float) -> None:
    done(held, f"CARRY {MODULE} TO BAY-2-FRONT")
    before = place(held)
    done(held, f"{verb} {MODULE} BY {abs(by_m) * 100:g} CM")
    assert (place(held) - before)[:3].tolist() == pytest.approx([by_m, 0.0, 0.0], abs=1e-4)


def test_a_door_is_pulled_open_and_pushed_shut_by_the_way_of_its_bar(door: Bench) -> None:
    assert isinstance(cause := refusal_of(door, f"PUSH {DOOR} BY 3 CM").cause, BeyondStop)
    assert cause.value_rad < cause.least_rad == 0.0
    lever_m = math.hypot(0.101, 0.20)
    done(door, f"PULL {DOOR} BY 6 CM WITH LEFT-ARM")
    lag_rad = 0.05  # a perfect arm does not lag behind its command
    assert door.world.value(f"{DOOR}.angle") == pytest.approx(0.06 / lever_m + lag_rad, abs=2e-3)
    run = done(door, f"PUSH {DOOR} BY 3 CM WITH LEFT-ARM MAINTAIN FORCE-LIMIT 15 N")
    assert door.world.value(f"{DOOR}.angle") == pytest.approx(0.03 / lever_m, abs=2e-3)
    assert run.primitives[-1].control_law.compliance.most_n <= 15.0


# --- CARRY, HANDOFF, both arms -----------------------------------------------------------------------------


def test_a_carry_leaves_the_slot_first(bench: Bench) -> None:
    done(bench, GRASP)
    run = done(bench, f"CARRY {MODULE} TO CLEAR-POINT-1")
    assert run.labels[1] == f"take {MODULE} UP, out of its seat"
    assert WorldQuery(MODEL, bench.world).tcp(RIGHT)[:3].tolist() == pytest.approx([0.48, -0.085, 0.95], abs=1e-4)


def test_a_carry_to_a_seat_ends_before_it(held: Bench) -> None:
    done(held, f"CARRY {MODULE} TO BAY-2")
    seated = WorldQuery(MODEL, held.world).seated_pose("BAY-2")
    assert (place(held) - seated)[0] <= -0.30 + 1e-6
    assert (place(held) - seated)[1:3].tolist() == pytest.approx([0.0, 0.0], abs=1e-4)
    done(held, f"INSERT {MODULE} INTO BAY-2")


@pytest.mark.parametrize("through", ["", " THROUGH CLEAR-POINT-1"])
def test_both_arms_carry_what_one_hand_holds(held: Bench, through: str) -> None:
    """The first hand brings it to where the second one takes it; both carry it from there."""
    script = held.elaborate(BOTH.replace(" WITH", f"{through} WITH"))
    assert isinstance(script, Script), script
    assert {*script.resources} >= {RIGHT, LEFT, MODULE, "CAMERA-1"}  # that one is for a second hand that misses it
    run = done(held, BOTH.replace(" WITH", f"{through} WITH"))
    assert who_holds(held) == (MODULE, MODULE, RIGHT)
    assert [made.performers for made in run.primitives].count([RIGHT, LEFT]) == (2 if through else 1)
    assert WorldQuery(MODEL, held.world).tcp(RIGHT)[:3].tolist() == pytest.approx([0.48, -0.085, 0.70], abs=1e-4)


def test_both_arms_lift_what_both_hands_hold(held: Bench) -> None:
    done(held, BOTH)
    before = place(held)[2]
    run = done(held, f"LIFT {MODULE} BY 10 CM WITH BOTH-ARMS UNLESS GRIP-FORCE BELOW 15 N THEN STOP AND TRY REGRASP")
    assert run.primitives[-1].performers == [RIGHT, LEFT]
    assert place(held)[2] - before == pytest.approx(0.10, abs=1e-4)


def test_a_slip_of_two_arms_closes_both_hands_again(held: Bench) -> None:
    done(held, BOTH)
    held.subsystem.instead[f"C-{held.commands + 1}.3"] = StopReason.SLIP
    run = done(held, f"LIFT {MODULE} BY 10 CM WITH BOTH-ARMS UNLESS SLIP THEN STOP AND TRY REGRASP")
    again = [label for label in run.labels if label.startswith("close again")]
    assert again == [f"close again on {MODULE}", f"close again on {MODULE} with {LEFT} too"]


def test_a_handoff_ends_with_the_object_in_the_second_hand(held: Bench) -> None:
    run = done(held, f"{GIVE} GUARDED")
    assert who_holds(held) == ("", MODULE, LEFT)
    assert [label.split()[0] for label in run.labels] == [
        *("hold", "bring", "restate", "go", "open", "straight", "close", "check", "let", "back")
    ]
    done(held, f"MOVE {LEFT} BY 3 CM ALONG UP")
    done(held, f"HANDOFF {MODULE} FROM {LEFT} TO {RIGHT}")
    assert who_holds(held) == (MODULE, "", RIGHT)


@pytest.mark.parametrize("sentence", [BOTH, GIVE])
def test_a_look_before_the_first_arm_moves_leaves_the_postures_of_the_second_one(held: Bench, sentence: str) -> None:
    """They were solved again as those of the first arm, which mostly cannot be there."""
    held.set_fact(f"{MODULE}.grasp", held.world.value(f"{MODULE}.grasp"), Validity.SUSPECT)
    script = held.elaborate(sentence)
    assert isinstance(script, Script), script
    look, restate = script.steps[:2]
    assert (look.do, restate.name) == ("look", "grasp_plan")
    bound = held.bind(script, restate)
    assert not bound.bindings
    done(held, sentence)


def test_what_both_hands_hold_is_handed_over_by_letting_go(held: Bench) -> None:
    done(held, BOTH)
    run = done(held, GIVE)
    assert who_holds(held) == ("", MODULE, LEFT)
    assert len(run.labels) == 3


def test_a_second_hand_that_closes_on_nothing_looks_and_takes_again(held: Bench) -> None:
    held.subsystem.closes = [0.020, 0.0]  # of the first hand before it moves, and of the second one
    run = done(held, GIVE)
    assert run.trims == [1]
    assert any(label.startswith(f"look for {MODULE}") for label in run.labels)
    assert who_holds(held) == ("", MODULE, LEFT)


def test_the_arm_is_offered_to_the_operator_without_a_script_for_the_verb(held: Bench) -> None:
    sentence = f"PLACE {MODULE} ON RACK-1"
    script = held.elaborate(sentence)
    first = next(step for step in script.steps if step.do == "move")
    bound = held.bind(script, first)
    held.subsystem.instead[bound.primitive.id] = StopReason.FORCE_LIMIT
    judged = held.analyze(bound, held.subsystem.perform(bound.primitive, bound))
    assert (judged.verdict, judged.by_operator) == ("abort", f"GIVE {RIGHT} TO OPERATOR")
    assert isinstance(held.elaborate(judged.by_operator), Script)


def test_the_operator_is_not_asked_to_grasp_what_another_arm_holds(held: Bench) -> None:
    second = held.elaborate(f"GRASP {MODULE} HANDLE-B WITH {LEFT}")
    offered = second.by_operator if isinstance(second, Refusal) else second.context.by_operator
    assert isinstance(held.elaborate(offered), Script)


def test_an_arm_whose_object_another_one_holds_too_is_not_given_to_the_operator(held: Bench) -> None:
    done(held, BOTH)
    assert held.elaborate(GIVE).context.by_operator == ""
    given = held.elaborate(f"GIVE {RIGHT} TO OPERATOR")
    refusal = held.bind(given, next(step for step in given.steps if step.do == "operate"))
    assert isinstance(refusal, Refusal)
    assert refusal.reason is RefusalReason.STATE
    assert refusal.cause == NeedUnmet(need="shared", by=LEFT)


def test_a_second_grasp_that_is_impossible_is_refused_before_the_first_arm_moves(held: Bench) -> None:
    for name in ("BAY-2-FRONT", "CLEAR-POINT-1"):  # no place is left where the arms can meet
        held.model = CellModel(_without(held.model.cell, name))
    refusal = refusal_of(held, GIVE)
    assert refusal.reason is RefusalReason.INFEASIBLE
    assert isinstance(refusal.cause, OutOfReach)
    assert refusal.cause.arm == LEFT


def _without(cell: Cell, place_name: str) -> Cell:
    return msgspec.structs.replace(cell, places=[one for one in cell.places if one.name != place_name])


# --- the pieces of AND TRY ---------------------------------------------------------------------------------

TRIED = [
    (f"GRASP {MODULE} UNLESS FORCE EXCEEDS 20 N THEN STOP AND TRY RELOCATE", "RELOCATE", []),
    (f"LIFT {MODULE} UNLESS GRIP-FORCE BELOW 15 N THEN STOP AND TRY REGRASP", "REGRASP", [GRASP]),
    (f"{EXTRACT} UNLESS FORCE EXCEEDS 60 N THEN COMPLY AND TRY WIGGLE", "WIGGLE", [GRASP]),
    (f"RELEASE {MODULE} UNLESS FORCE EXCEEDS 9 N THEN STOP AND TRY WIGGLE", "WIGGLE", [GRASP]),
    (f"PULL {MODULE} UNLESS SLIP THEN STOP AND TRY REGRASP", "REGRASP", [GRASP, EXTRACT]),
    (f"INSERT {MODULE} INTO BAY-2 UNLESS TORQUE EXCEEDS 3 NM THEN STOP AND TRY REALIGN", "REALIGN", [GRASP, EXTRACT]),
    (f"ALIGN {MODULE} TO BAY-2 UNLESS TORQUE EXCEEDS 3 NM THEN STOP AND TRY REALIGN", "REALIGN", [GRASP, EXTRACT]),
    (
        f"PLACE {MODULE} ON RACK-1 UNLESS FORCE EXCEEDS 9 N THEN STOP AND TRY PLACE-AGAIN",
        "PLACE-AGAIN",
        [GRASP, EXTRACT],
    ),
    (f"CARRY {MODULE} TO BAY-2 UNLESS SLIP THEN STOP AND TRY REGRASP", "REGRASP", [GRASP, EXTRACT]),
    (f"{GIVE} UNLESS SLIP THEN STOP AND TRY REGRASP", "REGRASP", [GRASP, EXTRACT]),
]


@pytest.mark.parametrize(("sentence", "name", "before"), TRIED)
def test_a_promised_trim_is_in_the_plan_of_its_verb(bench: Bench, sentence: str, name: str, before: list[str]) -> None:
    if before:
        done(bench, *before)
    script = bench.elaborate(sentence)
    assert isinstance(script, Script), script
    (tried,) = [trim for trim in script.trims if trim.label == f"TRY {name}"]
    assert tried.steps


@pytest.mark.parametrize(
    ("sentence", "able"),
    [
        (f"RELEASE {MODULE} UNLESS FORCE EXCEEDS 9 N THEN STOP AND TRY REALIGN", "WIGGLE"),
        (f"LIFT {MODULE} UNLESS FORCE EXCEEDS 9 N THEN STOP AND TRY REOPEN", "REGRASP"),
    ],
)
def test_a_piece_that_a_verb_has_no_use_for_is_refused_with_those_that_it_has(
    bench: Bench, sentence: str, able: str
) -> None:
    done(bench, GRASP)
    refusal = refusal_of(bench, sentence)
    assert refusal.reason is RefusalReason.NO_SCRIPT
    assert able in refusal.expected


def test_a_door_that_is_stopped_goes_back_and_ends_at_the_angle_of_the_sentence(door: Bench) -> None:
    done(door, f"OPEN {DOOR} BY 20 DEG")
    start = door.world.value(f"{DOOR}.angle")
    door.subsystem.instead[f"C-{door.commands + 1}.1"] = StopReason.FORCE_LIMIT
    run = door.do(f"OPEN {DOOR} BY 40 DEG UNLESS FORCE EXCEEDS 40 N THEN STOP AND TRY REOPEN")
    assert run.succeeded, run.failure
    assert run.labels[1] == f"turn {DOOR} back a little"
    lag_rad = 0.05
    assert door.world.value(f"{DOOR}.angle") - start == pytest.approx(math.radians(40.0) + lag_rad, abs=5e-3)


def test_a_hand_at_a_joint_limit_takes_the_bar_at_another_angle(door: Bench) -> None:
    door.subsystem.instead[f"C-{door.commands + 1}.1"] = StopReason.JOINT_LIMIT
    run = door.do(f"OPEN {DOOR} BY 40 DEG UNLESS JOINT-LIMIT THEN STOP AND TRY REPOSE")
    assert run.succeeded, (run.refusal, run.failure)
    assert run.labels[1:4] == [f"let go of {DOOR}", "turn the hand about the bar", f"close on {DOOR} again"]
    turned = geometry.angle(run.reports[0].tcp_pose, run.reports[-1].tcp_pose)
    assert turned == pytest.approx(0.3, abs=1e-2)
    assert math.degrees(door.world.value(f"{DOOR}.angle")) == pytest.approx(40.0, abs=4.0)


# --- in physics --------------------------------------------------------------------------------------------


class Carried(NamedTuple):
    """A cluster in one process, on physics, whose right hand holds a module that it has pulled out of its rack."""

    sim: Any
    state: Any
    world: World

    def cluster(self) -> OneProcess:
        self.sim.restore(self.state)
        return OneProcess(self.sim, MODEL, self.world, Ideal(CELL))


@pytest.fixture(scope="module")
def carried() -> Iterator[Carried]:
    from sim_mcm.arms.bullet_arm import BulletCell

    sim = BulletCell(CELL)
    world = World().overlay([msgspec.structs.replace(change, spread=None) for change in initial_facts(CELL)])
    cluster = OneProcess(sim, MODEL, world, Ideal(CELL))
    submitted(cluster, GRASP, EXTRACT)
    yield Carried(sim, sim.state(), cluster.world)
    sim.close()


def submitted(cluster: OneProcess, *sentences: str) -> None:
    for sentence in sentences:
        command = cluster.give(sentence)
        cluster.run(120.0)
        outcome = cluster.outcomes[command]
        assert outcome.kind.value == "succeeded", (sentence, outcome)


def truth(cluster: OneProcess) -> dict[str, Any]:
    return cluster.sim.truth()  # type: ignore[no-any-return]


def off_m(cluster: OneProcess) -> float:
    """How far the module is from where the world has it (m)."""
    return geometry.distance(cluster.world.value(f"{MODULE}.frame"), truth(cluster)["poses"][MODULE])


def in_hand(cluster: OneProcess, arm: str) -> geometry.Array:
    """The true pose of the module in a hand."""
    return geometry.relative(truth(cluster)["tcp"][arm], truth(cluster)["poses"][MODULE])


@pytest.mark.physics
def test_an_extracted_module_is_free_of_its_rack_in_physics(carried: Carried) -> None:
    cluster = carried.cluster()
    assert cluster.world.value(f"{MODULE}.seat") == ""
    assert truth(cluster)["poses"][MODULE][2] == pytest.approx(0.60 + 0.17, abs=0.002)
    assert off_m(cluster) < 0.002


@pytest.mark.physics
def test_a_handed_over_module_is_in_the_second_hand_in_physics(carried: Carried) -> None:
    cluster = carried.cluster()
    submitted(cluster, GIVE)
    assert cluster.world.value(f"{MODULE}.held_by") == LEFT
    assert off_m(cluster) < 0.002
    before = in_hand(cluster, LEFT)
    submitted(
        cluster, f"MOVE {LEFT} BY 3 CM ALONG BACK"
    )  # the first hand is open: the module follows the second one alone
    assert geometry.distance(in_hand(cluster, LEFT), before) < 0.002
    assert off_m(cluster) < 0.002


@pytest.mark.physics
def test_both_arms_take_carry_and_lift_a_module_in_physics(carried: Carried) -> None:
    cluster = carried.cluster()
    submitted(cluster, BOTH)
    assert truth(cluster)["tcp"][RIGHT][:3] == pytest.approx([0.48, -0.085, 0.70], abs=0.002)
    hands = [in_hand(cluster, arm) for arm in (RIGHT, LEFT)]
    assert off_m(cluster) < 0.002
    submitted(cluster, f"LIFT {MODULE} BY 5 CM WITH BOTH-ARMS UNLESS GRIP-FORCE BELOW 15 N THEN STOP AND TRY REGRASP")
    assert truth(cluster)["tcp"][RIGHT][2] == pytest.approx(0.75, abs=0.002)
    for arm, before in zip((RIGHT, LEFT), hands, strict=True):
        assert geometry.distance(in_hand(cluster, arm), before) < 0.002


@pytest.mark.physics
def test_a_module_is_carried_aligned_pulled_and_pushed_in_physics(carried: Carried) -> None:
    cluster = carried.cluster()
    submitted(cluster, f"CARRY {MODULE} TO BAY-2", f"ALIGN {MODULE} TO BAY-2")
    assert truth(cluster)["poses"][MODULE][:3] == pytest.approx([0.93 - 0.25, 0.0, 0.70], abs=0.003)
    submitted(cluster, f"PULL {MODULE} BY 3 CM", f"PUSH {MODULE} BY 2 CM")
    assert truth(cluster)["poses"][MODULE][:3] == pytest.approx([0.93 - 0.26, 0.0, 0.70], abs=0.004)
    assert off_m(cluster) < 0.002


@pytest.mark.physics
def test_a_door_is_pulled_and_pushed_in_physics() -> None:
    from sim_mcm.arms.bullet_arm import BulletCell

    sim = BulletCell(SERVICING.cell)
    cluster = OneProcess(sim, SERVICING, eyes=Ideal(SERVICING.cell))
    try:
        submitted(cluster, f"GRASP LEFT-END-EFF {DOOR} LATCH-PULL", f"PULL {DOOR} BY 6 CM", f"PUSH {DOOR} BY 3 CM")
        angle = cluster.world.value(f"{DOOR}.angle")
        assert angle == pytest.approx(0.03 / math.hypot(0.101, 0.20), abs=0.02)
        assert geometry.angle(cluster.world.value(f"{DOOR}.frame"), truth(cluster)["poses"][DOOR]) < 0.02
    finally:
        sim.close()


def test_what_is_held_in_a_doubtful_grasp_is_not_given_on(held: Bench) -> None:
    held.without_cameras()
    held.set_fact(f"{MODULE}.grasp", held.world.value(f"{MODULE}.grasp"), Validity.SUSPECT)
    for sentence in (GIVE, BOTH, f"CARRY {MODULE} TO BAY-2"):
        assert in_one_line(refusal_of(held, sentence).clears) == f"VERIFY {MODULE} AT {RIGHT}"


# --- INSERT ------------------------------------------------------------------------------------------------


def test_a_jammed_module_is_turned_moved_aside_and_turned_again_before_it_is_given_up(held: Bench) -> None:
    script = held.elaborate(f"INSERT {MODULE} INTO BAY-2")
    assert isinstance(script, Script)
    places = [{name for step in trim.steps if (name := step.to)} for trim in script.trims[:6]]
    assert places == [{"TURN1"}, {"TURN2"}, {"SIDE1"}, {"SIDE2"}, {"TURN3"}, {"TURN4"}]
    way = {name: script.bindings[name].pose for name in ("MOUTH", "SIDE1", "SIDE2")}
    for side, by_m in (("SIDE1", 0.002), ("SIDE2", -0.002)):
        off = geometry.relative(way["MOUTH"], way[side])
        assert off[:3] == pytest.approx([0.0, by_m, 0.0], abs=1e-9)  # as the fingers close
    before, bring = held.bind(script, script.steps[0]), script.steps[1]
    held.subsystem.perform(before.primitive, before)
    held.set_fact(f"{RIGHT}.joints", held.subsystem.joints[RIGHT].tolist())
    bound = held.bind(script, bring)
    report = held.subsystem.perform(bound.primitive, bound)
    jam = msgspec.structs.replace(report, reason=StopReason.FORCE_LIMIT, measured=0.06, limit=0.06)
    for used in range(6):
        judged = held.analyze(bound, jam, used=[*range(1, used + 1)])
        assert (judged.verdict, judged.trim) == ("trim", used + 1)
    assert held.analyze(bound, jam, used=[*range(1, 7)]).verdict == "abort"
