"""What the world is like for a motion, as believed."""

from __future__ import annotations

from rtc.messages import Limits
from workers.belief import Belief

KEPT = Limits(clearance_m=0.02)


def test_what_is_carried_keeps_its_distance_too_but_not_from_the_seat_it_leaves(bench):
    bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    assert Belief(bench.model, bench.world).scene("RIGHT-ARM", KEPT).near == ["RACK-1"]

    bench.do("LIFT MACS-NEW BY 20 CM")
    assert Belief(bench.model, bench.world).scene("RIGHT-ARM", KEPT).near == []


def test_what_is_to_be_touched_may_be_near(bench):
    scene = Belief(bench.model, bench.world).scene("RIGHT-ARM", KEPT, touching="MACS-NEW")
    assert scene.near == ["MACS-NEW", "RACK-1"]
