"""The operator performs sentences, in one process: a scripted operator moves the arms by a stream, and answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import pytest

from rtc.protocol import messages as m
from rtc.protocol.outcomes import Outcome, OutcomeKind, RefusalReason, StopReason
from rtc.spatial import geometry
from sim_mcm.arms.bullet_arm import BulletCell
from sim_mcm.arms.kinematic_arm import KinematicCell
from tests.campaigns import operator_near
from tests.campaigns.door import stand_open
from tests.workers.conftest import MODEL, Bench, Physical
from tests.workers.mechanisms.bolts.test_by_sentence import SERVICING
from tests.workers.one_process import OneProcess

ARM, OTHER = "RIGHT-ARM", "LEFT-ARM"
PERIOD = 20  # ticks between two messages
GAIN_PER_S, ARRIVED_M = 4.0, 0.0008


class Operator:
    """A person with a hand controller, who sees where things are; `at` the operated arm."""

    def __init__(self, rtc: OneProcess, arm: str = ARM) -> None:
        self.rtc, self.arm = rtc, arm

    @property
    def executor(self) -> Any:
        return self.rtc.mcm.executors[self.arm]

    @property
    def asked(self) -> str:
        """The request; empty: none."""
        return "" if self.executor.operated is None else self.executor.operated.look().request

    def wait(self, words: str, limit_s: float = 60.0) -> None:
        """Until this is requested."""
        for _ in range(round(limit_s * 1000)):
            if words in self.asked:
                return
            self.rtc.tick()
        raise AssertionError((words, self.asked, self.rtc.outcomes, self.rtc.notes[-5:]))

    def send(self, **wanted: Any) -> str:
        given = {"primitive": self.executor.primitive_id, "operator": "ADA", "seen_at_s": self.rtc.now_s, "hold": True}
        return self.rtc.mcm.operate(m.Operate(**given | wanted), b"ada", self.rtc.now_s).refused

    def drive(self, seconds: float, **wanted: Any) -> None:
        for _ in range(round(seconds * 1000 / PERIOD)):
            self.send(**wanted)
            for _ in range(PERIOD):
                self.rtc.tick()

    def go(self, goal: Sequence[float], limit_s: float = 60.0) -> None:
        """Bring the tcp to this pose (world), and let go."""
        for _ in range(round(limit_s * 1000 / PERIOD)):
            here = self.executor.arm.tcp_pose(self.executor.sample.joints)
            off, turn = np.asarray(goal[:3]) - here[:3], geometry.rotation_vector(here, goal)
            if np.linalg.norm(off) < ARRIVED_M and np.linalg.norm(turn) < 0.004:
                break
            self.drive(PERIOD / 1000, twist=[*(GAIN_PER_S * off), *(GAIN_PER_S * turn)])
            assert self.executor.operated is not None, self.rtc.notes[-3:]
        else:
            raise AssertionError((self.executor.operated.look(), off, turn))
        self.drive(0.1, hold=False)

    def say(self, sentence: str) -> Outcome:
        """Give an answer, and wait for its outcome."""
        command = self.rtc.give(sentence, client="ada")
        for _ in range(2000):
            if command in self.rtc.outcomes:
                return self.rtc.outcomes[command]
            self.rtc.tick()
        raise AssertionError(sentence)


def grasp_pose(sim: Any, thing: str, point: str) -> np.ndarray:
    """Where the tcp is at a grasp point, in the true world."""
    frame = next(one.frame.pose for one in MODEL.cell.object(thing).grasp_points if one.name == point)
    return geometry.compose(sim.truth()["poses"][thing], frame)


def grasp_by_hand(rtc: OneProcess, command: str) -> None:
    """Perform the three requests of GRASP VIA OPERATOR-INTERVENTION, with what is done wrong on the way."""
    it, sim = Operator(rtc), rtc.sim
    it.wait("neighborhood")
    goal = grasp_pose(sim, "MACS-NEW", "HANDLE-A")
    refused = it.say("DONE")
    assert refused.kind is OutcomeKind.REFUSED
    assert refused.refusal.reason is RefusalReason.STATE
    before = geometry.translate(goal, -0.12 * geometry.rotate(goal, (0.0, 0.0, 1.0)))
    it.go(before)
    assert "hand is not part" in it.send(hand="close")
    assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
    it.wait("grasp point")
    assert it.say("DONE").kind is OutcomeKind.REFUSED
    it.go(goal)
    assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
    it.wait("close the hand")
    assert it.say("DONE").kind is OutcomeKind.REFUSED  # nothing is gripped
    it.drive(2.0, hand="close")
    it.drive(0.1, hold=False)
    assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
    rtc.run()
    assert rtc.outcomes[command].kind is OutcomeKind.SUCCEEDED, rtc.outcomes[command]


def off_mm(rtc: OneProcess, thing: str) -> float:
    return 1000.0 * math.dist(rtc.world.value(f"{thing}.frame")[:3], rtc.sim.truth()["poses"][thing][:3])


def off_deg(rtc: OneProcess, thing: str) -> float:
    return math.degrees(geometry.angle(rtc.world.value(f"{thing}.frame"), rtc.sim.truth()["poses"][thing]))


def knows_where_it_is(rtc: OneProcess, thing: str) -> None:
    assert rtc.world.get(f"{thing}.frame").validity is m.Validity.VALID
    assert off_mm(rtc, thing) < 2.0
    assert off_deg(rtc, thing) < 1.0


def displaced(sim: Any) -> OneProcess:
    """A cell whose rack with the module is 12 mm and 3.5 degrees from where it is believed to be."""
    rtc = OneProcess(sim)
    assert sim.displace("MACS-NEW", [0.0, 0.006, 0.0104, 0.03, -0.02, 0.05]) == ""
    return rtc


@pytest.mark.physics
def test_in_physics_the_world_knows_what_the_operator_has_gripped_and_moved() -> None:
    sim = BulletCell(MODEL.cell)
    try:
        rtc = displaced(sim)
        assert off_mm(rtc, "MACS-NEW") == pytest.approx(12.0, abs=0.1)
        assert off_deg(rtc, "MACS-NEW") == pytest.approx(3.5, abs=0.1)
        command = rtc.give("GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM VIA OPERATOR-INTERVENTION")
        grasp_by_hand(rtc, command)
        assert sim.held()[ARM] == ["MACS-NEW"]
        knows_where_it_is(rtc, "MACS-NEW")
        lift = rtc.give("LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM")
        rtc.run()
        assert rtc.outcomes[lift].kind is OutcomeKind.SUCCEEDED, rtc.outcomes[lift]
        knows_where_it_is(rtc, "MACS-NEW")
        rtc.give("GIVE RIGHT-ARM TO OPERATOR")
        it = Operator(rtc)
        it.wait("move")
        it.drive(4.0, twist=[-0.03, 0.02, 0.02, 0.0, 0.06, 0.06])
        it.drive(0.3, hold=False)
        assert it.say("TAKE RIGHT-ARM FROM OPERATOR").kind is OutcomeKind.SUCCEEDED
        rtc.run()
        knows_where_it_is(rtc, "MACS-NEW")
    finally:
        sim.close()


def test_give_and_take_hand_an_arm_over_between_two_points_of_rest() -> None:
    rtc = OneProcess(KinematicCell(MODEL.cell))
    it, given = Operator(rtc), rtc.give("GIVE RIGHT-ARM TO OPERATOR")
    it.wait("move")
    held = rtc.give("STOW RIGHT-ARM")  # the arm is the operator's
    beside = rtc.give("STOW LEFT-ARM")  # is not planned beside an arm that a person moves
    it.drive(1.0, twist=[0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    assert "hand is not part" in it.send(hand="close")
    assert rtc.state.commands[held].phase is m.Phase.HELD
    waits = {n.command: n.clears for n in rtc.notes if n.phase is m.Phase.HELD}
    assert all(waits[name] == ["TAKE RIGHT-ARM FROM OPERATOR"] for name in (held, beside))
    assert it.say("TAKE LEFT-ARM FROM OPERATOR").kind is OutcomeKind.REFUSED
    assert it.say("TAKE RIGHT-ARM FROM OPERATOR").kind is OutcomeKind.REFUSED  # it moves
    it.drive(0.2, hold=False)
    where = it.executor.sample.joints
    assert it.say("TAKE RIGHT-ARM FROM OPERATOR").kind is OutcomeKind.SUCCEEDED
    rtc.run()
    kinds = {name: rtc.outcomes[name].kind.value for name in (given, held, beside)}
    assert kinds == dict.fromkeys((given, held, beside), "succeeded")
    assert where != pytest.approx(MODEL.cell.arm(ARM).home_rad)


def test_cannot_ends_the_command_with_the_reason() -> None:
    rtc = OneProcess(KinematicCell(MODEL.cell))
    it = Operator(rtc)
    command = rtc.give("MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SHARED VIA OPERATOR-INTERVENTION")
    it.wait("move")
    assert it.say('CANNOT "the way is blocked"').kind is OutcomeKind.SUCCEEDED
    rtc.run()
    outcome = rtc.outcomes[command]
    assert (outcome.kind, outcome.stop) == (OutcomeKind.FAILED, StopReason.OPERATOR_CANNOT)
    assert "the way is blocked" in outcome.message  # wording: the operator's own words


def test_the_request_comes_again_after_a_stop_function_and_then_the_command_fails() -> None:
    rtc = OneProcess(KinematicCell(MODEL.cell))
    it, command = Operator(rtc), rtc.give("GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM VIA OPERATOR-INTERVENTION")
    for _ in range(4):
        it.wait("neighborhood")
        grant = it.executor.primitive_id
        it.drive(0.1)
        it.executor.halt(StopReason.FORCE_LIMIT, "pushed")
        while it.executor.primitive_id == grant:
            rtc.tick()
        assert it.send(primitive=grant) != ""
    rtc.run()
    assert rtc.outcomes[command].stop is StopReason.FORCE_LIMIT


@pytest.mark.parametrize(
    "sentence",
    [
        "DONE",
        'CANNOT "no"',
        "TAKE RIGHT-ARM FROM OPERATOR",
        "RELEASE MACS-OLD VIA OPERATOR-INTERVENTION",
        "TEST DONE",
        "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SHARED",
        "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SHARED ELBOW",
        "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SHARED WRIST VIA OPERATOR-INTERVENTION",
        "MOVE RIGHT-ARM BY 5 CM ALONG UP MAINTAIN SHARED WRIST",
        "STOW RIGHT-ARM MAINTAIN SHARED TRANSLATION",
        # there the shoulder is in the region, or the hand is outside of it
        "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN AVOID-TASK-REGION BAY-2-RANGE VIA OPERATOR-INTERVENTION",
        "MOVE RIGHT-ARM TO RACK-1-FRONT MAINTAIN SAFE-WORK-RANGE BAY-2-RANGE VIA OPERATOR-INTERVENTION",
        "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A MAINTAIN SAFE-WORK-RANGE BAY-2-RANGE VIA OPERATOR-INTERVENTION",
    ],
)
def test_what_nothing_performs_is_refused(sentence: str) -> None:
    rtc = OneProcess(KinematicCell(MODEL.cell))
    command = rtc.give(sentence)
    rtc.run()
    assert rtc.outcomes[command].kind is OutcomeKind.REFUSED, rtc.outcomes[command]
    assert rtc.outcomes[command].refusal.clears


SHARED = "MOVE RIGHT-ARM TO BAY-2-FRONT MAINTAIN SHARED WRIST AND FORCE-LIMIT 15 N"


@pytest.mark.parametrize("cell_of", [KinematicCell, pytest.param(BulletCell, marks=pytest.mark.physics)])
def test_the_program_brings_the_arm_to_the_place_while_the_operator_turns_the_wrist(cell_of: Any) -> None:
    rtc = OneProcess(sim := cell_of(MODEL.cell))
    try:
        it, command = Operator(rtc), rtc.give(SHARED)
        it.wait("its WRIST is yours")
        assert it.say("DONE").kind is OutcomeKind.REFUSED
        start = it.executor.arm.tcp_pose(it.executor.sample.joints)
        it.drive(2.0, twist=[0.05, 0.0, 0.0, 0.0, 0.0, 0.1])
        for _ in range(1000):
            look = it.executor.operated.look()
            if look.off_m < 0.2 * look.done_m:
                break
            it.drive(PERIOD / 1000)
        it.drive(0.3, hold=False)
        end = it.executor.arm.tcp_pose(it.executor.sample.joints)
        assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
        rtc.run()
        assert rtc.outcomes[command].kind is OutcomeKind.SUCCEEDED, rtc.outcomes[command]
        goal = MODEL.cell.place("BAY-2-FRONT").poses[ARM]
        assert math.dist(end[:3], goal.xyz) < 0.01
        assert geometry.rotation_vector(start, end) == pytest.approx([0.0, 0.0, 0.2], abs=0.03)
        assert rtc.world.value(f"{ARM}.joints") == pytest.approx(it.executor.sample.joints, abs=1e-3)
    finally:
        if hasattr(sim, "close"):
            sim.close()


@pytest.mark.parametrize("laden", [False, True])
def test_full_stick_towards_an_obstacle_ends_before_it_and_may_go_back(laden: bool) -> None:
    rtc = OneProcess(sim := KinematicCell(MODEL.cell))
    if laden:
        back = geometry.translate(sim.arms[ARM].pose, [-0.2, 0.0, 0.0])
        state = sim.state()
        state.arms[ARM].joints = MODEL.arms[ARM].nearest_ik(back, sim.arms[ARM].joints).tolist()
        state.carried["MACS-NEW"] = (ARM, [0.0, 0.0, 0.19, 0.0, 0.0, 0.0, 1.0])
        sim.restore(state)
        rtc = OneProcess(sim)
        rtc.know_joints({ARM: sim.arms[ARM].joints})
    it = Operator(rtc)
    cuts: set[str] = set()
    for messages in (200, 75):  # it stands after 150; in the second grant the obstacle is near at the start
        rtc.give("GIVE RIGHT-ARM TO OPERATOR")
        it.wait("move")
        nearest_m = math.inf
        for _ in range(messages):
            it.drive(PERIOD / 1000, twist=[0.1, 0.0, -0.02, 0.0, 0.0, 0.0])
            nearest_m = min([nearest_m, *(one.distance_m for one in it.executor.arm.near(0.05))])
            assert it.executor.operated is not None
            cuts.add(it.executor.operated.look().cut.partition(":")[0])
        assert 0.0055 < nearest_m < 0.007  # 5 mm are declared; it comes to 6
        assert any(cut.startswith("kept away from SATELLITE") for cut in cuts), cuts
        it.drive(0.1, hold=False)
        assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
        rtc.run()
    if laden:
        return
    rtc.give("GIVE RIGHT-ARM TO OPERATOR")
    it.wait("move")
    before = it.executor.arm.tcp_pose(it.executor.sample.joints)
    it.drive(1.0, twist=[-0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    it.drive(0.1, hold=False)
    assert it.executor.arm.tcp_pose(it.executor.sample.joints)[0] < before[0] - 0.03
    assert it.say("DONE").kind is OutcomeKind.SUCCEEDED


@pytest.mark.physics
@pytest.mark.parametrize("number", [0, 3])
def test_in_physics_a_stick_held_through_two_grants_touches_nothing(number: int) -> None:
    """Some runs of the campaign, odd ones with a module in the hand."""
    grants = operator_near.one_run(number)
    assert operator_near.wrong(grants) == []
    assert min(grant.least_m for grant in grants) < 0.02  # something was near


@pytest.mark.parametrize("upwards", [False, True])
def test_an_arm_at_a_joint_limit_says_which(upwards: bool) -> None:
    rtc = OneProcess(KinematicCell(MODEL.cell))
    it = Operator(rtc)
    rtc.give("GIVE RIGHT-ARM TO OPERATOR")
    it.wait("move")
    for _ in range(1500):
        it.drive(PERIOD / 1000, twist=[0.0, 0.0, 0.0, 0.0, 0.0, 0.5 if upwards else -0.5], frame="tool")
        cut = it.executor.operated.look().cut
        if " limit of " in cut:
            break
    traits = it.executor.arm.traits
    limits = (traits.upper if it.executor.sample.joints[5] > 0.0 else traits.lower)[5]
    assert cut == f"joint_6 is at its limit of {math.degrees(limits):.3g} deg"


@pytest.mark.physics
def test_the_dialogue_about_a_stripped_bolt() -> None:
    """The scenario: a DONE from afar and a mistaken close are refused, the rest is accepted, and the bolt is loose."""
    physical = Physical(SERVICING.cell)
    try:
        bench = Bench(physical, SERVICING)
        stand_open(bench)
        for sentence in (
            "GRASP RIGHT-END-EFF POWER-DRIVER TOOL-GRIP",
            "APPROACH BOLT-2",
            "MOVE RIGHT-ARM BY 18 CM ALONG UP",
        ):
            assert bench.do(sentence).succeeded, sentence
        rtc = OneProcess(physical.sim, SERVICING, bench.world)
        it = Operator(rtc)
        command = rtc.give("LOOSEN BOLT-2 BY 2 TURNS WITH RIGHT-ARM VIA OPERATOR-INTERVENTION")
        it.wait("neighborhood of BOLT-2")
        far = it.say("DONE")
        assert far.kind is OutcomeKind.REFUSED
        assert "hand is not part" in it.send(hand="close")
        head = msgspec.msgpack.decode(rtc.state.commands[command].actions.bindings["HEAD"], type=m.Binding)
        goal = SERVICING.arms[ARM].fk(head.joints)
        ahead = geometry.rotate(goal, (0.0, 0.0, 1.0))
        it.go(geometry.translate(goal, -0.006 * ahead))
        assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
        it.wait("grasp point of BOLT-2")
        for _ in range(1000):
            if np.linalg.norm(it.executor.wrench[:3]) > 2.0:  # the head is felt
                break
            it.drive(PERIOD / 1000, twist=[*(0.002 * ahead), 0.0, 0.0, 0.0])
            assert it.executor.operated is not None, rtc.notes[-4:]
        it.drive(0.2, hold=False)
        assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
        it.wait("turn BOLT-2 counterclockwise")
        assert it.say("DONE").kind is OutcomeKind.REFUSED
        it.drive(3.0, turn=-1.0)  # it turns by what is asked, and no farther
        it.drive(0.2, hold=False)
        assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
        rtc.run()
        assert rtc.outcomes[command].kind is OutcomeKind.SUCCEEDED, rtc.outcomes[command]
        assert rtc.world.value("BOLT-2.turns") == pytest.approx(2.0, abs=0.1)
        assert physical.sim.bolts.out_turns("BOLT-2") == pytest.approx(2.0, abs=0.1)
        here = it.executor.arm.tcp_pose(it.executor.sample.joints)
        assert geometry.distance(here, goal) > 0.03  # the program has backed off from the head
    finally:
        physical.close()


def test_a_command_whose_trims_are_used_up_is_surrendered_and_goes_on_after_the_operator() -> None:
    """R81: the arm rests, the outcome asks the operator for the same, and what waits is held until it is done."""
    rtc = OneProcess(KinematicCell(MODEL.cell))
    it, command = Operator(rtc), rtc.give("MOVE RIGHT-ARM TO BAY-2-FRONT")
    after = rtc.give(f"MOVE RIGHT-ARM TO CLEAR-POINT-1 AFTER {command}")
    in_line = rtc.give("STOW RIGHT-ARM")
    while not it.executor.moving:
        rtc.tick()
    it.executor.halt(StopReason.FORCE_LIMIT, "pushed")
    while command not in rtc.outcomes:
        rtc.tick()
    refusal = rtc.outcomes[command].refusal
    assert refusal is not None
    assert refusal.by_operator == "MOVE RIGHT-ARM TO BAY-2-FRONT VIA OPERATOR-INTERVENTION"
    assert refusal.clears[-1].sentences == [refusal.by_operator]
    assert {rtc.state.commands[name].phase for name in (after, in_line)} == {m.Phase.HELD}
    rests = it.executor.sample.joints
    rtc.give(refusal.by_operator)
    it.wait("move RIGHT-ARM to BAY-2-FRONT")
    assert it.executor.sample.joints == pytest.approx(rests, abs=1e-6)  # nothing has moved it meanwhile
    it.go(MODEL.cell.place("BAY-2-FRONT").poses[ARM].pose)
    assert it.say("DONE").kind is OutcomeKind.SUCCEEDED
    rtc.run()
    kinds = {name: rtc.outcomes[name].kind for name in (after, in_line)}
    assert kinds == dict.fromkeys((after, in_line), OutcomeKind.SUCCEEDED)
