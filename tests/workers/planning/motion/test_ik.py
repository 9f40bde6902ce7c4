"""Choosing a branch: the nearest that passes, and the cause when none does."""

from __future__ import annotations

import numpy as np

from rtc.protocol import causes
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.spatial import geometry
from tests.workers.refusals import refusal_of
from workers.planning.motion.ik import choose


def level(x, y, z):
    return geometry.make_pose((x, y, z), geometry.LEVEL)


def refuse_elbow(side):
    """A test that takes only elbows above (or below) a straight arm."""
    no = Refusal(reason=RefusalReason.INFEASIBLE, message=f"elbow not {side}", cause=causes.BadCurve())
    return lambda joints: None if (joints[2] > -np.pi / 2) == (side == "up") else no


def test_the_nearest_branch_is_taken(right, home):
    target = level(0.65, -0.885, 0.6)
    assert np.allclose(choose(right, target, home["RIGHT-ARM"]).joints, right.ik(target, home["RIGHT-ARM"])[0])


def test_a_branch_that_fails_the_test_is_passed_over(right, home):
    target = level(0.65, -0.885, 0.6)
    nearest = choose(right, target, home["RIGHT-ARM"]).joints
    other = choose(right, target, home["RIGHT-ARM"], test=refuse_elbow("up")).joints
    assert nearest[2] < -np.pi / 2 < other[2]
    assert geometry.distance(right.fk(other), target) < 1e-9


def test_when_none_passes_the_nearest_tells_why(right, home):
    no = Refusal(reason=RefusalReason.INFEASIBLE, message="never", cause=causes.BadCurve())
    refusal = refusal_of(choose, right, level(0.65, -0.885, 0.6), home["RIGHT-ARM"], test=lambda _: no)
    assert (refusal.cause, refusal.effort) == (no.cause, causes.Effort(branches_tried=6))


def test_out_of_reach_is_reported_in_figures(right, home):
    refusal = refusal_of(choose, right, level(0.65, 0.885, 0.6), home["RIGHT-ARM"])
    assert isinstance(refusal.cause, causes.OutOfReach)
    assert refusal.cause.distance_m > 0.5
