"""Cameras in the Decision Unit: performers of a second subsystem that several commands use at once."""

from __future__ import annotations

from typing import Any

import pytest

from broker.decisions import effects as do
from broker.decisions import events
from broker.decisions.state import State
from rtc.protocol import wire
from rtc.protocol.messages import BoundStep, EndReport, EvaluationContext, LookStep
from rtc.protocol.outcomes import Sighting, StopReason
from rtc.protocol.primitive import GoalReached, Look, Primitive, StopFunction, TagGeometry, TimeAbove
from tests.broker.harness import CONTEXT, Harness, bound, brief, go_on, script
from tests.simulation.invariants import violations

CAMERA, EYES = "CAMERA-1", "S&P"
HERE = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
SEEN = Sighting(pose=HERE, covariance=[0.0] * 36, tags=[1], error_px=0.1, age_s=0.1)


def look(primitive: str) -> BoundStep:
    body = Primitive(
        id=primitive,
        performer=CAMERA,
        trajectory=Look(tags=[TagGeometry(id=1, size_m=0.1, pose=HERE)], believed=HERE),
        stop_functions=[
            StopFunction(reason=StopReason.FOUND, when=GoalReached()),
            StopFunction(reason=StopReason.TIMEOUT, when=TimeAbove(5.0)),
        ],
    )
    evaluation = EvaluationContext(context=CONTEXT, step=LookStep(stop="look", label="x"), body="MODULE")
    return BoundStep(subsystem=EYES, primitive=body, evaluation=evaluation, limit_s=5.0)


def report(primitive: str, reason: StopReason = StopReason.FOUND) -> EndReport:
    return EndReport(primitive=primitive, performer=CAMERA, reason=reason, at_s=0.0, duration_s=1.0, sighting=SEEN)


class Seeing(Harness):
    def __init__(self) -> None:
        super().__init__()
        self.eyes_hello()

    def eyes_hello(self, pid: int = 7) -> list[str]:
        return self.handle(
            events.SubsystemConnected, subsystem=EYES, pid=pid, performers=[CAMERA], queues=[CAMERA], at_rest=True
        )

    def handle(self, what: type[events.Event], /, **fields: Any) -> list[str]:
        done = super().handle(what, **fields)
        assert violations(self.state) == []
        return done

    def looking(self, **head: Any) -> str:
        """A command whose look is executed."""
        command = self.elaborated(script(resources=(CAMERA,), writes=("MODULE",)), hand=None, **head)
        self.answers(command, look(f"{command}.1"))
        return command

    def sees(self, command: str) -> list[str]:
        made = report(self.state.commands[command].primitive)
        return self.handle(events.PrimitiveEnded, subsystem=EYES, report=made)


@pytest.fixture
def seeing() -> Seeing:
    return Seeing()


def test_two_commands_use_a_camera_at_once_and_each_ends_by_its_own_report(seeing) -> None:
    first = seeing.looking()
    second = seeing.elaborated(script(resources=(CAMERA,), writes=("OTHER",)), hand=None)
    seeing.answers(second, look(f"{second}.1"))
    assert [seeing.phase(one) for one in (first, second)] == ["executing", "executing"]
    assert "ack C-2.1" in seeing.sees(second)
    seeing.answers(second, go_on(StopReason.FOUND))
    assert seeing.outcome(second).kind == "succeeded"
    assert seeing.phase(first) == "executing"


def test_two_commands_for_one_object_take_turns_all_the_same(seeing) -> None:
    seeing.looking()
    second = seeing.elaborated(script(resources=(CAMERA,), writes=("MODULE",)), hand=None)
    assert seeing.phase(second) == "held"


def test_a_look_of_a_camera_that_was_not_claimed_is_refused(seeing) -> None:
    command = seeing.elaborated(script(resources=("RIGHT-ARM",)))
    seeing.answers(command, look(f"{command}.1"))
    assert seeing.outcome(command).kind == "refused"


def test_a_shared_claim_is_not_enough_for_an_arm(seeing) -> None:
    plan = script(resources=(CAMERA,), writes=())
    command = seeing.elaborated(plan, hand=None, object="RIGHT-ARM")  # an object is claimed shared
    seeing.answers(command, bound(f"{command}.1"))
    assert seeing.outcome(command).kind == "refused"


def test_both_arms_are_arms(seeing) -> None:
    seeing.looking()
    command = seeing.parsed(hand="BOTH-ARMS")
    assert seeing.state.resources.held[command] == {"LEFT-ARM": True, "RIGHT-ARM": True}


@pytest.mark.parametrize("scope", ["ALL", CAMERA, "C-1"])
def test_a_halt_reaches_the_camera_and_its_command_ends_halted(seeing, scope) -> None:
    command = seeing.looking()
    done = seeing.handle(events.HaltCalled, client="ann", halt="h1", scope=scope)
    assert f"halt {scope} to {EYES}" in done
    made = report(f"{command}.1", StopReason.HALT)
    seeing.handle(events.PrimitiveEnded, subsystem=EYES, report=made)
    seeing.answers(command, go_on(StopReason.HALT))
    assert seeing.outcome(command).kind == "halted"


def test_a_sentence_halt_waits_for_arms_and_cameras(seeing) -> None:
    seeing.looking()
    halt = seeing.parsed(kind="control", verb="HALT")
    seeing.handle(events.HaltConfirmed, subsystem=EYES, halt=halt, at_rest=True)
    assert seeing.phase(halt) == "halting"
    seeing.handle(events.HaltConfirmed, subsystem="MCM", halt=halt, at_rest=True)
    assert seeing.outcome(halt).kind == "succeeded"


def test_the_loss_of_perception_ends_its_looks_and_nothing_else(seeing) -> None:
    command = seeing.looking()
    moving = seeing.executing()
    seeing.handle(events.SubsystemGone, subsystem=EYES, why="killed")
    seeing.answers(command, go_on(StopReason.SUBSYSTEM_LOST))  # the last analysis
    assert seeing.outcome(command).kind == "lost_subsystem"
    assert seeing.phase(moving) == "executing"
    late = seeing.elaborated(script(resources=(CAMERA,), writes=("OTHER",)), hand=None)
    assert seeing.phase(late) == "held"  # closed until the camera is known to be free

    seeing.eyes_hello(pid=8)
    seeing.answers(late, script(resources=(CAMERA,), writes=("OTHER",)))
    done = seeing.answers(late, look(f"{late}.1"))
    assert f"primitive {late}.1 to {EYES}" in done


def test_the_state_survives_a_restart(seeing) -> None:
    """A snapshot keeps which performers are queues."""
    seeing.looking()
    again = wire.decoder(State)(wire.encode(seeing.state))
    assert again.subsystems[EYES].queues == [CAMERA]
    seeing.state = again
    second = seeing.elaborated(script(resources=(CAMERA,), writes=("OTHER",)), hand=None)
    effects = [brief(one) for one in seeing.log if isinstance(one, do.DispatchJob)]
    assert seeing.phase(second) == "binding", effects
