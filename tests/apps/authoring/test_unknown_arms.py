"""Arms that the project does not know do what sentences say, in physics under gravity, with their first cells alone."""

from __future__ import annotations

import pytest

from rtc.model.cells.cell import Cell
from rtc.protocol import causes
from rtc.protocol.outcomes import StopReason
from rtc.spatial import geometry
from tests.apps.authoring.own_arm import OwnArm
from tests.workers import conftest as workers

pytestmark = pytest.mark.physics


@pytest.fixture
def own(first_cell):
    benches = []

    def make(arm: str) -> OwnArm:
        benches.append(OwnArm(Cell.load(first_cell(arm))))
        return benches[-1]

    yield make
    for bench in benches:
        bench.subsystem.sim.close()


def test_sentences_grasp_and_place(own):
    """The iiwa with the hand and the wrist sensor that it gets. The Panda: the page `docs/own-arm.md`."""
    bench = own("IIWA")
    for sentence in ("GRASP CUBE WITH ARM IIWA", "LIFT CUBE BY 10 CM", "PLACE CUBE ON PAD-2"):
        run = bench.do(sentence)
        assert run.succeeded, (sentence, run.refusal, [made.message for made in run.assessments])
        for report in run.reports:
            assert report.peak_force_n < 25.0
    cube = bench.subsystem.sim.truth()["poses"]["CUBE"]
    assert geometry.distance(cube, bench.model.cell.seated_pose("PAD-2")) < 0.003


@pytest.fixture
def few(small_cell):
    """An arm with few joints: its hand gives way in few directions."""
    benches = []

    def make(kind: str) -> OwnArm:
        benches.append(OwnArm(small_cell(kind)))
        return benches[-1]

    yield make
    for bench in benches:
        bench.subsystem.sim.close()


def test_five_joints_close_on_two_sides_of_a_cube(few):
    """The hand of their first cell took it across the corners: it touched it 12 mm from its middle."""
    bench = few("FIVE")
    grasp = _done(bench, "GRASP CUBE WITH ARM UNIT")
    assert grasp.reports[-1].hand_width_m == pytest.approx(0.04, abs=0.001)  # it was 55.6 mm
    assert _most_felt_n(grasp) < 10.0
    _done(bench, "LIFT CUBE BY 5 CM")


def test_a_portal_grasps_lifts_and_places(few):
    """A finger at its stop felt 20.5 N, where 20 N is the limit. What it held turned by 5 degrees on the way."""
    bench = few("PORTAL")
    assert _most_felt_n(_done(bench, "GRASP CUBE WITH ARM UNIT")) < 10.0
    for sentence in ("LIFT CUBE BY 5 CM", "PLACE CUBE ON PAD-2"):
        _done(bench, sentence)
    cube, seated = bench.subsystem.sim.truth()["poses"]["CUBE"], bench.model.cell.seated_pose("PAD-2")
    assert geometry.distance(cube, seated) < 0.003
    assert geometry.angle(cube, seated) < 0.01


def _most_felt_n(grasp: workers.Run) -> float:
    """The greatest force in the touches of both sides."""
    touches = [report.peak_force_n for report in grasp.reports if report.reason is StopReason.CONTACT]
    assert len(touches) == 2
    return max(touches)


def _done(bench: OwnArm, sentence: str) -> workers.Run:
    run = bench.do(sentence)
    assert run.succeeded, (sentence, run.refusal, [made.message for made in run.assessments])
    return run


def test_what_is_refused_names_its_cause(own):
    bench = own("PANDA")
    far = bench.do("MOVE ARM PANDA TO POSITION 150 0 40 CM")
    assert far.refusal is not None
    assert isinstance(far.refusal.cause, causes.OutOfReach)
    assert bench.do("GRASP CUBE WITH RIGHT-ARM").refusal is not None


def test_joint_torques_show_a_contact_and_nothing_else(own):
    """Through a motion of all joints the estimate stays below 0.1 N; a guarded line ends at the pad."""
    bench = own("PANDA")
    assert bench.do("MOVE ARM PANDA TO FRONT").reports[-1].peak_force_n < 0.1
    frame = bench.model.cell.seat("PAD-2").frame.pose
    bench.set_fact("PAD-2.frame", geometry.translate(frame, (0.0, 0.0, -0.5)).tolist())  # believed elsewhere
    assert bench.do(f"MOVE ARM PANDA TO POSITION {100 * frame[0]:.1f} {100 * frame[1]:.1f} 8 CM").succeeded
    run = bench.do("MOVE ARM PANDA BY 3 CM ALONG DOWN UNLESS FORCE EXCEEDS 10 N THEN STOP")
    report = run.reports[-1]
    assert report.reason is StopReason.FORCE_LIMIT
    assert report.peak_force_n < 40.0
    assert report.trip_pose[2] == pytest.approx(0.05 + 0.015, abs=0.01)  # the finger tips on the block
