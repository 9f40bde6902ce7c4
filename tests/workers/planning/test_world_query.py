"""What the world is like for a motion, as believed."""

from __future__ import annotations

import pytest

from rtc.protocol.messages import Limits
from workers.planning import scenes
from workers.planning.world_query import WorldQuery

GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"
KEPT = Limits(clearance_m=0.02)


def test_what_is_carried_keeps_its_distance_too_but_not_from_the_seat_it_leaves(bench):
    bench.do(GRASP)
    assert scenes.scene_of(WorldQuery(bench.model, bench.world), "RIGHT-ARM", KEPT).near == ["RACK-1"]

    bench.do("LIFT MACS-NEW BY 20 CM")
    assert scenes.scene_of(WorldQuery(bench.model, bench.world), "RIGHT-ARM", KEPT).near == []


def test_what_is_to_be_touched_may_be_near(bench):
    scene = scenes.scene_of(WorldQuery(bench.model, bench.world), "RIGHT-ARM", KEPT, touching="MACS-NEW")
    assert scene.near == ["MACS-NEW", "RACK-1"]


def test_a_module_is_lifted_the_way_that_leads_out_of_its_seat(bench):
    before = [0.93, 0.0, 0.70, 0.0, 0.0, 0.0, 1.0]
    bench.subsystem.poses["MACS-NEW"] = before
    assert bench.do("SET MACS-NEW FRAME 93 0 70 CM").succeeded
    assert bench.world.value("MACS-NEW.seat") == "BAY-2"
    assert bench.do(GRASP).succeeded

    assert bench.do("LIFT MACS-NEW BY 25 CM").succeeded

    moved = [b - a for a, b in zip(before, bench.world.value("MACS-NEW.frame")[:3], strict=False)]
    assert moved == pytest.approx([-0.25, 0.0, 0.0], abs=0.002)
    assert bench.world.value("MACS-NEW.seat") == ""
