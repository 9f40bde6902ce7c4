"""A camera as a performer, on pictures with exact corners: what it finds, when it gives up, what it refuses."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from rtc.drawing.scene import SceneView
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.protocol.outcomes import StopReason
from rtc.sensing import absence, rest
from rtc.spatial import geometry
from rtc.subsystems.base.subsystem import BROKER, REPEAT_S
from rtc.subsystems.perception.camera import MAX_LOOKS, CameraPerformer
from rtc.subsystems.perception.look_clock import LookClock
from rtc.subsystems.perception.look_task import SETTLES_S
from rtc.subsystems.perception.motion import RESTS_S
from rtc.subsystems.perception.subsystem import PerceptionSubsystem
from tests.workers.eyes import PERIOD_S, Ideal

MODULE, FACE = "MACS-NEW", "SATELLITE"
UNSEEN_S = 1.0


@pytest.fixture
def eyes(cell):
    return Ideal(cell)


@pytest.fixture
def look(cell):
    def build(body: str = MODULE, id: str = "C-1.1", camera: str = "CAMERA-1", **how: object) -> p.Primitive:
        every_s = how.pop("report_s", None)
        follows = "duration_s" in how
        goal = StopReason.GOAL if follows else StopReason.FOUND
        return p.Primitive(
            id=id,
            performer=camera,
            trajectory=p.Look(
                tags=[
                    p.TagGeometry(id=tag.id, size_m=tag.size_m, pose=tag.frame.pose.tolist())
                    for tag in cell.tags
                    if tag.body == body
                ],
                believed=cell.object_pose(body).tolist(),
                **how,  # type: ignore[arg-type]
            ),
            stop_functions=[
                p.StopFunction(reason=goal, when=p.GoalReached()),
                p.StopFunction(reason=StopReason.NOT_SEEN, when=p.UnseenAbove(UNSEEN_S)),
                p.StopFunction(reason=StopReason.TIMEOUT, when=p.TimeAbove(20.0)),
            ],
            reporting=p.Reporting(every_s=every_s),  # type: ignore[arg-type]
        )

    return build


def at(cell, body: str, by: list[float], yaw_deg: float = 0.0) -> tuple[SceneView, list[float]]:
    """A scene with this body displaced, and its true pose."""
    pose = geometry.compose(
        geometry.translate(cell.object_pose(body), by), geometry.from_rpy((0, 0, 0), (0, 0, math.radians(yaw_deg)))
    )
    return SceneView(poses={body: pose.tolist()}), pose.tolist()


def test_a_body_is_found_where_it_is_and_not_where_it_is_believed_to_be(cell, eyes, look) -> None:
    scene, true = at(cell, MODULE, [0.01, -0.02, 0.0], yaw_deg=5.0)
    report = eyes.perform(look(pictures=2, every_s=0.3), scene)
    assert report.reason is StopReason.FOUND
    assert report.joints == report.tcp_pose == []
    seen = report.sighting
    assert geometry.distance(seen.pose, true) < 1e-6
    assert geometry.angle(seen.pose, true) < 1e-6
    assert (seen.pictures, seen.ambiguous) == (2, False)
    assert seen.velocity == pytest.approx([0.0] * 6, abs=1e-6)
    assert {0, 1, 2, 3} <= set(seen.tags)
    assert 0.0 <= seen.age_s < 2 * PERIOD_S
    assert 0.0 < math.sqrt(seen.covariance[0]) < 0.002


def test_what_is_out_of_view_is_not_seen_and_the_report_states_why(cell, eyes, look) -> None:
    report = eyes.perform(look(body="MACS-OLD"), SceneView())
    assert report.reason is StopReason.NOT_SEEN
    assert report.message == absence.Cause.OUT_OF_VIEW  # wording: it is the value of the cause
    assert report.sighting is None
    assert report.measured >= UNSEEN_S


def test_a_camera_without_pictures_does_not_claim_that_it_sees_nothing(look) -> None:
    camera = CameraPerformer("CAMERA-1")
    camera.accept(look(), 10.0)
    camera.fail("its cable is out", 10.1)
    assert camera.tick(10.0 + 5 * UNSEEN_S) == []
    (report,) = camera.tick(31.0)
    assert report.reason is StopReason.TIMEOUT
    assert report.message == "its cable is out"  # wording: of its driver


def test_a_picture_from_before_the_look_is_not_used(cell, eyes, look) -> None:
    camera = CameraPerformer("CAMERA-1")
    camera.accept(look(), eyes.now_s + 1.0)
    camera.take(eyes.picture("CAMERA-1", SceneView()))
    assert camera.tick(eyes.now_s + 1.0) == []


def test_one_camera_serves_several_looks_in_turn_and_a_halt_ends_its_command_only(cell, eyes, look) -> None:
    camera = CameraPerformer("CAMERA-1")
    camera.accept(look(id="C-1.1", duration_s=60.0), eyes.now_s)
    camera.accept(look(id="C-2.1", duration_s=60.0), eyes.now_s)
    eyes.now_s += PERIOD_S
    camera.take(eyes.picture("CAMERA-1", SceneView()))
    camera.accept(look(id="C-3.1"), eyes.now_s)
    eyes.now_s += PERIOD_S
    camera.take(eyes.picture("CAMERA-1", SceneView()))
    (found,) = camera.tick(eyes.now_s)
    assert (found.primitive, found.reason) == ("C-3.1", StopReason.FOUND)

    assert camera.halt("C-1")
    (halted,) = camera.tick(eyes.now_s)
    assert (halted.primitive, halted.reason) == ("C-1.1", StopReason.HALT)
    assert halted.sighting is not None  # what it has seen until then
    assert camera.primitives == ["C-2.1"]
    assert not camera.halt("C-1")


def test_a_slowly_turning_body_is_followed_ten_times_a_second(cell, eyes, look) -> None:
    """A degree per second about the axis of the bay, and 2 mm/s to the left."""
    camera, rate, speed = CameraPerformer("CAMERA-3"), math.radians(1.0), 0.002
    camera.accept(look(FACE, camera="CAMERA-3", duration_s=3.0, report_s=0.1), eyes.now_s)
    begun_s, messages = eyes.now_s, []
    while not messages or not isinstance(messages[-1], m.EndReport):
        eyes.now_s += 0.02
        if eyes.now_s >= camera.due_s:
            after_s = eyes.now_s - begun_s
            turned = geometry.from_rpy((0, speed * after_s, 0), (rate * after_s, 0, 0))
            pose = geometry.make_pose(
                cell.object_pose(FACE)[:3] + turned[:3], geometry.compose(turned, cell.object_pose(FACE))[3:]
            )
            camera.take(eyes.picture("CAMERA-3", SceneView(poses={FACE: pose.tolist()})))
        messages += camera.tick(eyes.now_s)
    *progress, end = messages
    assert end.reason is StopReason.GOAL
    assert end.duration_s == pytest.approx(3.0, abs=0.05)
    assert len(progress) == pytest.approx(30, abs=2)
    assert end.sighting.velocity == pytest.approx([0, speed, 0, rate, 0, 0], abs=1e-4)
    turned = [geometry.angle(one.reading.sighting.pose, cell.object_pose(FACE)) for one in progress]
    assert np.all(np.diff(turned) > 0.0)


def test_a_look_for_a_body_at_rest_measures_that_it_moves(cell, eyes, look) -> None:
    camera, speed = CameraPerformer("CAMERA-1"), 0.003
    camera.accept(look(pictures=2, every_s=0.3), eyes.now_s)
    begun_s, messages = eyes.now_s, []
    while not messages:
        eyes.now_s += 0.02
        if camera.due_s is not None and eyes.now_s >= camera.due_s:
            scene, _ = at(cell, MODULE, [0.0, 0.0, speed * (eyes.now_s - begun_s)])
            camera.take(eyes.picture("CAMERA-1", scene))
        messages += camera.tick(eyes.now_s)
    (end,) = messages
    assert end.reason is StopReason.FOUND
    assert SETTLES_S + RESTS_S <= end.duration_s < SETTLES_S + RESTS_S + 2 * 0.3  # it had the time to come to rest
    assert end.sighting.velocity == pytest.approx([0.0, 0.0, speed, 0.0, 0.0, 0.0], abs=1e-5)


def drifts(speed_m_s: float, until_s: float):
    """The scene at a time of a look: the module moves from its start on, until it rests."""

    def scene(cell, now_s: float) -> tuple[SceneView, list[float]]:
        return at(cell, MODULE, [speed_m_s * min(now_s, until_s), 0.0, 0.0])

    return scene


def looked(cell, eyes, made: p.Primitive, scene) -> m.EndReport:
    """The end of a look at a body that moves."""
    camera, began_s = CameraPerformer("CAMERA-1"), eyes.now_s
    camera.accept(made, began_s)
    while True:
        if ended := [one for one in camera.tick(eyes.now_s) if isinstance(one, m.EndReport)]:
            return ended[0]
        eyes.now_s += PERIOD_S
        camera.take(eyes.picture("CAMERA-1", scene(cell, eyes.now_s - began_s)[0]))


@pytest.mark.parametrize("until_s", [0.25, 0.5, 1.0])
def test_a_look_waits_until_what_swings_rests(cell, eyes, look, until_s) -> None:
    """A look that began while a module swung in its hand stated at once that it moves."""
    scene = drifts(0.007, until_s)
    report = looked(cell, eyes, look(pictures=2, every_s=0.3), scene)
    assert report.reason is StopReason.FOUND
    assert not rest.moves(report.sighting.velocity)
    assert geometry.distance(report.sighting.pose, scene(cell, 9.0)[1]) < 1e-6  # no picture from before its rest counts
    assert report.duration_s < until_s + RESTS_S + 3 * 0.3


@pytest.mark.parametrize("rate", [0.1, 0.5, 3.0, 20.0])
def test_a_motion_is_measured_by_the_time_of_the_simulation(cell, eyes, look, rate) -> None:
    """A simulation is slower than its pictures on a busy machine, and faster with --speed max: a body that moves moves,
    and one that swings is waited for."""
    eyes.rate, speed = rate, 0.003

    def drifting(cell, now_s: float) -> tuple[SceneView, list[float]]:
        return at(cell, MODULE, [speed * rate * now_s, 0.0, 0.0])

    moving = looked(cell, eyes, look(pictures=2, every_s=0.3), drifting)
    assert moving.sighting.velocity[:3] == pytest.approx([speed, 0.0, 0.0], abs=1e-4)

    def swings(cell, now_s: float) -> tuple[SceneView, list[float]]:
        return drifts(0.007, 0.5)(cell, rate * now_s)

    report = looked(cell, eyes, look(pictures=2, every_s=0.3), swings)
    assert report.reason is StopReason.FOUND
    assert not rest.moves(report.sighting.velocity)
    assert geometry.distance(report.sighting.pose, swings(cell, 99.0)[1]) < 1e-6


@pytest.mark.parametrize("rate", [1.0, 3.0, 8.0, 12.0])
def test_rest_is_not_judged_by_a_picture_from_before_it(cell, eyes, look, rate) -> None:
    """The driver came to rest after the first of two pictures that a busy machine took 2.4 s of the simulation apart,
    and was reported to move."""
    eyes.rate = rate

    def swings(cell, now_s: float) -> tuple[SceneView, list[float]]:
        return drifts(0.02, rate * PERIOD_S + 0.8)(cell, rate * now_s)  # 0.8 s from the first picture on

    report = looked(cell, eyes, look(pictures=2, every_s=0.3), swings)
    assert report.reason is StopReason.FOUND
    assert not rest.moves(report.sighting.velocity)
    assert geometry.distance(report.sighting.pose, swings(cell, 99.0)[1]) < 1e-6


def test_two_pictures_of_one_moment_show_no_rest(cell, eyes, look) -> None:
    camera, eyes.rate = CameraPerformer("CAMERA-1"), 0.0
    camera.accept(look(pictures=2, every_s=0.3), eyes.now_s)
    for _ in range(10):
        eyes.now_s += 0.3
        camera.take(eyes.picture("CAMERA-1", SceneView()))
    assert camera.tick(eyes.now_s) == []


def test_a_body_is_followed_for_the_time_of_the_simulation(cell, eyes, look) -> None:
    camera, eyes.rate, begun_s = CameraPerformer("CAMERA-1"), 3.0, eyes.now_s
    camera.accept(look(duration_s=6.0), eyes.now_s)
    while not (reports := camera.tick(eyes.now_s)):
        eyes.now_s += PERIOD_S
        camera.take(eyes.picture("CAMERA-1", SceneView()))
    assert reports[0].reason is StopReason.GOAL
    assert eyes.now_s - begun_s == pytest.approx(2.0, abs=2 * PERIOD_S)


def test_pictures_that_take_long_end_no_look(cell, eyes, look) -> None:
    """On a busy machine each took half a minute: the look was over before its second one."""
    subsystem = PerceptionSubsystem([camera.name for camera in cell.cameras])
    subsystem.handle(m.Execute(primitive=look(pictures=2, every_s=0.3)), BROKER, eyes.now_s)
    for _ in range(2):
        camera = subsystem.next_camera(eyes.now_s)
        subsystem.clock.begin_picture(eyes.now_s)
        picture = eyes.picture(camera.name, SceneView())
        for _ in range(5):
            eyes.now_s += 8.0
            assert subsystem.tick(eyes.now_s) == []
        subsystem.clock.end_picture(eyes.now_s)
        camera.take(picture)
    reports = [one for _, one in subsystem.tick(eyes.now_s)]
    assert [one.reason for one in reports] == [StopReason.FOUND]


def test_a_camera_without_pictures_ends_its_look_in_time(cell, eyes, look) -> None:
    camera = CameraPerformer("CAMERA-1")
    camera.accept(look(), eyes.now_s)
    eyes.now_s += 10.0
    camera.fail("no picture", eyes.now_s)
    assert camera.tick(eyes.now_s) == []
    eyes.now_s += 10.1
    (report,) = camera.tick(eyes.now_s)
    assert report.reason is StopReason.TIMEOUT


def test_a_body_that_goes_out_of_sight_ends_the_following(cell, eyes, look) -> None:
    camera = CameraPerformer("CAMERA-1")
    camera.accept(look(duration_s=60.0), eyes.now_s)
    sent = []
    for n in range(40):
        eyes.now_s += PERIOD_S
        eyes.blind = n >= 10
        camera.take(eyes.picture("CAMERA-1", SceneView()))
        sent += camera.tick(eyes.now_s)
    (end,) = sent
    assert end.reason is StopReason.NOT_SEEN
    assert end.sighting.age_s >= UNSEEN_S


def test_a_further_picture_of_a_body_at_rest_is_of_its_tags_alone(cell, eyes, look) -> None:
    """By each camera that has seen them: another one, which is blind, goes on with whole pictures."""
    one, other = CameraPerformer("CAMERA-1"), CameraPerformer("CAMERA-2")
    one.accept(look(pictures=2, every_s=0.3, cameras=["CAMERA-2"]), eyes.now_s)
    one.share("C-1.1", other)
    one.take(eyes.picture("CAMERA-1", SceneView()))
    eyes.blind = True
    other.take(eyes.picture("CAMERA-2", SceneView()))
    eyes.now_s += 0.3
    assert one.windows(eyes.now_s)
    assert other.windows(eyes.now_s) == {}


def test_a_tag_that_the_whole_picture_alone_shows_moves_nothing(cell, eyes, look) -> None:
    """The first picture showed two narrow tags, which have no windows. Without them the body was somewhere else, as if
    it moved, and the look took two pictures more (run 4001 of the campaign `foretold`)."""
    camera, (scene, _) = CameraPerformer("CAMERA-1"), at(cell, MODULE, [0.014, -0.03, 0.013])
    camera.accept(look(pictures=2, every_s=0.3), eyes.now_s)
    whole = eyes.picture("CAMERA-1", scene)
    pixel = np.array((1.0, 0.0))
    off = [mark._replace(corners=mark.corners + pixel * (mark.tag in range(4, 8))) for mark in whole.marks]  # its side
    camera.take(whole._replace(marks=off))
    eyes.now_s += 0.3
    windows = camera.windows(eyes.now_s)
    camera.take(eyes.picture("CAMERA-1", scene, windows))
    assert windows.keys() == {0, 1, 2, 3}
    assert camera.due_s is None


def test_times_of_pictures_are_of_the_latest_ones(cell) -> None:
    clock = LookClock(scale=2.0)
    for took_s in (0.2, 0.6, 30.0, 0.8):
        clock.note("CAMERA-1", took_s)
    clock.note("CAMERA-1", 0.4, windows=4)
    clock.note("CAMERA-2", 0.4, windows=4)  # a picture as a whole is not known yet
    assert clock.pictures() == {"CAMERA-1": m.PictureTime(whole_s=0.4, window_s=0.05)}


def test_a_body_that_is_followed_is_looked_for_where_it_is_expected(cell, eyes, look) -> None:
    """Windows of a tenth of the picture; the whole picture again when it is not there, and for another look."""
    camera = CameraPerformer("CAMERA-3")
    camera.accept(look(FACE, camera="CAMERA-3", duration_s=60.0), eyes.now_s)
    assert camera.windows(eyes.now_s) == {}
    for n in range(5):
        scene, _ = at(cell, FACE, [0.0, 0.01 * n, 0.0])
        eyes.now_s += PERIOD_S
        camera.take(eyes.picture("CAMERA-3", scene))
    eyes.now_s += PERIOD_S
    parts = camera.windows(eyes.now_s)
    whole = eyes.picture("CAMERA-3", at(cell, FACE, [0.0, 0.05, 0.0])[0])  # it goes on
    assert {tag.id for tag in cell.tags if tag.body == FACE} == set(parts)
    assert sum(window.width * window.height for window in parts.values()) < 0.12 * 640 * 480
    for mark in (mark for mark in whole.marks if mark.tag in parts):
        x, y, width, height = parts[mark.tag]
        assert np.all(mark.corners >= (x, y))
        assert np.all(mark.corners <= (x + width, y + height))

    camera.take(whole._replace(image=None, marks=[]))
    assert camera.windows(eyes.now_s) == {}
    assert camera.due_s <= eyes.now_s  # at once
    camera.take(whole)
    assert camera.tick(eyes.now_s) == []
    eyes.now_s += PERIOD_S
    assert camera.windows(eyes.now_s)
    camera.accept(look("MACS-OLD", id="C-2.1", camera="CAMERA-3"), eyes.now_s)
    assert camera.windows(eyes.now_s) == {}


def refused(camera: CameraPerformer, made: p.Primitive) -> str:
    (answer,) = camera.accept(made, 0.0)
    assert answer.reason is StopReason.REFUSED
    assert camera.primitives == [] or len(camera.primitives) == MAX_LOOKS
    return answer.message


def test_what_a_camera_cannot_do_is_refused(look) -> None:
    camera, good = CameraPerformer("CAMERA-1"), look()
    complete = good.stop_functions

    def changed(**fields: object) -> p.Primitive:
        return p.Primitive(**{name: getattr(good, name) for name in good.__struct_fields__} | fields)

    assert "cannot execute a HoldStill" in refused(camera, changed(trajectory=p.HoldStill()))
    force = p.StopFunction(reason=StopReason.FORCE_LIMIT, when=p.ForceAbove(limit_n=5.0))
    assert "cannot watch ForceAbove" in refused(camera, changed(stop_functions=[*complete, force]))
    nowhere = p.Look(tags=good.trajectory.tags, believed=[math.nan] * 7)
    assert "not 7 finite numbers" in refused(camera, changed(trajectory=nowhere))
    for n in range(MAX_LOOKS):
        camera.accept(look(id=f"C-{n}.1"), 0.0)
    assert f"{MAX_LOOKS} looks already" in refused(camera, look(id="C-99.1"))


def test_an_arm_refuses_to_look(cell, make_arm, look) -> None:
    answers = make_arm.accept(look(camera="RIGHT-ARM"), 0.0)
    assert answers[0].reason is StopReason.REFUSED
    assert answers[0].sighting is None


@pytest.fixture
def make_arm(cell):
    from rtc.subsystems.motion.executor import Executor
    from sim_mcm.arms.kinematic_arm import KinematicCell

    return Executor(KinematicCell(cell).arms["RIGHT-ARM"])


# --- the subsystem ---------------------------------------------------------------------------------------


@pytest.fixture
def subsystem(cell):
    return PerceptionSubsystem([camera.name for camera in cell.cameras], pid=7)


def test_its_hello_states_that_cameras_are_queues(subsystem) -> None:
    ((_, hello),) = subsystem.hello()
    assert hello.name == "S&P"
    assert hello.queues == hello.performers == ["CAMERA-1", "CAMERA-2", "CAMERA-3", "CAMERA-4"]
    assert hello.at_rest


@pytest.mark.parametrize("scope", ["ALL", "CAMERA-1", "C-1"])
def test_a_halt_stops_a_look_and_its_report_precedes_the_confirmation(subsystem, look, scope) -> None:
    subsystem.handle(m.Execute(primitive=look(duration_s=60.0)), BROKER, 1.0)
    out = subsystem.handle(m.HaltOrder(halt="H-1", scope=scope), BROKER, 2.0) + subsystem.tick(2.001)
    report, started, rest = [message for _, message in out]
    assert (report.primitive, report.reason) == ("C-1.1", StopReason.HALT)
    assert started.moving == ["CAMERA-1"]
    assert rest.at_rest
    assert "CAMERA-1" in rest.performers
    assert subsystem.idle


def test_a_halt_of_another_command_leaves_a_look_alone(subsystem, look) -> None:
    subsystem.handle(m.Execute(primitive=look(duration_s=60.0)), BROKER, 1.0)
    out = subsystem.handle(m.HaltOrder(halt="H-1", scope="C-2"), BROKER, 2.0)
    assert [type(message) for _, message in out] == [m.HaltStarted, m.HaltAtRest]
    assert subsystem.outstanding == ["C-1.1"]


def test_its_end_report_is_repeated_until_it_is_acknowledged(subsystem, eyes, look) -> None:
    subsystem.handle(m.Execute(primitive=look()), BROKER, eyes.now_s)
    assert subsystem.next_camera(eyes.now_s).name == "CAMERA-1"
    eyes.now_s += PERIOD_S
    subsystem.performers["CAMERA-1"].take(eyes.picture("CAMERA-1", SceneView()))
    ((_, first),) = subsystem.tick(eyes.now_s)
    assert subsystem.next_camera(eyes.now_s) is None
    ((_, again),) = subsystem.tick(eyes.now_s + REPEAT_S)
    assert again == first
    subsystem.handle(m.ReportAck(primitive=first.primitive), BROKER, eyes.now_s)
    assert subsystem.tick(eyes.now_s + 5 * REPEAT_S) == []


# --- several cameras -------------------------------------------------------------------------------------

FLIP_RAD_S = 0.2
PAIR = {"camera": "CAMERA-3", "cameras": ["CAMERA-4"]}


def noisy(picture, random: np.random.Generator, pixels: float = 0.3):
    """The same picture with corners that are off by so much (standard deviation)."""
    moved = [mark._replace(corners=mark.corners + random.normal(0.0, pixels, (4, 2))) for mark in picture.marks]
    return picture._replace(marks=moved)


def located(cell, eyes, made: p.Primitive, scene: SceneView, random: np.random.Generator) -> m.EndReport:
    subsystem = PerceptionSubsystem([camera.name for camera in cell.cameras])
    subsystem.handle(m.Execute(primitive=made), BROKER, eyes.now_s)
    while True:
        for _, message in subsystem.tick(eyes.now_s):
            if isinstance(message, m.EndReport):
                return message
        eyes.now_s += PERIOD_S
        while (camera := subsystem.next_camera(eyes.now_s)) is not None:
            camera.take(noisy(eyes.picture(camera.name, scene), random))


def test_two_cameras_measure_the_distance_better_than_one(cell, eyes, look) -> None:
    """Along the optical axis of the first camera, and in all; the covariance states as much."""
    random, errors = np.random.default_rng(3), {1: [], 2: []}
    axis = np.array(cell.camera("CAMERA-3").looks_at) - cell.camera("CAMERA-3").pose[:3]
    axis /= np.linalg.norm(axis)
    stated = {}
    for n in range(25):
        scene, true = at(cell, FACE, random.uniform(-0.02, 0.02, 3).tolist())
        for count, cameras in ((1, {"camera": "CAMERA-3"}), (2, PAIR)):
            seen = located(cell, eyes, look(FACE, id=f"C-{n}.{count}", **cameras), scene, random).sighting
            errors[count].append((np.array(seen.pose) - true)[:3])
            covariance = np.array(seen.covariance).reshape(6, 6)[:3, :3]
            stated[count] = math.sqrt(axis @ covariance @ axis)
    along = {count: np.std(np.array(one) @ axis) for count, one in errors.items()}
    whole = {count: np.median(np.linalg.norm(one, axis=1)) for count, one in errors.items()}
    assert along[2] < 0.8 * along[1]
    assert whole[2] < 0.8 * whole[1]
    assert stated[2] < 0.8 * stated[1]


def test_a_pair_of_cameras_decides_which_way_a_single_tag_is_tilted(cell, eyes, look) -> None:
    random, wrong = np.random.default_rng(4), {1: 0, 2: 0}
    (tag,) = (p.TagGeometry(id=tag.id, size_m=0.03, pose=tag.frame.pose.tolist()) for tag in cell.tags if tag.id == 18)
    small = [one for one in cell.tags if one.id != 18] + [
        msgspec.structs.replace(one, size_m=0.03) for one in cell.tags if one.id == 18
    ]
    eyes.cell = msgspec.structs.replace(cell, tags=small)
    for n in range(12):
        for count, cameras in ((1, {"camera": "CAMERA-3"}), (2, PAIR)):
            made = look(FACE, id=f"C-{n}.{count}", **cameras)
            made = msgspec.structs.replace(made, trajectory=msgspec.structs.replace(made.trajectory, tags=[tag]))
            seen = located(cell, eyes, made, SceneView(), random).sighting
            wrong[count] += geometry.angle(seen.pose, cell.object_pose(FACE)) > math.radians(10.0)
    assert wrong[1] > 0
    assert wrong[2] == 0


def test_a_tag_that_may_be_tilted_either_way_does_not_move(cell, eyes, look) -> None:
    """A camera that sees one tag takes one solution or the other by its noise; a driver at rest "moved" at 8.7 mm/s."""
    random, fastest_rad_s = np.random.default_rng(4), 0.0
    eyes.cell = msgspec.structs.replace(
        cell, tags=[msgspec.structs.replace(one, size_m=0.03) if one.id == 18 else one for one in cell.tags]
    )
    tag = next(p.TagGeometry(id=tag.id, size_m=0.03, pose=tag.frame.pose.tolist()) for tag in cell.tags if tag.id == 18)
    for n in range(5):
        made = look(FACE, id=f"C-{n}.1", **PAIR, pictures=2)
        made = msgspec.structs.replace(made, trajectory=msgspec.structs.replace(made.trajectory, tags=[tag]))
        seen = located(cell, eyes, made, SceneView(), random).sighting
        fastest_rad_s = max(fastest_rad_s, math.hypot(*seen.velocity[3:]))
    assert fastest_rad_s < FLIP_RAD_S


def test_a_camera_that_does_not_see_the_body_is_left_out(cell, eyes, look) -> None:
    made = look(camera="CAMERA-1", cameras=["CAMERA-2"], pictures=2)
    report = located(cell, eyes, made, SceneView(), np.random.default_rng(1))
    assert report.reason is StopReason.FOUND
    assert report.sighting.cameras == []
    assert report.sighting.pictures >= 2
    assert report.duration_s >= UNSEEN_S
    assert report.message == f"CAMERA-2: {absence.Cause.OUT_OF_VIEW}"  # wording: the cause of each camera

    both = located(cell, eyes, look(FACE, id="C-2.1", **PAIR, pictures=2), SceneView(), np.random.default_rng(1))
    assert both.sighting.cameras == ["CAMERA-3", "CAMERA-4"]
    assert both.sighting.pictures >= 4


def test_what_no_camera_of_several_sees_is_not_seen(cell, eyes, look) -> None:
    made = look(camera="CAMERA-1", cameras=["CAMERA-2"])
    scene, _ = at(cell, MODULE, [0.0, 0.0, 2.0])
    report = located(cell, eyes, made, scene, np.random.default_rng(1))
    assert report.reason is StopReason.NOT_SEEN
    why = [f"CAMERA-1: {absence.Cause.OCCLUDED}", f"CAMERA-2: {absence.Cause.OUT_OF_VIEW}"]
    assert all(one in report.message for one in why)  # wording: the cause of each camera


@pytest.mark.parametrize("scope", ["CAMERA-4", "C-1"])
def test_a_halt_of_one_of_several_cameras_stops_their_look(subsystem, look, scope) -> None:
    subsystem.handle(m.Execute(primitive=look(FACE, **PAIR)), BROKER, 1.0)
    assert subsystem.outstanding == ["C-1.1"]
    out = subsystem.handle(m.HaltOrder(halt="H-1", scope=scope), BROKER, 2.0) + subsystem.tick(2.001)
    report, started, rest = [message for _, message in out]
    assert (report.performer, report.reason) == ("CAMERA-3", StopReason.HALT)
    assert "CAMERA-4" in started.moving
    assert rest.at_rest
    assert subsystem.idle


@pytest.mark.parametrize(
    ("how", "words"), [({"cameras": ["CAMERA-9"]}, "no CAMERA-9"), (PAIR | {"duration_s": 5.0}, "only one camera")]
)
def test_what_several_cameras_cannot_do_is_refused(subsystem, look, how, words) -> None:
    ((_, report),) = subsystem.handle(m.Execute(primitive=look(FACE, **how)), BROKER, 1.0)
    assert report.reason is StopReason.REFUSED
    assert words in report.message  # wording: of a report, which has no cause
    assert subsystem.idle
