"""What was predicted of a step, against its report; and the grip that is closed again before it fails."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rtc.protocol.outcomes import StopReason
from tests.workers.conftest import Bench, Reporter

GRASP, LIFT = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "LIFT MACS-NEW BY 10 CM WITH RIGHT-ARM"


class Weakening(Reporter):
    """Its right hand grips with `force_n` from the next motion of the arm on, until it is closed again."""

    force_n: float | None = None

    def perform(self, made: Any, bound: Any) -> Any:
        if bound.evaluation.step.space and self.force_n is not None:
            self.forces["RIGHT-ARM"], self.force_n = self.force_n, None
        return super().perform(made, bound)


def figures(judged: Any) -> dict[str, Any]:
    return {figure.name: figure for figure in judged.compared.figures}


@pytest.fixture
def stow(bench: Any) -> tuple[Any, Any, Any]:
    """(bench, bound step, its report) of a motion that ends as predicted."""
    script = bench.elaborate("STOW RIGHT-ARM")
    bound = bench.bind(script, script.steps[-1])
    return bench, bound, bench.subsystem.perform(bound.primitive, bound)


def judged_with(stow: tuple[Any, Any, Any], **changes: Any) -> Any:
    """The verdict on this report with `changes`."""
    bench, bound, report = stow
    return bench.analyze(bound, msgspec.structs.replace(report, **changes))


def test_a_step_as_predicted_has_no_drift(stow):
    judged = judged_with(stow)
    assert (judged.compared.verb, judged.compared.kind, judged.drift) == ("STOW", "move_free", "")
    found = figures(judged)
    assert set(found) == {"duration_s", "off_goal_m", "turned_rad", "force_n"}
    assert found["duration_s"].predicted == stow[1].evaluation.predicted_s


def test_a_slower_step_drifts_although_it_succeeds(stow):
    slower_s = 1.5 * stow[1].evaluation.predicted_s
    judged = judged_with(stow, duration_s=slower_s)
    assert judged.verdict == "continue"
    assert f"{slower_s:.2f} s" in judged.drift


def test_a_pause_is_no_drift(stow):
    paused = judged_with(stow, duration_s=stow[1].evaluation.predicted_s + 60.0, paused_s=60.0)
    assert paused.drift == ""


def test_a_force_near_the_limit_drifts_before_it_ends_the_step(stow):
    judged = judged_with(stow, peak_force_n=0.9 * stow[1].evaluation.force_n)
    assert judged.verdict == "continue"
    assert "near the limit" in judged.drift


def test_a_step_that_ended_otherwise_is_compared_without_figures(stow):
    judged = judged_with(stow, reason=StopReason.FORCE_LIMIT, measured=50.0, limit=45.0)
    assert judged.verdict == "abort"
    assert judged.compared.figures == []


def test_a_body_is_compared_with_where_it_was_believed_to_be(bench):
    bench.subsystem.displace("MACS-NEW", [0.003, 0.0, 0.0])
    run = bench.do("LOCATE MACS-NEW")
    found = figures(run.assessments[-1])["found_m"]
    assert found.measured == pytest.approx(0.003, abs=0.001)


def test_a_grip_that_weakens_is_closed_again_before_the_object_is_lost():
    bench = Bench(Weakening())
    assert bench.do(GRASP).succeeded
    bench.subsystem.force_n = 12.0  # F ends a step below 3 N
    run = bench.do(LIFT)
    assert run.succeeded
    assert run.labels[-1] == "close again on MACS-NEW"
    lifted = run.assessments[-2]
    assert (lifted.verdict, lifted.reason) == ("trim", StopReason.GOAL)
    assert figures(lifted)["hand_force_n"].drifts
    assert run.reports[-1].hand_force_n == pytest.approx(45.0)
    assert bench.world.value("RIGHT-ARM.hand_force") == pytest.approx(45.0)


def test_a_grip_that_weakens_while_the_object_is_carried_is_closed_again():
    bench = Bench(Weakening())
    assert bench.do(GRASP).succeeded
    assert bench.do("LIFT MACS-NEW BY 15 CM WITH RIGHT-ARM").succeeded
    bench.subsystem.force_n = 12.0
    run = bench.do("CARRY MACS-NEW TO CLEAR-POINT-1 WITH RIGHT-ARM MAINTAIN GRIP-FORCE 30 N")
    assert run.succeeded
    assert run.trims == [run.script.context.if_drifting]
    assert run.labels[-2:] == ["close again on MACS-NEW", "let MACS-NEW settle"]
    assert bench.world.value("RIGHT-ARM.hand_force") == pytest.approx(30.0)


def test_fingers_that_move_while_they_hold_are_closed_again():
    bench = Bench(Weakening())
    assert bench.do(GRASP).succeeded
    bench.subsystem.closes = [bench.subsystem.widths["RIGHT-ARM"]]
    script = bench.elaborate(LIFT)
    bound = bench.bind(script, script.steps[-1])
    report = bench.subsystem.perform(bound.primitive, bound)
    wider = msgspec.structs.replace(report, hand_width_m=report.hand_width_m + 0.002)
    judged = bench.analyze(bound, wider)
    assert (judged.verdict, judged.trim) == ("trim", script.context.if_drifting)
    assert bench.analyze(bound, wider, used=[judged.trim]).verdict == "continue"  # once for a step


def test_a_weaker_grip_that_no_script_corrects_is_shown_with_what_would():
    bench = Bench(Weakening())
    assert bench.do(GRASP).succeeded
    assert bench.do(LIFT).succeeded
    bench.subsystem.force_n = 12.0
    run = bench.do("MOVE RIGHT-ARM BY 5 CM ALONG UP")
    assert run.succeeded
    assert "VERIFY MACS-NEW AT RIGHT-ARM" in run.assessments[-1].drift
