"""The world on disk: found again after a restart, history kept, jobs remembered."""

from __future__ import annotations

import sqlite3

import pytest

from rtc.protocol.messages import Validity, WorldChange
from rtc.world.store import Store


@pytest.fixture
def path(tmp_path):
    return tmp_path / "world.db"


def change(key, value, **kw):
    return WorldChange(key=key, value=value, **kw)


def test_a_store_begins_empty(path):
    store = Store(path)
    assert (store.version, store.facts, store.committed("C-1/1")) == (0, {}, None)


def test_what_was_saved_is_found_by_the_next_process(path):
    first = Store(path)
    first.write("cell", [change("A.frame", [0.1, 1 / 3, -2e-9, 0, 0, 0, 1]), change("A.grasp", None)], "cell", 1.5)
    first.write("C-1/4", [change("A.seat", "BAY-1")], "C-1/4", 2.5)
    first.save()
    # Given: the first process is killed here; nothing is closed.
    again = Store(path)
    assert (again.version, again.facts) == (2, first.facts)
    assert (again.committed("C-1/4"), again.committed("C-9/9")) == (2, None)
    assert again.facts["A.frame"].value == [0.1, 1 / 3, -2e-9, 0, 0, 0, 1]


def test_what_was_not_saved_never_was(path):
    first = Store(path)
    first.write("cell", [change("A.seat", "BAY-1")], "cell", 0.0)
    first.save()
    first.write("C-1/4", [change("A.seat", "BAY-2")], "C-1/4", 0.0)
    again = Store(path)
    assert (again.version, again.facts["A.seat"].value, again.committed("C-1/4")) == (1, "BAY-1", None)


def test_a_change_of_validity_keeps_the_value(path):
    store = Store(path)
    store.write("cell", [change("A.seat", "BAY-1")], "cell", 0.0)
    store.write("j", [WorldChange(key="A.seat", keep_value=True, validity=Validity.SUSPECT)], "j", 0.0)
    assert (store.facts["A.seat"].value, store.facts["A.seat"].validity) == ("BAY-1", Validity.SUSPECT)


def test_the_last_of_two_changes_of_one_key_in_a_job_counts(path):
    store = Store(path)
    twice = [change("A.seat", "X"), WorldChange(key="A.seat", keep_value=True, validity=Validity.CHANGING)]
    store.write("j", twice, "j", 0.0)
    assert (store.facts["A.seat"].value, store.facts["A.seat"].validity) == ("X", Validity.CHANGING)


def test_history_is_newest_first_and_limited(path):
    store = Store(path)
    for n in range(5):
        store.write(f"j{n}", [change("A.mass", float(n))], f"j{n}", float(n))
    assert [(f.value, f.version, f.source) for f in store.history("A.mass", 2)] == [(4.0, 5, "j4"), (3.0, 4, "j3")]
    assert store.history("B.mass", 10) == []


def test_any_tool_can_read_the_file(path):
    store = Store(path)
    store.write("j", [change("A.seat", "BAY-1")], "j", 0.0)
    store.save()
    rows = sqlite3.connect(path).execute("SELECT key, value, validity, version, source FROM facts").fetchall()
    assert rows == [("A.seat", '"BAY-1"', "valid", 1, "j")]


def test_the_spread_of_a_pose_is_found_again_with_its_history(path):
    first = Store(path)
    pose = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    first.write("cell", [change("A.frame", pose, spread=[0.035] * 6)], "cell", 0.0)
    first.write("j", [change("A.frame", pose, spread=[0.001] * 6)], "j", 1.0)
    first.save()
    again = Store(path)
    assert again.facts["A.frame"].spread == [0.001] * 6
    assert [fact.spread for fact in again.history("A.frame", 9)] == [[0.001] * 6, [0.035] * 6]
