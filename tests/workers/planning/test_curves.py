"""Circles and search patterns: their shape, and the refusal of figures that shape nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtc.protocol import causes
from rtc.protocol.messages import CircleStep, PatternStep
from rtc.protocol.outcomes import RefusalReason
from rtc.spatial import geometry
from rtc.subsystems.motion.profiles import Follow
from tests.workers.refusals import refusal_of
from workers.planning.curves import circle, pattern
from workers.planning.motion.path import task_curve
from workers.planning.motion.timing import SpeedLimits, time_path


@pytest.fixture
def start(right, home):
    return right.fk(home["RIGHT-ARM"])


def curve(space, start, about, axis, figures):
    head = {"label": "", "to": "HERE", "stop": "move_free", "space": space}
    if space == "move_circle":
        return circle(CircleStep(about="HINGE", **head, **figures), start, about, axis)
    return pattern(PatternStep(**head, **figures), start, axis)


def hinge(start, x=0.0, y=0.25):
    return geometry.make_pose(start[:3] + np.array((x, y, 0.1)))


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_a_circle_keeps_its_radius_and_turns_the_hand_by_its_share(start, share) -> None:
    about = hinge(start)
    poses = curve("move_circle", start, about, "TOOL-Z", {"by_rad": 1.2, "hand_turn": share})

    assert np.linalg.norm(poses[:, :2] - about[:2], axis=1) == pytest.approx(0.25)
    assert poses[:, 2] == pytest.approx(start[2])
    assert geometry.angle(start, poses[-1]) == pytest.approx(1.2 * share, abs=1e-9)
    chord = 2 * 0.25 * math.sin(0.6)
    assert geometry.distance(start, poses[-1]) == pytest.approx(chord)


def test_a_circle_about_the_hand_is_a_screw(start) -> None:
    poses = curve("move_circle", start, start, "TOOL-Z", {"by_rad": -math.pi / 2, "by_m": 0.01})
    moved = geometry.relative(start, poses[-1])
    assert moved[:3] == pytest.approx([0.0, 0.0, 0.01])
    assert geometry.rotation_vector(geometry.IDENTITY, moved) == pytest.approx([0.0, 0.0, -math.pi / 2])


def test_the_hinge_axis_may_point_anywhere(start) -> None:
    about = geometry.compose(hinge(start), geometry.from_rpy((0, 0, 0), (math.pi / 2, 0, 0)))
    tilted = curve("move_circle", start, about, "TOOL-Z", {"by_rad": 0.5})
    along = geometry.rotate(about, (0.0, 0.0, 1.0))
    assert (tilted[:, :3] - about[:3]) @ along == pytest.approx((start[:3] - about[:3]) @ along)


@pytest.mark.parametrize("space", ["move_spiral", "move_raster"])
def test_a_pattern_leaves_nothing_within_its_radius_farther_than_a_pitch(start, space) -> None:
    radius, pitch = 0.010, 0.002
    poses = curve(space, start, start, "TOOL-Z", {"radius_m": radius, "pitch_m": pitch, "by_m": 0.004})
    flat = np.array([geometry.relative(start, pose)[:3] for pose in poses])
    assert flat[0] == pytest.approx([0.0, 0.0, 0.0])
    assert np.all(np.diff(flat[:, 2]) > 0.0)
    assert flat[-1, 2] == pytest.approx(0.004)
    assert all(geometry.angle(start, pose) < 1e-9 for pose in poses)
    angle, part = np.linspace(0, 2 * math.pi, 37), np.linspace(0, radius - pitch, 11)
    for x, y in np.stack((np.outer(part, np.cos(angle)), np.outer(part, np.sin(angle))), axis=2).reshape(-1, 2):
        assert np.linalg.norm(flat[:, :2] - (x, y), axis=1).min() < pitch


@pytest.mark.parametrize(
    ("space", "figures"),
    [
        ("move_circle", {"by_rad": 0.0}),
        ("move_circle", {"by_rad": math.nan}),
        ("move_circle", {"by_rad": 1.0, "hand_turn": 1.5}),
        ("move_circle", {"by_rad": 1e6}),
        ("move_spiral", {"radius_m": 0.01, "pitch_m": 0.0}),
        ("move_spiral", {"radius_m": 0.01, "pitch_m": 0.02}),
        ("move_spiral", {"radius_m": math.nan, "pitch_m": 0.002}),
        ("move_spiral", {"radius_m": 1.0, "pitch_m": 0.0001}),
        ("move_raster", {"radius_m": 1.0, "pitch_m": 0.0001}),
    ],
)
def test_a_curve_without_a_shape_is_refused(start, space, figures) -> None:
    assert isinstance(refusal_of(curve, space, start, start, "TOOL-Z", figures).cause, causes.BadCurve)


def test_an_unknown_axis_is_refused(start) -> None:
    assert refusal_of(curve, "move_circle", start, start, "TOOL-W", {"by_rad": 1.0}).reason is RefusalReason.NAME


def off_chords(corners, point) -> float:
    """Distance (m) of a point from the lines between these."""
    sides = np.diff(corners, axis=0)
    share = np.clip(((point - corners[:-1]) * sides).sum(axis=1) / (sides**2).sum(axis=1), 0.0, 1.0)
    return float(np.linalg.norm(corners[:-1] + share[:, None] * sides - point, axis=1).min())


@pytest.mark.parametrize(
    ("space", "axis", "figures", "off_m"),
    [
        ("move_circle", "Z", {"by_rad": 1.2, "hand_turn": 0.0}, 7e-5),
        ("move_spiral", "TOOL-Z", {"radius_m": 0.01, "pitch_m": 0.002}, 1e-4),
        ("move_raster", "TOOL-Z", {"radius_m": 0.01, "pitch_m": 0.002}, 1e-4),
    ],
)
def test_the_command_stays_on_the_curve_within_the_limits_of_the_arm(right, home, start, space, axis, figures, off_m):
    joints = home["RIGHT-ARM"]
    poses = curve(space, start, hinge(start), axis, figures)
    timed = time_path(right, task_curve(right, joints, poses), SpeedLimits(0.02, 1.0))
    command = Follow(timed.trajectory(), joints).path(np.linspace(0.0, timed.duration_s, 400))

    assert max(off_chords(poses[:, :3], right.fk(posture)[:3]) for posture in command[:, 0]) < off_m
    assert (np.abs(command[:, 1]) <= right.limits.velocity).all()
    assert (np.abs(command[:, 2]) <= right.limits.acceleration * 1.001).all()
    assert np.abs(command[-1, 1]).max() < 1e-9


def test_a_curve_out_of_reach_says_where_it_ends(right, home, start) -> None:
    far = curve("move_circle", start, hinge(start, x=0.5, y=0.0), "Z", {"by_rad": math.pi, "hand_turn": 0.0})
    refused = refusal_of(task_curve, right, home["RIGHT-ARM"], far)
    assert 0.0 < refused.fraction < 1.0
