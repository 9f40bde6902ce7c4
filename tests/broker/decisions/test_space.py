"""Commands that wait until another arm leaves the space they need, and faults that concern both arms."""

from __future__ import annotations

import msgspec
import pytest

from broker.decisions.effects import DispatchJob
from broker.decisions.state import SPACES_KEPT
from rtc.protocol import wire
from rtc.protocol.messages import BinderInput, BoundStep, NoteKind, WorkerKind
from rtc.protocol.outcomes import RefusalReason, StopReason
from rtc.protocol.primitive import ControlLaw, Partner
from rtc.wording.notes import in_words
from tests.broker.harness import PATH, F, Harness, bound, give_up, go_on, script
from tests.simulation.invariants import violations

LEFT = ("LEFT-ARM",)


def right_moves(s: Harness, steps: int = 1) -> str:
    command = s.elaborated(script(steps=steps))
    s.answers(command, bound(f"{command}.1", moves=True))
    return command


def left_binds(s: Harness, steps: int = 1) -> str:
    return s.elaborated(script(steps=steps, resources=LEFT), hand="LEFT-ARM")


def moving_of(s: Harness, command: str) -> list[str]:
    """The motions of other arms in the input of the command's latest job."""
    job = next(e for e in reversed(s.log) if isinstance(e, DispatchJob) and e.job.startswith(f"{command}/"))
    return [primitive.id for primitive in wire.decoder(BinderInput)(job.input).moving]


def test_a_planner_knows_what_the_other_arm_does():
    s = Harness()
    right_moves(s)
    assert moving_of(s, left_binds(s)) == ["C-1.1"]


def test_a_binder_knows_whether_another_command_may_begin_to_move():
    s = Harness()
    right, left = s.elaborated(), left_binds(s)
    jobs = [e for e in s.log if isinstance(e, DispatchJob) and e.kind is WorkerKind.BINDER]
    assert {e.job.partition("/")[0]: wire.decoder(BinderInput)(e.input).others for e in jobs} == {
        right: False,
        left: True,
    }


def test_an_arm_that_stays_in_its_place_is_not_planned_around():
    s = Harness()
    s.executing()
    assert moving_of(s, left_binds(s)) == []


def test_a_motion_counts_until_the_world_has_its_result():
    s = Harness()
    right_moves(s)
    s.reports("C-1")
    assert moving_of(s, left_binds(s)) == ["C-1.1"]
    s.answers("C-1", go_on())
    s.answers("C-2", bound("C-2.1", "LEFT-ARM", moves=True))
    assert s.phase("C-2") == "executing"


def test_of_two_plans_made_at_once_the_later_one_is_made_again():
    s = Harness()
    left, right = left_binds(s), s.elaborated()
    s.answers(left, bound(f"{left}.1", "LEFT-ARM", moves=True))
    assert "primitive C-2.1 to MCM" not in s.answers(right, bound(f"{right}.1", moves=True))
    assert (s.phase(right), moving_of(s, right)) == ("binding", ["C-1.1"])
    assert "primitive C-2.1 to MCM" in s.answers(right, bound(f"{right}.1", moves=True))
    assert violations(s.state) == []


HERE, ASIDE, BETWEEN = [(0, 0, 0, 9, 9, 9)], [(20, 0, 0, 29, 9, 9)], [(40, 0, 0, 49, 9, 9), (9, 5, 9, 20, 6, 9)]


@pytest.mark.parametrize(
    ("mine", "theirs", "sent"),
    [(HERE, ASIDE, True), (HERE, BETWEEN, False), (HERE, HERE, False), (HERE, [], False), ([], ASIDE, False)],
)
def test_a_plan_whose_space_is_apart_from_motions_begun_meanwhile_is_not_made_again(mine, theirs, sent):
    s = Harness()
    left, right = left_binds(s), s.elaborated()
    s.answers(left, bound(f"{left}.1", "LEFT-ARM", moves=True, space=theirs))
    assert ("primitive C-2.1 to MCM" in s.answers(right, bound(f"{right}.1", moves=True, space=mine))) is sent
    assert violations(s.state) == []


def test_a_plan_is_made_again_if_more_motions_began_meanwhile_than_are_kept():
    s = Harness()
    right = s.elaborated()
    for _ in range(SPACES_KEPT + 1):
        left = left_binds(s)
        s.answers(left, bound(f"{left}.1", "LEFT-ARM", moves=True, space=ASIDE))
        s.reports(left)
        s.answers(left, go_on())
    assert f"primitive {right}.1 to MCM" not in s.answers(right, bound(f"{right}.1", moves=True, space=HERE))


def test_a_step_that_does_not_move_the_arm_is_not_planned_again():
    s = Harness()
    left, right = left_binds(s), s.elaborated()
    s.answers(left, bound(f"{left}.1", "LEFT-ARM", moves=True))
    assert "primitive C-2.1 to MCM" in s.answers(right, bound(f"{right}.1"))


def test_a_command_waits_for_the_space_of_an_arm_and_names_its_owner():
    s = Harness()
    right_moves(s)
    s.is_blocked(left_binds(s), "RIGHT-ARM")
    assert s.phase("C-2") == "waiting"
    waits = s.state.commands["C-2"].notes[-1]
    assert (waits.kind, waits.arm, waits.owner) == (NoteKind.SPACE, "RIGHT-ARM", "C-1")
    assert in_words(waits) == "waits for space of RIGHT-ARM, which C-1 moves: RIGHT-ARM is in the way"
    s.reports("C-1")
    assert "job C-2/4 binder #1" in s.answers("C-1", go_on())
    assert violations(s.state) == []


def test_a_command_that_waits_plans_again_when_that_arm_begins_to_move():
    s = Harness()
    right = s.elaborated()
    s.is_blocked(left_binds(s), "RIGHT-ARM")
    s.answers(right, bound(f"{right}.1", moves=True))
    assert (s.phase("C-2"), moving_of(s, "C-2")) == ("binding", ["C-1.1"])


def test_a_plan_that_is_blocked_before_the_script_is_made_waits_too():
    s = Harness()
    right_moves(s)
    left = s.parsed(hand="LEFT-ARM")
    s.is_blocked(left, "RIGHT-ARM")
    assert s.phase(left) == "waiting"
    s.reports("C-1")
    s.answers("C-1", go_on())
    assert s.phase(left) == "elaborating"


def test_a_refusal_that_is_out_of_date_is_planned_again_at_once():
    s = Harness()
    right_moves(s)
    left = left_binds(s)
    s.reports("C-1")
    s.answers("C-1", go_on())
    s.is_blocked(left, "RIGHT-ARM")
    assert s.phase(left) == "binding"


def test_an_arm_without_a_command_does_not_leave_by_itself():
    s = Harness()
    s.is_blocked(left_binds(s), "RIGHT-ARM")
    assert s.outcome("C-1").kind == "refused"


def test_two_commands_do_not_wait_for_each_other():
    s = Harness()
    left, right = left_binds(s), s.elaborated()
    s.is_blocked(left, "RIGHT-ARM")
    s.is_blocked(right, "LEFT-ARM")
    outcome = s.outcome(right)
    assert (outcome.kind, outcome.refusal.owner) == ("refused", left)
    assert s.phase(left) == "binding"  # the arm has no command now, so the planner has to see it as it is
    s.is_blocked(left, "RIGHT-ARM")
    assert s.outcome(left).kind == "refused"


def test_a_command_whose_owner_goes_into_a_line_is_planned_again():
    s = Harness()
    s.elaborated(script(resources=("MODULE",)), hand=None)
    left = left_binds(s)
    right = s.parsed()
    s.is_blocked(left, "RIGHT-ARM")
    assert s.phase(left) == "waiting"
    s.answers(right, script(resources=("RIGHT-ARM", "MODULE")))
    assert (s.phase(right), s.phase(left)) == ("held", "binding")


def test_now_does_not_wait_for_space():
    s = Harness()
    right_moves(s)
    left = s.parsed(hand="LEFT-ARM", now=True)
    s.is_blocked(left, "RIGHT-ARM")
    assert s.outcome(left).refusal.reason is RefusalReason.RESOURCE


def test_a_waiting_command_can_be_aborted():
    s = Harness()
    right_moves(s)
    s.is_blocked(left_binds(s), "RIGHT-ARM")
    s.parsed(kind="control", verb="ABORT", object="C-2")
    assert (s.outcome("C-2").kind, s.state.space_lines) == ("aborted", {})


def test_a_waiting_command_pauses_before_the_step_that_waits():
    s = Harness()
    right_moves(s)
    s.is_blocked(left_binds(s), "RIGHT-ARM")
    s.parsed(kind="control", verb="PAUSE", object="C-2")
    assert s.phase("C-2") == "paused"
    s.parsed(kind="control", verb="RESUME", object="C-2")
    assert s.phase("C-2") == "binding"
    assert s.state.commands["C-2"].step_words == "1 of 1: step 1"


def test_a_motion_that_was_not_started_waits_for_the_arm_that_did_not_leave():
    s = Harness()
    right_moves(s)
    s.answers(left_binds(s), bound("C-2.1", "LEFT-ARM", moves=True))
    s.reports("C-2", StopReason.BLOCKED, duration_s=0.0)
    assert (s.phase("C-2"), s.state.commands["C-2"].waits_for) == ("waiting", "RIGHT-ARM")
    s.reports("C-1")
    s.answers("C-1", go_on())
    assert "primitive C-2.2 to MCM" in s.answers("C-2", bound("C-2.2", "LEFT-ARM", moves=True))


def test_a_motion_that_was_stopped_on_its_way_is_analyzed_and_planned_again():
    s = Harness()
    right_moves(s)
    s.answers(left_binds(s), bound("C-2.1", "LEFT-ARM", moves=True))
    s.reports("C-1", StopReason.COLLISION)
    s.reports("C-2", StopReason.BLOCKED)
    assert s.phase("C-2") == "analyzing"  # the world has to know where it stands
    s.answers("C-1", give_up(StopReason.COLLISION))
    s.answers("C-2", give_up(StopReason.BLOCKED))
    assert (s.phase("C-2"), moving_of(s, "C-2")) == ("binding", [])
    assert "primitive C-2.2 to MCM" in s.answers("C-2", bound("C-2.2", "LEFT-ARM", moves=True))


def test_a_motion_that_was_stopped_on_its_way_waits_for_the_arm_that_is_still_on_its_own():
    s = Harness()
    right_moves(s)
    s.answers(left_binds(s), bound("C-2.1", "LEFT-ARM", moves=True))
    s.reports("C-2", StopReason.BLOCKED)
    s.answers("C-2", give_up(StopReason.BLOCKED))
    assert (s.phase("C-2"), s.state.commands["C-2"].waits_for) == ("waiting", "RIGHT-ARM")
    assert violations(s.state) == []
    s.reports("C-1")
    s.answers("C-1", go_on())
    assert s.phase("C-2") == "binding"


def test_a_contact_of_two_arms_ends_both_commands():
    s = Harness()
    right_moves(s)
    s.answers(left_binds(s, steps=2), bound("C-2.1", "LEFT-ARM", moves=True))
    assert "halt C-2 to MCM" in s.reports("C-1", StopReason.ARM_CONTACT)
    s.reports("C-2", StopReason.ARM_CONTACT)
    s.answers("C-1", give_up(StopReason.ARM_CONTACT))
    s.answers("C-2", give_up(StopReason.ARM_CONTACT))
    assert [(s.outcome(c).kind, s.outcome(c).stop) for c in ("C-1", "C-2")] == [("failed", "arm_contact")] * 2


def test_a_contact_of_two_arms_ends_a_command_between_two_steps():
    s = Harness()
    left = left_binds(s)
    right = s.elaborated()
    s.answers(right, bound(f"{right}.1", moves=True))
    s.reports(right, StopReason.ARM_CONTACT)
    assert (s.outcome(left).kind, s.outcome(left).stop) == ("failed", "arm_contact")


def test_a_fault_of_one_arm_leaves_the_other_command_alone():
    s = Harness()
    right_moves(s)
    s.answers(left_binds(s), bound("C-2.1", "LEFT-ARM", moves=True))
    s.reports("C-1", StopReason.COLLISION)
    assert s.phase("C-2") == "executing"


def of_two_arms(command: str) -> BoundStep:
    """One primitive that moves both arms."""
    made = bound(f"{command}.1", moves=True)
    assert made.primitive is not None
    part = Partner(performer="LEFT-ARM", trajectory=PATH, control_law=ControlLaw(), stop_functions=F)
    return msgspec.structs.replace(made, primitive=msgspec.structs.replace(made.primitive, partner=part))


def test_a_primitive_of_two_arms_needs_both_and_is_a_motion_of_both():
    s = Harness()
    command = s.elaborated(script(resources=("LEFT-ARM", "RIGHT-ARM")), hand="BOTH-ARMS")
    s.answers(command, of_two_arms(command))
    assert {arm: motion.primitive for arm, motion in s.state.motions.items()} == {
        "LEFT-ARM": "C-1.1",
        "RIGHT-ARM": "C-1.1",
    }
    assert violations(s.state) == []
    s.reports(command)
    s.answers(command, go_on())
    assert s.state.motions == {}


def test_a_primitive_of_two_arms_is_refused_if_one_is_not_claimed():
    s = Harness()
    command = s.elaborated()
    s.answers(command, of_two_arms(command))
    assert s.outcome(command).refusal.reason is RefusalReason.PROGRAM


def test_both_arms_of_a_primitive_stay_closed_until_rest_is_confirmed():
    s = Harness()
    command = s.elaborated(script(resources=("LEFT-ARM", "RIGHT-ARM")), hand="BOTH-ARMS")
    s.answers(command, of_two_arms(command))
    s.halts()
    s.rings(command)
    s.answers(command, go_on())
    assert set(s.state.resources.quarantine) == {"LEFT-ARM", "RIGHT-ARM"}
    assert set(s.state.motions) == {"LEFT-ARM", "RIGHT-ARM"}  # other arms keep away from the whole paths
    s.rests("stop-C-1")
    assert s.state.motions == {}
