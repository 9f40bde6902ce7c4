"""Reported facts of objects without a touch: implausible ones are refused, others accepted with their consequences."""

from __future__ import annotations

import math

import pytest

from rtc.protocol.causes import NeedUnmet
from rtc.protocol.outcomes import RefusalReason
from rtc.spatial import geometry
from rtc.wording.advice import in_one_line
from tests.workers.refusals import refusal_of
from workers.analyzer.reported_facts import changes_from
from workers.planning.world_query import WorldQuery
from workers.tasks.seated import seat_at

VALUES = {
    "reach_m": 5.0,
    "seated_m": 0.05,
    "seated_rad": 0.2,
    "in_hand_m": 0.06,
    "stated_m": 0.005,
    "stated_rad": 0.035,
}
UPRIGHT = [0.0, 0.0, 0.0, 1.0]
BODY = ("SATELLITE", "BAY-2")


@pytest.fixture
def query(bench) -> WorldQuery:
    return WorldQuery(bench.model, bench.world)


@pytest.mark.parametrize(
    "facts",
    [
        {"MACS-NEW.mass": 0.0},
        {"MACS-NEW.mass": -2.0},
        {"MACS-NEW.mass": math.nan},
        {"MACS-NEW.mass": 1001.0},  # no load of a hand can be so
        {"MACS-NEW.frame": [3.0, 3.0, 3.0, *UPRIGHT]},
        {"MACS-NEW.frame": [math.inf, 0.0, 0.0, *UPRIGHT]},
        {"MACS-NEW.frame": [0.8, 0.0, 0.6]},
        {"MACS-NEW.friction": math.inf},
        {"MACS-NEW.mass": 2.0, "MACS-OLD.mass": 0.0},  # one of several: nothing is believed
    ],
)
def test_what_cannot_be_is_refused(query, facts):
    refusal = refusal_of(changes_from, facts, query, VALUES)

    assert refusal.reason is RefusalReason.INFEASIBLE
    assert refusal.where in facts


def test_what_no_hand_can_hold_may_weigh_tons(query):
    changes = changes_from({"SATELLITE.mass": 20_000.0}, query, VALUES)

    assert [(change.key, change.value) for change in changes] == [("SATELLITE.mass", 20_000.0)]


def test_two_things_are_not_in_one_seat(query):
    refusal = refusal_of(changes_from, {"MACS-NEW.frame": [0.8, 0.8, 0.6, *UPRIGHT]}, query, VALUES)

    assert refusal.cause == NeedUnmet(need="seat_free", by="MACS-OLD")


def test_a_frame_brings_its_seat_and_an_end_of_any_grasp(query):
    changes = changes_from({"MACS-NEW.frame": [0.5, 0.0, 0.5, *UPRIGHT]}, query, VALUES)

    assert [(c.key, c.value) for c in changes] == [
        ("MACS-NEW.frame", [0.5, 0.0, 0.5, *UPRIGHT]),
        ("MACS-NEW.seat", ""),
        ("MACS-NEW.grasp", None),
    ]


def test_what_is_seen_in_a_hand_tells_how_the_hand_holds_it(bench):
    bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")
    before = geometry.normalise(bench.world.value("MACS-NEW.grasp"))

    changes = changes_from(
        {"MACS-NEW.frame": [0.81, -0.8, 0.6, *UPRIGHT]}, WorldQuery(bench.model, bench.world), VALUES
    )

    changed = {c.key: c.value for c in changes}
    assert changed["MACS-NEW.held_by"] == "RIGHT-ARM"
    assert "MACS-NEW.seat" not in changed
    assert geometry.distance(changed["MACS-NEW.grasp"], before) == pytest.approx(0.01, abs=1e-6)


def test_what_is_held_is_not_reported_to_be_far_from_the_hand(bench):
    bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A")

    refusal = refusal_of(
        changes_from, {"MACS-NEW.frame": [0.5, 0.0, 0.5, *UPRIGHT]}, WorldQuery(bench.model, bench.world), VALUES
    )

    assert refusal.cause == NeedUnmet(need="object_free", by="RIGHT-ARM")
    assert "open the hand" in in_one_line(refusal.clears)


def test_what_sits_in_a_seat_goes_with_it(query):
    turned = geometry.from_rpy([0.79, -0.81, 0.6], [0.0, 0.0, 0.1])

    changes = {c.key: c.value for c in changes_from({"RACK-1.frame": turned.tolist()}, query, VALUES)}

    assert changes["RACK-1.frame"] == pytest.approx(turned.tolist())
    assert changes["MACS-NEW.frame"] == pytest.approx(turned.tolist())
    assert "MACS-OLD.frame" not in changes


def test_what_is_turned_in_a_seat_does_not_sit_in_it(query):
    askew = geometry.from_rpy([0.80, -0.80, 0.60], [0.0, 0.0, math.pi]).tolist()

    changes = {c.key: c.value for c in changes_from({"MACS-NEW.frame": askew}, query, VALUES)}

    assert changes["MACS-NEW.seat"] == ""


@pytest.mark.parametrize(("x_m", "seat"), [(0.80, "RACK-1"), (0.76, "RACK-1"), (0.74, "")])
def test_the_nearest_seat_if_it_is_near_enough(query, x_m, seat):
    assert seat_at([x_m, -0.8, 0.6, *UPRIGHT], query, 0.05) == seat


def test_facts_that_are_not_reported_change_nothing(query):
    assert changes_from({}, query, VALUES) == []


def in_seat(query, seat):
    return query.seated_pose(seat).tolist()


def free_beside(query, seat, off_m):
    """MACS-NEW in no seat, so far (m, along x) from a seat that holds another object."""
    place = geometry.compose([off_m, 0.0, 0.0, *UPRIGHT], query.seat_frame(seat))
    return {"MACS-NEW.frame": {"value": place.tolist()}, "MACS-NEW.seat": {"value": ""}}


OF_ANOTHER_KIND = {
    "RACK-1.seat": "RACK-1",
    "RACK-1.mass": 5.0,
    "MACS-NEW.joints": [1.0],
    "MACS-NEW.holding": "MACS-OLD",
    "MACS-NEW.angle": 1.0,
    "MACS-NEW.turns": 3.0,
    "MACS-NEW.a b\n": 1.0,
}
TAUGHT, STANDING = "P1.posture_of_right_arm", [0.0, 1.9, -2.7, 0.0, 0.8, 0.0]
NO_PLACES = [
    *(f"{place}.posture_of_right_arm" for place in ("MM", "C-1", "LAST", "RACK-1", "CLEAR-POINT-1", "p1", "P 1")),
    *("P1.posture_of_middle_arm", "P1.posture_of_RIGHT-ARM", "MACS-NEW.posture_of_right_arm"),
]


@pytest.mark.parametrize(
    ("make", "where"),
    [
        (lambda q: {"MACS-NEW.seat": {"value": "NOWHERE"}}, "MACS-NEW.seat"),
        (lambda q: {"MACS-NEW.frame": {"value": [0.5, 0.0, 0.5, *UPRIGHT], "spread": [1e308] * 6}}, "MACS-NEW.frame"),
        (lambda q: {"MACS-NEW.frame": {"value": [0.5, 0.0, 0.5, *UPRIGHT], "spread": [9.0] * 6}}, "MACS-NEW.frame"),
        (lambda q: {"MACS-NEW.frame": {"value": [0.5, 0.0, 0.5, *UPRIGHT], "spread": [0.0] * 6}}, "MACS-NEW.frame"),
        (lambda q: {"MACS-NEW.seat": {"value": q.seat("MACS-OLD")}}, "MACS-NEW.seat"),
        (
            lambda q: {
                "MACS-NEW.seat": {"value": q.seat("MACS-OLD")},
                "MACS-NEW.frame": {"value": in_seat(q, q.seat("MACS-OLD"))},
            },
            "MACS-OLD.seat",
        ),
        (lambda q: {"MACS-NEW.frame": {"value": [0.5, 0.0, 0.5, *UPRIGHT]}}, "MACS-NEW.seat"),  # its seat is elsewhere
        (
            lambda q: {
                "MACS-NEW.frame": {"value": q.model.arms["RIGHT-ARM"].fk(q.joints("RIGHT-ARM")).tolist()},
                "MACS-NEW.seat": {"value": ""},
            },
            "MACS-NEW.frame",
        ),
        (lambda q: free_beside(q, "RACK-2", 0.0), "MACS-NEW.frame"),
        (lambda q: free_beside(q, "RACK-2", 0.1), "MACS-NEW.frame"),
        (lambda q: {"MACS-NEW.mass": {"value": 1e308}}, "MACS-NEW.mass"),
        (lambda q: {"MACS-NEW.mass": {"value": 0}}, "MACS-NEW.mass"),
        *((lambda q, key=key, value=value: {key: {"value": value}}, key) for key, value in OF_ANOTHER_KIND.items()),
        *((lambda q, key=key: {key: {"value": STANDING}}, key) for key in NO_PLACES),
        *((lambda q, value=value: {TAUGHT: {"value": value}}, TAUGHT) for value in ([0.0], [], "home", True)),
        (lambda q: {"MACS-NEW.colour": {"value": "x" * 100_000}}, "MACS-NEW.colour"),
        (lambda q: {"SATELLITE.frame": {"value": [0.0, 0.0, 0.0, *UPRIGHT]}}, "SATELLITE.frame"),  # it is fixed
        (lambda q: {"SATELLITE.frame": {"value": [*q.frame("SATELLITE")[:3], 0.0, 0.0, 1.0, 0.0]}}, "SATELLITE.frame"),
        (lambda q: {"BAY-2.frame": {"value": [0.0, 0.45, 0.6, *UPRIGHT]}}, "BAY-2.frame"),  # mounted on it
    ],
)
def test_facts_of_a_file_that_cannot_be_are_refused_together(query, make, where):
    refusal = refusal_of(changes_from, {"WORLD.facts": {"saved": make(query)}}, query, VALUES)

    assert (refusal.reason, refusal.where) == (RefusalReason.INFEASIBLE, where)
    assert refusal.clears


def test_a_seat_is_not_stated_away_from_the_body_that_has_it(query):
    refusal = refusal_of(changes_from, {"BAY-2.frame": [0.0, 0.45, 0.6, *UPRIGHT]}, query, VALUES)

    assert (refusal.reason, refusal.where) == (RefusalReason.INFEASIBLE, "BAY-2.frame")


def test_a_body_that_was_located_comes_back_with_what_is_mounted_on_it(query):
    spread = [0.05, 0.05, 0.05, 0.0, 0.0, 0.0]
    moved = {name: geometry.compose((0.0, 0.0, 0.08, *UPRIGHT), pose(query, name)).tolist() for name in BODY}
    facts = {f"{name}.frame": {"value": value, "spread": spread} for name, value in moved.items()}

    changes = changes_from({"WORLD.facts": {"saved": facts}}, query, VALUES)
    assert {change.key: change.value for change in changes}["BAY-2.frame"] == moved["BAY-2"]


def pose(query, name):
    return (query.seat_frame(name) if query.is_seat(name) else query.frame(name)).tolist()


def test_what_the_world_believes_can_be_restored(query):
    facts = {
        key: {"value": fact.value, "validity": fact.validity, "spread": fact.spread}
        for key, fact in query.world.facts.items()
        if key.rpartition(".")[0] not in query.model.arms
    }

    changes = changes_from({"WORLD.facts": {"saved": facts}}, query, VALUES)

    assert {change.key for change in changes} >= facts.keys()


def test_a_stated_frame_inside_an_arm_is_refused(query):
    inside = query.model.arms["RIGHT-ARM"].fk(query.joints("RIGHT-ARM")).tolist()

    refusal = refusal_of(changes_from, {"MACS-NEW.frame": inside}, query, VALUES)
    assert (refusal.reason, refusal.where) == (RefusalReason.INFEASIBLE, "MACS-NEW.frame")
