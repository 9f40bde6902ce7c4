"""Commands that only cameras perform, and looks within others: pure, with exact corners of tags."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from rtc.drawing.scene import SceneView
from rtc.protocol import causes
from rtc.protocol.advice import sentences_of
from rtc.protocol.messages import Validity, WorldChange
from rtc.protocol.outcomes import RefusalReason, StopReason
from rtc.spatial import geometry
from rtc.subsystems.perception.look_task import Evaluated, Windows
from rtc.wording.advice import in_one_line
from rtc.world.spread import even
from tests.refusals import stated
from tests.workers.conftest import CELL
from tests.workers.eyes import NOTHING, Drawn, Ideal
from workers.planning.robot_models import CellModel

MODULE, OTHER = "MACS-NEW", "MACS-OLD"
GRASP = "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A"


def frame(bench, body: str):
    return bench.world.get(f"{body}.frame")


def test_locate_writes_the_pose_with_its_uncertainty_and_the_seat_that_moved_with_it(bench) -> None:
    bench.unsurveyed()
    bench.subsystem.displace(OTHER, [0.02, 0.0, 0.0])
    run = bench.do(f"LOCATE {OTHER}")
    assert run.succeeded
    assert run.script.resources == ["CAMERA-2", OTHER]  # the camera that sees it best
    fact = frame(bench, OTHER)
    assert fact.validity is Validity.VALID
    assert geometry.distance(fact.value, bench.subsystem.poses[OTHER]) < 1e-6
    assert all(0.0 < n < 0.003 for n in fact.spread[:3])
    assert all(0.0 < n < math.radians(1.0) for n in fact.spread[3:])
    assert bench.world.get("RACK-2.frame").value[0] == pytest.approx(fact.value[0])
    assert "20.0 mm" in run.assessments[0].found

    again = bench.elaborate("GRASP LEFT-END-EFF MACS-OLD HANDLE-B")
    assert again.context.script == "grasp-centering"  # no need to feel for it any more


@pytest.mark.parametrize("measured", [f"LOCATE {OTHER}", f"SET {OTHER} FRAME 80.2 79.2 60.1 CM 0 0 0 DEG"])
@pytest.mark.parametrize("offset_m", [0.003, 0.2], ids=["known better", "moved"])
def test_a_measured_object_moves_with_its_seat_only_if_the_seat_has_moved(bench, measured, offset_m) -> None:
    bench.unsurveyed()
    bench.subsystem.displace(OTHER, [0.002, -0.008, 0.001])
    assert bench.do(measured).succeeded
    before = frame(bench, OTHER).value
    fact = frame(bench, "RACK-2")
    seat = CELL.seat("RACK-2").frame.pose if fact is None else fact.value
    x, y, z = (100.0 * n for n in (seat[0] + offset_m, seat[1], seat[2]))
    assert bench.do(f"SET RACK-2 FRAME {x:.3f} {y:.3f} {z:.3f} CM").succeeded
    moved_m = geometry.distance(frame(bench, OTHER).value, before)
    assert moved_m == pytest.approx(offset_m if offset_m > 0.1 else 0.0, abs=1e-4)


class Drifting(Ideal):
    """A module moves along its handle while cameras look."""

    def __init__(self, speed_m_s: float) -> None:
        super().__init__(CELL)
        self._speed_m_s, self._begun_s = speed_m_s, self.now_s

    def picture(self, name: str, scene: SceneView, windows: Windows = NOTHING) -> Evaluated:
        pose = geometry.translate(scene.poses[MODULE], [0.0, 0.0, self._speed_m_s * (self.now_s - self._begun_s)])
        moved = msgspec.structs.replace(scene, poses={**scene.poses, MODULE: pose.tolist()})
        return super().picture(name, moved, windows)


def test_a_module_that_moves_is_not_grasped_and_its_pose_is_not_trusted(bench) -> None:
    bench.unsurveyed()
    bench.subsystem.eyes = Drifting(0.003)
    run = bench.do(GRASP)
    assert run.failure.reason is StopReason.OUT_OF_RANGE
    assert run.reports[-1].sighting.velocity[:3] == pytest.approx([0.0, 0.0, 0.003], abs=1e-4)
    assert f"TRACK {MODULE} FOR 10 S" in sentences_of(run.failure.clears)
    assert [made.performer for made in run.primitives] == ["CAMERA-1"]  # no arm has moved
    assert frame(bench, MODULE).validity is Validity.SUSPECT
    assert bench.do(f"LOCATE {MODULE}").failure.reason is StopReason.OUT_OF_RANGE
    assert frame(bench, MODULE).validity is Validity.SUSPECT

    bench.subsystem.eyes = Drifting(0.0)
    assert bench.do(GRASP).succeeded


def test_a_primitive_for_a_camera_has_tags_and_no_names(bench) -> None:
    run = bench.do(f"LOCATE {MODULE} VIA CAMERA-1")
    (made,) = run.primitives
    assert made.performer == "CAMERA-1"
    assert [tag.id for tag in made.trajectory.tags] == list(range(8))
    assert MODULE not in repr(made)


def test_all_cameras_that_see_a_body_at_rest_locate_it_together_unless_one_is_named(bench) -> None:
    run = bench.do("LOCATE SATELLITE")
    assert run.succeeded
    assert run.script.resources == ["CAMERA-3", "SATELLITE", "CAMERA-4"]
    (made,) = run.primitives
    assert made.performers == ["CAMERA-3", "CAMERA-4"]
    assert run.reports[0].sighting.cameras == ["CAMERA-3", "CAMERA-4"]
    evidence = bench.world.value("SATELLITE.sighting")
    assert (evidence["cameras"], evidence["tags"]) == (["CAMERA-3", "CAMERA-4"], [18, 19, 20, 21])
    for sentence in ("LOCATE SATELLITE VIA CAMERA-4", "TRACK SATELLITE FOR 1 SEC"):
        (made,) = bench.do(sentence).primitives
        assert len(made.performers) == 1


@pytest.mark.parametrize(
    ("sentence", "reason", "facts"),
    [
        ("LOCATE MACS-LOD", RefusalReason.NAME, {"what": "object or seat", "name": "MACS-LOD"}),
        ("LOCATE MACS-OLD VIA CAMERA-7", RefusalReason.NAME, {"what": "camera", "name": "CAMERA-7"}),
        ("LOCATE MACS-OLD REPORT FORCES", RefusalReason.NO_SCRIPT, {"where": "REPORT"}),
        ("VERIFY MACS-OLD AT RACK-9", RefusalReason.NAME, {"what": "seat", "name": "RACK-9"}),
        ("VERIFY MACS-OLD AT LEFT-ARM VIA CAMERA-2", RefusalReason.NO_SCRIPT, {"where": "performer"}),
        (
            "GRASP LEFT-END-EFF MACS-OLD VIA CAMERA-2",
            RefusalReason.NAME,
            {"what": "GRASP strategy", "name": "CAMERA-2"},
        ),
    ],
)
def test_what_no_camera_can_do_is_refused_before_it_begins(bench, sentence, reason, facts) -> None:
    run = bench.do(sentence)
    assert run.refusal.reason is reason
    assert stated(run.refusal, facts) == facts
    assert run.refusal.clears
    assert not run.primitives


def test_a_body_without_tags_is_refused_before_it_begins(bench) -> None:
    tags = [tag for tag in CELL.tags if tag.body != "BAY-2"]
    bench.model = CellModel(msgspec.structs.replace(CELL, tags=tags))
    run = bench.do("LOCATE BAY-2")
    assert run.refusal.reason is RefusalReason.INFEASIBLE
    assert run.refusal.cause == causes.NoTags(body="BAY-2")
    assert "SET BAY-2 FRAME" in in_one_line(run.refusal.clears)


def test_what_no_camera_sees_is_refused_unless_one_is_named(bench) -> None:
    bench.set_fact(f"{OTHER}.frame", [0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    run = bench.do(f"LOCATE {OTHER}")
    assert run.refusal.reason is RefusalReason.INFEASIBLE
    assert run.refusal.cause == causes.OutOfView(body=OTHER)
    assert bench.do(f"LOCATE {OTHER} VIA CAMERA-2").succeeded  # it is in its rack all the time


def test_a_body_that_is_hidden_is_not_found_and_its_facts_stay(bench) -> None:
    bench.subsystem.eyes.blind = True
    before = frame(bench, MODULE)
    run = bench.do(f"LOCATE {MODULE}")
    assert run.failure.reason is StopReason.NOT_SEEN
    assert frame(bench, MODULE) == before


def test_locate_of_a_seat_moves_what_is_in_it(bench) -> None:
    bench.set_fact("RACK-1.frame", geometry.translate(bench.subsystem.poses[MODULE], [0.03, 0.0, 0.0]).tolist())
    bench.set_fact(f"{MODULE}.frame", geometry.translate(bench.subsystem.poses[MODULE], [0.03, 0.0, 0.0]).tolist())
    assert bench.do("LOCATE RACK-1").succeeded
    for body in ("RACK-1", MODULE):
        assert geometry.distance(frame(bench, body).value, bench.subsystem.poses[MODULE]) < 1e-6


def test_verify_confirms_a_place_or_makes_the_pose_suspect(bench) -> None:
    assert bench.do(f"VERIFY {OTHER} AT RACK-2").succeeded

    bench.subsystem.displace(OTHER, [0.0, 0.02, 0.0])
    run = bench.do(f"VERIFY {OTHER} AT RACK-2 VIA CAMERA-2")
    assert run.failure.reason is StopReason.OUT_OF_RANGE
    assert geometry.distance(run.reports[-1].sighting.pose, frame(bench, OTHER).value) == pytest.approx(0.020, abs=1e-4)
    assert run.failure.clears[0].sentences[0] == f"LOCATE {OTHER}"
    assert frame(bench, OTHER).validity is Validity.SUSPECT

    assert bench.do(f"LOCATE {OTHER}").succeeded  # the seat has moved too, so it is in its place again
    assert bench.do(f"VERIFY {OTHER} AT RACK-2").succeeded


@pytest.mark.parametrize(("off_m", "confirmed"), [(0.010, True), (0.020, False)])
def test_verify_counts_by_how_much_the_place_of_the_seat_is_unsure(bench, off_m, confirmed) -> None:
    """The seat was seen by one tag, and is known to 10 mm; `within_m` of VERIFY is 5 mm."""
    place = geometry.translate(frame(bench, OTHER).value, [0.0, off_m, 0.0]).tolist()
    seat = WorldChange(key="RACK-2.frame", value=place, spread=even(0.010, 0.02))
    bench.world = bench.world.overlay([seat])
    assert bench.do(f"VERIFY {OTHER} AT RACK-2").succeeded is confirmed


def test_verify_at_another_place_leaves_a_pose_that_the_camera_confirms(bench) -> None:
    before = frame(bench, MODULE)
    run = bench.do(f"VERIFY {MODULE} AT BAY-2 VIA CAMERA-1")
    assert run.failure.reason is StopReason.OUT_OF_RANGE
    assert f"PLACE {MODULE} ON BAY-2" in sentences_of(run.failure.clears)
    assert frame(bench, MODULE) == before


@pytest.mark.parametrize("seat", ["BAY-2", "RACK-1"])
def test_what_verify_advises_of_an_object_in_no_hand_brings_it_to_its_place(bench, seat) -> None:
    """PLACE alone was advised, and refused: no hand held the object."""
    if seat == "RACK-1":
        bench.subsystem.displace(MODULE, [0.0, 0.008, 0.0])
    run = bench.do(f"VERIFY {MODULE} AT {seat} VIA CAMERA-1")
    assert run.failure.reason is StopReason.OUT_OF_RANGE
    (way,) = (one for one in run.failure.clears if f"PLACE {MODULE} ON {seat}" in one.sentences)
    before = [f"LOCATE {MODULE}"] if seat == "RACK-1" else []
    for sentence in (*before, *way.sentences):
        assert bench.do(sentence).succeeded, sentence


def test_track_follows_for_its_time_and_reports(bench) -> None:
    run = bench.do("TRACK SATELLITE FOR 2 SEC VIA CAMERA-3 REPORT POSE AND EVERY 0.1 SEC")
    assert run.succeeded
    (made,) = run.primitives
    assert (made.trajectory.duration_s, made.trajectory.every_s, made.reporting.every_s) == (2.0, 0.1, 0.1)
    assert run.reports[0].sighting.velocity == pytest.approx([0.0] * 6, abs=1e-9)
    assert frame(bench, "SATELLITE").validity is Validity.VALID


@pytest.mark.parametrize(("reported", "every_s"), [("", 0.1), ("0.5", 0.25), ("0.1", 0.1), ("60", 0.5)])
def test_a_followed_body_takes_two_pictures_for_each_report(bench, reported, every_s) -> None:
    asked = f" REPORT POSE AND EVERY {reported} SEC" if reported else ""
    (made,) = bench.do(f"TRACK SATELLITE FOR 1 SEC VIA CAMERA-3{asked}").primitives
    assert made.trajectory.every_s == every_s


def judged_with(bench, sentence: str, **sighting):
    """The assessment of the first step of a sentence whose sighting differs by these fields."""
    script = bench.elaborate(sentence)
    bound = bench.bind(script, script.steps[0])
    report = bench.subsystem.perform(bound.primitive, bound)
    seen = msgspec.structs.replace(report.sighting, **sighting)
    return bench.analyze(bound, msgspec.structs.replace(report, sighting=seen))


@pytest.mark.parametrize(
    ("sentence", "sighting", "words"),
    [
        (f"TRACK {MODULE} FOR 0.3 SEC", {"velocity": [0.0, 0.0, 0.01, 0.0, 0.0, 0.0]}, "it moves"),
        (f"TRACK {MODULE} FOR 0.3 SEC", {"age_s": 3.0}, "3.0 s ago"),
        (f"LOCATE {MODULE}", {"age_s": 3.0}, "3.0 s ago"),
    ],
)
def test_a_body_that_may_be_elsewhere_by_now_has_a_suspect_pose_and_the_outcome_states_it(
    bench, sentence, sighting, words
) -> None:
    judged = judged_with(bench, sentence, **sighting)
    (change,) = [one for one in judged.changes if one.key == f"{MODULE}.frame"]
    assert change.validity is Validity.SUSPECT
    assert "suspect" in judged.found
    assert words in judged.found
    assert words in judged.remark


def test_a_locate_of_a_body_that_goes_on_moving_fails_and_leaves_its_pose_suspect(bench) -> None:
    """It succeeded, and left the pose suspect: the next sentence failed."""
    judged = judged_with(bench, f"LOCATE {MODULE}", velocity=[0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
    assert (judged.verdict, judged.reason) == ("abort", StopReason.OUT_OF_RANGE)
    (change,) = [one for one in judged.changes if one.key == f"{MODULE}.frame"]
    assert change.validity is Validity.SUSPECT


def tilted(by_rad: float) -> dict[str, object]:
    """A sighting of BAY-2 that is tilted by this angle, and as uncertain."""
    x, y, z = CELL.seat("BAY-2").frame.pose[:3]
    pose = geometry.from_rpy((x, y, z), (0.0, by_rad, 0.0)).tolist()
    return {
        "ambiguous": True,
        "pose": pose,
        "covariance": np.diag([1e-4, 1e-4, 1e-4, 1e-6, 0.04, 1e-6]).ravel().tolist(),
    }


@pytest.mark.parametrize("sentence", ["LOCATE BAY-2 VIA CAMERA-3", "TRACK BAY-2 FOR 0.3 SEC VIA CAMERA-3"])
def test_a_look_that_allows_two_attitudes_keeps_a_pose_that_is_known_better(bench, sentence) -> None:
    judged = judged_with(bench, sentence, **tilted(0.6))
    assert "BAY-2.frame" not in [one.key for one in judged.changes]
    if sentence.startswith("LOCATE"):
        assert (judged.verdict, judged.reason) == ("abort", StopReason.NOT_SEEN)


def test_a_pose_may_be_known_better_although_it_is_known_worse_along_one_axis(bench) -> None:
    place, spread = CELL.seat("BAY-2").frame.pose.tolist(), [0.06, 0.001, 0.001, 0.01, 0.01, 0.01]
    bench.world = bench.world.overlay([WorldChange(key="BAY-2.frame", value=place, spread=spread)])
    judged = judged_with(bench, "LOCATE BAY-2 VIA CAMERA-3", **tilted(0.6))
    assert judged.reason is StopReason.NOT_SEEN


def test_a_look_that_allows_two_attitudes_counts_if_it_contradicts_what_is_known(bench) -> None:
    judged = judged_with(bench, "LOCATE BAY-2 VIA CAMERA-3", **tilted(1.5))
    assert "BAY-2.frame" in [one.key for one in judged.changes]


def test_a_look_that_allows_two_attitudes_counts_if_the_pose_is_not_trusted(bench) -> None:
    bench.set_fact("BAY-2.frame", CELL.seat("BAY-2").frame.pose.tolist(), Validity.SUSPECT)
    judged = judged_with(bench, "LOCATE BAY-2 VIA CAMERA-3", **tilted(0.6))
    assert judged.verdict == "continue"
    assert "BAY-2.frame" in [one.key for one in judged.changes]


def test_a_track_that_ends_before_any_picture_shows_the_body_is_a_failure(bench) -> None:
    """A short TRACK by a dark camera: its time is over before `unseen_s`."""
    script = bench.elaborate(f"TRACK {MODULE} FOR 0.3 SEC")
    bound = bench.bind(script, script.steps[0])
    report = bench.subsystem.perform(bound.primitive, bound)

    judged = bench.analyze(bound, msgspec.structs.replace(report, sighting=None, message="the picture is too dark"))

    assert report.reason is StopReason.GOAL
    assert (judged.verdict, judged.reason) == ("abort", StopReason.NOT_SEEN)
    assert judged.changes == []


# --- Figure 4 and doubtful facts ---------------------------------------------------------------------------


def test_the_trim_of_figure_4_finds_a_displaced_module(either) -> None:
    either.subsystem.displace(MODULE, [0.0, 0.020, 0.0])
    run = either.do(GRASP)
    assert run.succeeded
    assert run.trims == [1]
    assert "CAMERA-1" in run.script.resources
    assert geometry.distance(frame(either, MODULE).value, either.subsystem.poses[MODULE]) < 0.001


def test_a_camera_that_sees_nothing_leaves_the_repair_to_the_next_trim(bench) -> None:
    bench.subsystem.eyes.blind = True
    bench.subsystem.displace(MODULE, [0.0, 0.020, 0.0])
    run = bench.do(GRASP)
    assert run.succeeded
    assert run.trims[0] == 1


def test_a_doubtful_pose_is_sensed_before_the_step_that_needs_it(either) -> None:
    either.subsystem.displace(MODULE, [0.01, 0.015, 0.0])
    either.set_fact(f"{MODULE}.frame", either.world.value(f"{MODULE}.frame"), Validity.SUSPECT)
    run = either.do(GRASP)
    assert run.succeeded
    assert run.labels[0] == f"look for {MODULE} with CAMERA-1"
    assert not run.trims
    assert frame(either, MODULE).validity is Validity.VALID


def test_a_doubtful_pose_that_no_camera_sees_is_refused_as_before(bench) -> None:
    away = [*bench.world.value(f"{MODULE}.frame")[:2], 3.0, 0.0, 0.0, 0.0, 1.0]
    bench.set_fact(f"{MODULE}.frame", away, Validity.SUSPECT)
    run = bench.do(GRASP)
    assert run.refusal.reason is RefusalReason.SUSPECT
    assert "SET MACS-NEW FRAME" in in_one_line(run.refusal.clears)


def test_a_doubtful_pose_that_a_camera_does_not_find_stops_the_command_before_the_arm_moves(bench) -> None:
    bench.subsystem.eyes.blind = True
    bench.set_fact(f"{MODULE}.frame", bench.world.value(f"{MODULE}.frame"), Validity.SUSPECT)
    run = bench.do(GRASP)
    assert run.failure.reason is StopReason.NOT_SEEN
    assert [made.performer for made in run.primitives] == ["CAMERA-1"]


# --- a held object -----------------------------------------------------------------------------------------


@pytest.fixture
def holding(bench):
    assert bench.do(GRASP).succeeded
    return bench


def test_an_object_that_is_not_seen_in_its_hand_is_felt_for_and_not_looked_for_again(holding) -> None:
    holding.subsystem.eyes.blind = True
    advice = holding.do(f"LOCATE {MODULE}").failure.clears
    felt = f"VERIFY {MODULE} AT RIGHT-ARM"
    assert [(one.sentences, one.states) for one in advice] == [([felt], []), ([], [f"{MODULE}.frame"])]
    assert holding.do(felt).succeeded
    assert "VERIFY" not in in_one_line(holding.do(f"LOCATE {OTHER}").failure.clears)


def lifted(bench, slip=(0.0, 0.0, 0.004)):
    """Lifted, slipped in the hand, and in doubt."""
    assert bench.do(f"LIFT {MODULE} BY 15 CM").succeeded
    bench.subsystem.displace(MODULE, list(slip))
    bench.set_fact(f"{MODULE}.grasp", bench.world.value(f"{MODULE}.grasp"), Validity.SUSPECT)


def assert_in_rack(bench) -> None:
    """Truly in its slot; along the way out the simple arm of these tests goes as far as it is commanded."""
    seat = CELL.seat("RACK-1")
    place = geometry.compose(seat.frame.pose, seat.module_frame.pose)
    out = geometry.rotate(seat.frame.pose, seat.way_out)
    off = bench.subsystem.poses[MODULE][:3] - place[:3]
    assert abs(off @ out) < 0.01
    assert np.linalg.norm(off - (off @ out) * out) < 1e-4
    assert geometry.angle(bench.subsystem.poses[MODULE], place) < 1e-4


def test_a_doubtful_grasp_is_sensed_before_the_arm_moves(holding) -> None:
    lifted(holding)
    run = holding.do("MOVE RIGHT-ARM BY 5 CM ALONG UP")
    assert run.succeeded
    assert run.labels[0] == f"look for {MODULE} with CAMERA-1"
    true = geometry.relative(run_tcp(holding), holding.subsystem.poses[MODULE])
    grasp = holding.world.get(f"{MODULE}.grasp")
    assert grasp.validity is Validity.VALID
    assert geometry.distance(grasp.value, true) < 1e-6


def test_an_object_that_has_slipped_is_placed_as_it_lies_in_the_hand(holding) -> None:
    """The plan was made for the believed grasp; it is restated for the one that the camera has seen."""
    lifted(holding)
    run = holding.do(f"PLACE {MODULE} ON RACK-1")
    assert run.succeeded, run.failure
    assert run.labels[:2] == [f"look for {MODULE} with CAMERA-1", "restate the plan"]
    assert not run.trims
    assert_in_rack(holding)


def test_a_grasp_that_is_too_uncertain_is_sensed_first(holding) -> None:
    assert holding.do(f"LIFT {MODULE} BY 15 CM").succeeded
    wide = WorldChange(key=f"{MODULE}.grasp", keep_value=True, spread=even(0.02, 0.1))
    holding.world = holding.world.overlay([wide])
    run = holding.do(f"PLACE {MODULE} ON RACK-1")
    assert run.succeeded, run.failure
    assert run.labels[0] == f"look for {MODULE} with CAMERA-1"


def test_an_object_that_was_lost_stops_the_command_before_the_arm_moves(holding) -> None:
    lifted(holding, slip=(0.1, 0.0, 0.0))
    run = holding.do(f"PLACE {MODULE} ON RACK-1")
    assert run.failure.reason is StopReason.OBJECT_LOST
    assert [made.performer for made in run.primitives] == ["CAMERA-1"]
    assert in_one_line(run.failure.clears) == f"GRASP {MODULE}"
    assert holding.world.value("RIGHT-ARM.holding") == ""
    assert geometry.distance(frame(holding, MODULE).value, holding.subsystem.poses[MODULE]) < 1e-6


def test_a_look_that_is_halted_stays_halted_although_it_has_seen_the_object_elsewhere(holding) -> None:
    """It was judged a loss, and the reason of the halt was gone."""
    lifted(holding, slip=(0.1, 0.0, 0.0))
    script = holding.elaborate(f"PLACE {MODULE} ON RACK-1")
    bound = holding.bind(script, script.steps[0])
    seen = holding.subsystem.perform(bound.primitive, bound)
    assert seen.sighting is not None
    judged = holding.analyze(bound, msgspec.structs.replace(seen, reason=StopReason.HALT), closing=True)
    assert (judged.verdict, judged.reason) == ("abort", StopReason.HALT)
    assert ("RIGHT-ARM.holding", "") in [(change.key, change.value) for change in judged.changes]


def test_a_doubtful_seat_is_sensed_before_an_object_is_placed_in_it(holding) -> None:
    assert holding.do(f"LIFT {MODULE} BY 15 CM").succeeded
    rack = CELL.seat("RACK-1").frame.pose
    holding.set_fact("RACK-1.frame", geometry.translate(rack, [0.01, 0.005, 0.0]).tolist(), Validity.SUSPECT)
    run = holding.do(f"PLACE {MODULE} ON RACK-1")
    assert run.succeeded, run.failure
    assert run.labels[0] == "look for RACK-1 with CAMERA-1"
    assert frame(holding, "RACK-1").validity is Validity.VALID
    assert_in_rack(holding)


@pytest.mark.parametrize(
    ("fact", "cure"), [(f"{MODULE}.grasp", f"VERIFY {MODULE} AT RIGHT-ARM"), ("BAY-2.frame", "SET BAY-2 FRAME")]
)
def test_what_is_in_doubt_and_out_of_sight_is_refused_with_what_would_clear_it(bench, fact, cure) -> None:
    bench.without_cameras()
    assert bench.do(GRASP).succeeded
    assert bench.do(f"LIFT {MODULE} BY 15 CM").succeeded
    value = bench.world.value(fact) or CELL.seat("BAY-2").frame.pose.tolist()
    bench.set_fact(fact, value, Validity.SUSPECT)
    run = bench.do(f"PLACE {MODULE} ON BAY-2")
    assert run.refusal.reason is RefusalReason.SUSPECT
    assert run.refusal.where == fact
    assert cure in in_one_line(run.refusal.clears)
    assert not run.primitives


def test_a_camera_measures_how_a_held_object_lies_in_the_hand(holding) -> None:
    holding.subsystem.displace(MODULE, [0.0, 0.0, 0.006])  # it has slipped along its bar
    run = holding.do(f"LOCATE {MODULE}")
    assert run.succeeded
    assert "RIGHT-ARM" in run.script.resources  # the arm must not move meanwhile
    true = geometry.relative(run_tcp(holding), holding.subsystem.poses[MODULE])
    grasp = holding.world.get(f"{MODULE}.grasp")
    assert geometry.distance(grasp.value, true) < 1e-6
    assert max(grasp.spread[:3]) < 0.003


@pytest.mark.parametrize(("sentence", "trusted"), [(f"LOCATE {MODULE}", True), (f"TRACK {MODULE} FOR 0.3 SEC", False)])
def test_a_slow_look_at_a_held_object_is_trusted_because_its_hand_is_reserved(holding, sentence, trusted) -> None:
    assert "RIGHT-ARM" in holding.elaborate(sentence).resources
    judged = judged_with(holding, sentence, age_s=4.0)
    (grasp,) = [one for one in judged.changes if one.key == f"{MODULE}.grasp"]
    assert grasp.validity is (Validity.VALID if trusted else Validity.SUSPECT)
    assert ("suspect" in judged.found) is not trusted


def test_an_object_that_is_seen_far_from_the_hand_is_not_held(holding) -> None:
    holding.subsystem.displace(MODULE, [0.1, 0.0, 0.0])
    assert holding.do(f"LOCATE {MODULE} VIA CAMERA-1").succeeded
    assert holding.world.value("RIGHT-ARM.holding") == ""
    assert holding.world.value(f"{MODULE}.held_by") == ""


def run_tcp(bench):
    return bench.model.arms["RIGHT-ARM"].fk(bench.world.value("RIGHT-ARM.joints"))


@pytest.mark.physics
def test_each_drawn_picture_has_noise_of_its_own() -> None:
    """With one seed for all of them a body at rest has exactly the same pose in each, and a speed of zero."""
    eyes = Drawn(CELL)
    first, second = (eyes.picture("CAMERA-1", SceneView()) for _ in range(2))
    before, after = ({mark.tag: mark.corners for mark in one.marks} for one in (first, second))
    assert before.keys() & after.keys()
    assert all(not np.array_equal(before[tag], after[tag]) for tag in before.keys() & after.keys())
    assert not np.array_equal(np.asarray(first.image), np.asarray(second.image))
