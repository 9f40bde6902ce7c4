"""What a TEST expects cameras to see: tags that are before them, large enough, and not behind something."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.drawing.scene import SceneView
from rtc.protocol.messages import Limits
from rtc.sensing import absence, optics
from rtc.sensing.detector import TagDetector
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from rtc.world.model import World, initial_facts
from tests.workers.conftest import MODEL
from tests.workers.rehearsal.on_paper import SERVICING, OnPaper
from workers.planning import lines_of_sight, scenes, sight
from workers.planning.world_query import WorldQuery


def test_a_look_at_what_a_closed_door_hides_is_not_feasible() -> None:
    """It was: a tag counted as seen if it faced a camera."""
    paper = OnPaper(SERVICING)
    hidden = paper.test("LOCATE BAY-2").refusal
    assert hidden is not None
    assert "CAMERA-1: DOOR-2 panel is before it" in hidden.message  # wording: what hides it
    assert paper.test("LOCATE MACS-OLD").refusal is not None
    assert paper.test("SET DOOR-2 ANGLE 95 DEG").refusal is None
    assert paper.test("LOCATE MACS-OLD").refusal is None


def test_what_hides_a_body_is_taken_away_if_that_helps() -> None:
    """SET ... FRAME was advised, for a module behind a closed door. Behind the open one a lip still hides the bay."""
    paper = OnPaper(SERVICING)
    assert "DOOR-2" not in in_one_line(paper.test("LOCATE BAY-2").refusal.clears)
    hidden = paper.test("LOCATE MACS-OLD").refusal
    first = hidden.clears[0].sentences
    assert hidden.clears[0].again
    assert first[-1].startswith("OPEN DOOR-2")
    for sentence in (*first, "LOCATE MACS-OLD"):
        assert paper.test(sentence).refusal is None, sentence


def test_a_look_that_would_see_two_attitudes_is_not_feasible() -> None:
    """Two of its eight tags are not hidden, and they are nearly in one plane with the camera."""
    vague = OnPaper().test("LOCATE BAY-2").refusal
    assert vague is not None
    assert "two attitudes" in vague.message  # wording: why not


def test_an_arm_before_a_tag_hides_it() -> None:
    cell = MODEL.cell
    query = WorldQuery(MODEL, World().overlay(initial_facts(cell)))
    scene = scenes.scene_of(query, cell.arms[0].name, Limits(), unsure=False)
    joints = {arm.name: query.joints(arm.name) for arm in cell.arms}
    eye = cell.camera("CAMERA-4").pose[:3]
    places = [geometry.compose(query.pose(tag.body), tag.frame.pose)[:3] for tag in cell.tags if tag.id in (18, 20)]
    shown, hidden = MODEL.collision.hidden_by(joints, scene, np.asarray(eye), np.array(places))
    assert (shown, hidden) == ("", "LEFT-ARM forearm")


@pytest.mark.parametrize("camera", ["CAMERA-3", "CAMERA-4"])
def test_the_expected_tags_are_those_in_a_drawn_picture(camera: str) -> None:
    """Of the bay, its satellite and both modules; the left arm is before two tags of the satellite."""
    from sim_mcm.cameras.render import SceneRenderer

    cell = MODEL.cell
    query = WorldQuery(MODEL, World().overlay(initial_facts(cell)))
    scene = scenes.scene_of(query, cell.arms[0].name, Limits(), unsure=False)
    view = optics.view(cell.camera(camera))
    expected = {
        one.tag
        for body in sight.bodies(cell)
        for one in lines_of_sight.observations(query, scene, view, body, query.pose(body))[0]
    }
    drawn = SceneView(joints={arm.name: list(query.joints(arm.name)) for arm in cell.arms})
    studio = SceneRenderer(cell)
    studio.pose(drawn)
    found = {mark.tag for mark in TagDetector().find(studio.camera_picture(camera, drawn, seed=3))}
    studio.close()
    assert expected
    assert expected <= found
    px = {tag.id: absence.across_px(tag, query.pose(tag.body), view) or 0.0 for tag in cell.tags}
    assert {tag for tag in found if px[tag] > 20.0} <= expected
