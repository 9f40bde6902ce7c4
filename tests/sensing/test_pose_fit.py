"""Poses from corners of tags: computed pictures, with exact or noisy corners."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.model.cells.parts import Camera, Frame, Tag
from rtc.sensing import locate, optics, pose_fit
from rtc.sensing.detector import DetectedTag
from rtc.spatial import geometry

MODULE = "MACS-NEW"
TRUE = geometry.from_rpy((0.81, -0.79, 0.61), (0.02, -0.03, 0.1))
ABOVE = optics.view(Camera(name="ABOVE", xyz=(0.6, -1.2, 1.4), looks_at=(0.8, -0.8, 0.68)))
BESIDE = optics.view(Camera(name="BESIDE", xyz=(1.3, -0.9, 1.3), looks_at=(0.8, -0.8, 0.68)))


@pytest.fixture(scope="module")
def tags() -> dict[int, Tag]:
    return {tag.id: tag for tag in Cell.load("swapout").tags}


def seen(
    view: optics.CameraView, tags: list[Tag], pose: geometry.Array, noise_px: float = 0.0, seed: int = 0
) -> locate.Seen:
    """The tags as an ideal camera sees them."""
    matrix, random = geometry.to_matrix(pose), np.random.default_rng(seed)
    marks = []
    for tag in tags:
        pixels = view.pixels(locate.corners(tag) @ matrix[:3, :3].T + matrix[:3, 3])
        marks.append(DetectedTag(tag.id, pixels + noise_px * random.standard_normal(pixels.shape)))
    return locate.Seen(view, marks)


def errors(found: geometry.Array, true: geometry.Array) -> tuple[float, float]:
    """m, rad"""
    return geometry.distance(found, true), geometry.angle(found, true)


@pytest.mark.parametrize("ids", [(0,), (0, 3), (0, 1, 2, 3), (0, 1, 4)])
def test_exact_corners_give_the_exact_pose(tags, ids) -> None:
    chosen = [tags[n] for n in ids]
    found = locate.locate(tags.values(), [seen(ABOVE, chosen, TRUE)])[MODULE]
    assert errors(found.pose, TRUE) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert found.best.error_px < 1e-6
    assert sorted(sighting.tag for sighting in found.used) == list(ids)


def test_both_solutions_of_one_far_tag_are_kept() -> None:
    """Seen from afar, a tag tilted to one side looks like one tilted to the other: the true pose is one of them."""
    tag = Tag(id=0, body=MODULE, size_m=0.06, frame=Frame())
    view = optics.view(Camera(name="FAR", xyz=(0.0, 0.0, 1.5), looks_at=(0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0)))
    true = geometry.from_rpy((0.05, 0.02, 0.0), (math.radians(20.0), 0.0, 0.3))
    taken_wrong = 0
    for seed in range(20):
        found = locate.locate([tag], [seen(view, [tag], true, 0.3, seed)])[MODULE]
        assert found.second is not None
        assert found.ambiguous
        both = [geometry.from_matrix(one.matrix) for one in (found.best, found.second)]
        turned = [geometry.angle(pose, true) for pose in both]
        assert min(turned) < math.radians(10.0)
        taken_wrong += turned[0] > turned[1]
        # the covariance admits the true attitude, even where the first solution is the wrong one
        off = pose_fit._difference(found.best.matrix, geometry.to_matrix(true))
        assert off @ np.linalg.solve(found.covariance, off) < 40.0
    assert taken_wrong > 0  # else this test would not show what the second solution is for


def test_several_tags_of_a_body_rule_the_second_solution_out(tags) -> None:
    found = locate.locate(tags.values(), [seen(ABOVE, [tags[n] for n in range(4)], TRUE, 0.3)])[MODULE]
    assert not found.ambiguous
    assert errors(found.pose, TRUE) < (0.003, math.radians(1.0))


def test_two_cameras_measure_the_distance_better_than_one(tags) -> None:
    chosen = [tags[n] for n in range(4)]
    pictures = [seen(ABOVE, chosen, TRUE), seen(BESIDE, chosen, TRUE)]
    one, two = (locate.locate(tags.values(), pictures[:n])[MODULE] for n in (1, 2))
    worst_m = [math.sqrt(np.linalg.eigvalsh(found.covariance[:3, :3])[-1]) for found in (one, two)]
    assert worst_m[1] < 0.5 * worst_m[0]
    assert len(two.used) == 8


def test_the_covariance_is_that_of_the_errors(tags) -> None:
    """The mean of the squared error in units of the covariance is the number of its dimensions."""
    chosen = [tags[n] for n in range(4)]
    squares = []
    for seed in range(200):
        found = locate.locate(tags.values(), [seen(ABOVE, chosen, TRUE, pose_fit.NOISE_PX, seed)])[MODULE]
        off = pose_fit._difference(found.best.matrix, geometry.to_matrix(TRUE))
        squares.append(off @ np.linalg.solve(found.covariance, off))
    assert np.mean(squares) == pytest.approx(6.0, rel=0.25)


def test_a_tag_that_has_come_off_is_left_out(tags) -> None:
    good = seen(ABOVE, [tags[n] for n in range(3)], TRUE, 0.1)
    moved = DetectedTag(3, seen(ABOVE, [tags[3]], TRUE).marks[0].corners + np.array((12.0, -5.0)))
    found = locate.locate(tags.values(), [good._replace(marks=[*good.marks, moved])])[MODULE]
    assert [sighting.tag for sighting in found.used] == [0, 1, 2]
    assert errors(found.pose, TRUE) < (0.003, math.radians(1.0))


def test_a_tag_that_the_cell_does_not_know_gives_nothing(tags) -> None:
    assert locate.locate([tags[1]], [seen(ABOVE, [tags[0]], TRUE)]) == {}


def test_a_tag_is_visible_in_the_picture_and_from_the_front(tags) -> None:
    matrix = geometry.to_matrix(TRUE)

    def visible(tag: Tag, view: optics.CameraView) -> bool:
        corners = locate.corners(tag) @ matrix[:3, :3].T + matrix[:3, 3]
        return optics.visible(view, corners, matrix[:3, :3] @ geometry.to_matrix(tag.frame.pose)[:3, 2])

    away = optics.view(Camera(name="AWAY", xyz=(0.6, -1.2, 1.4), looks_at=(0.0, -2.0, 0.7)))
    assert visible(tags[0], ABOVE)
    assert not visible(tags[0], away)  # outside of the picture
    assert not visible(tags[4], BESIDE)  # from behind
