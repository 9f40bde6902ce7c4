"""Views of the world: reading, deltas, overlays, and what a value may look like."""

from __future__ import annotations

import math

import pytest

from rtc.protocol.messages import Fact, Validity, View, WorldChange
from rtc.world.model import World, location, problem, selected


def fact(key, value, version=1, validity=Validity.VALID):
    return Fact(key=key, value=value, validity=validity, version=version, source="test", at_s=0.0)


WORLD = World(3, {f.key: f for f in (fact("A.seat", "BAY-1", 1), fact("A.mass", 2.0, 3), fact("B.seat", "", 2))})
POSE = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]


def test_reading_a_fact_and_its_absence():
    assert WORLD.value("A.seat") == "BAY-1"
    assert WORLD.get("C.seat") is None
    assert WORLD.value("C.seat", "nowhere") == "nowhere"


def test_a_delta_changes_only_what_it_brings():
    newer = WORLD.updated(View(request="1", version=4, facts=[fact("A.seat", "", 4)]))
    assert (newer.version, newer.value("A.seat"), newer.value("A.mass")) == (4, "", 2.0)
    assert WORLD.value("A.seat") == "BAY-1"


def test_an_empty_delta_of_the_same_version_costs_no_copy():
    assert WORLD.updated(View(request="1", version=3, facts=[])) is WORLD


def test_a_database_begun_anew_replaces_all():
    newer = WORLD.updated(View(request="1", version=1, facts=[fact("Z.seat", "")]))
    assert dict(newer.facts) == {"Z.seat": fact("Z.seat", "")}


def test_an_overlay_leaves_the_world_as_it_was():
    changes = [
        WorldChange(key="A.seat", value="BAY-2"),
        WorldChange(key="A.mass", keep_value=True, validity=Validity.SUSPECT),
    ]
    tried = WORLD.overlay(changes)
    assert (tried.value("A.seat"), tried.value("A.mass")) == ("BAY-2", 2.0)
    assert tried.get("A.mass").validity == Validity.SUSPECT
    assert (WORLD.value("A.seat"), WORLD.get("A.mass").validity) == ("BAY-1", Validity.VALID)


@pytest.mark.parametrize(
    ("keys", "since", "found"),
    [
        (None, 0, ["A.seat", "A.mass", "B.seat"]),
        (None, 1, ["A.mass", "B.seat"]),
        (["B.seat", "A.seat"], 0, ["B.seat", "A.seat"]),
        (["A"], 0, ["A.seat", "A.mass"]),  # a whole location
        (["A", "B.seat"], 2, ["A.mass"]),
        (["NO-ARM", "NO-ARM.x"], 0, []),
    ],
)
def test_which_facts_a_read_selects(keys, since, found):
    assert [f.key for f in selected(WORLD.facts, keys, since)] == found


def test_the_location_of_a_key():
    assert location("MACS-OLD.frame") == "MACS-OLD"


@pytest.mark.parametrize(
    "change",
    [
        WorldChange(key="A.frame", value=POSE),
        WorldChange(key="A.grasp", value=None),
        WorldChange(key="A.frame", value=None, validity=Validity.UNKNOWN),
        WorldChange(key="A.frame", keep_value=True, validity=Validity.SUSPECT),
        WorldChange(key="ARM.joints", value=[0.1] * 6),
        WorldChange(key="A.colour", value=["grey", 1, True, {"sheen": 0.5}]),
    ],
)
def test_sound_changes(change):
    assert problem(change) == ""


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (WorldChange(key="A.frame", value=[*POSE[:6], math.nan]), "7 finite numbers"),
        (WorldChange(key="A.frame", value=POSE[:6]), "7 finite numbers"),
        (WorldChange(key="A.frame", value=[*POSE[:6], 0.9]), "unit quaternion, its length is 0.9"),
        (WorldChange(key="A.frame", value=None), "7 finite numbers"),
        (WorldChange(key="A.grasp", value="BAY"), "7 finite numbers"),
        (WorldChange(key="ARM.joints", value=[0.0, "x"]), "list of finite numbers"),
        (WorldChange(key="ARM.joints", value=[0.0, math.inf]), "list of finite numbers"),
        (WorldChange(key="ARM.hand_width", value=-0.01), "not negative"),
        (WorldChange(key="A.mass", value=True), "not negative"),
        (WorldChange(key="A.seat", value=7), "a name or empty"),
        (WorldChange(key="A.colour", value=[b"bytes"]), "plain"),
        (WorldChange(key="A.colour", value=[[[[[[[[[[1]]]]]]]]]]), "plain"),
        (WorldChange(key="frame", value=POSE), "not a key"),
        (WorldChange(key=".frame", value=POSE), "not a key"),
    ],
)
def test_unsound_changes_are_named(change, complaint):
    assert complaint in problem(change)
