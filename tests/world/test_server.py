"""What the world database answers: reads, commits, and every way to be refused one."""

from __future__ import annotations

import pytest

from rtc.model.cells import taught_file
from rtc.model.cells.cell import Cell
from rtc.protocol import wire
from rtc.protocol.messages import (
    Commit,
    Committed,
    Doubt,
    ReadView,
    Validity,
    View,
    WorldChange,
    WorldHistory,
    WorldRefused,
)
from rtc.protocol.outcomes import RefusalReason
from rtc.runtime.handover import Handover
from rtc.runtime.settings import Settings
from rtc.world.__main__ import BORN, _begin
from rtc.world.lease import sign
from rtc.world.server import Packer, Server
from rtc.world.store import Store

KEY = b"k" * 32


@pytest.fixture
def server(tmp_path):
    store = Store(tmp_path / "world.db")
    begin = [WorldChange(key="A.seat", value="BAY-1"), WorldChange(key="B.seat", value="BAY-2")]
    store.write("cell", begin, "cell", 0.0)
    return Server(store, KEY)


def commit(job, changes, locations=("A",), key=KEY):
    changes = [WorldChange(key=k, value=v) for k, v in changes.items()]
    return Commit(request="r", lease=sign(key, job, locations), changes=changes, source=job)


def test_a_commit_is_a_new_version_that_a_delta_shows(server):
    assert server.answer(commit("C-1/4", {"A.seat": "RACK-1"}), 5.0) == Committed(request="r", version=2)
    view = server.answer(ReadView(request="q", since=1), 6.0)
    assert [(f.key, f.value, f.version, f.source, f.at_s) for f in view.facts] == [
        ("A.seat", "RACK-1", 2, "C-1/4", 5.0)
    ]


def test_the_same_job_again_writes_nothing(server):
    server.answer(commit("C-1/4", {"A.seat": "RACK-1"}), 0.0)
    again = server.answer(commit("C-1/4", {"A.seat": "elsewhere"}), 0.0)
    assert again == Committed(request="r", version=2)
    assert (server.store.version, server.store.facts["A.seat"].value) == (2, "RACK-1")


@pytest.mark.parametrize(
    ("request_", "where"),
    [
        (commit("j", {"A.seat": "X"}, key=b"other" * 7), "j"),
        (commit("j", {"B.seat": "X"}), "B.seat"),
        (commit("j", {"A.seat": "X", "A.frame": [0.0] * 7}), "A.frame"),
    ],
)
def test_a_refused_commit_writes_nothing_at_all(server, request_, where):
    answer = server.answer(request_, 0.0)
    assert answer.refusal.reason == RefusalReason.NOT_ALLOWED
    assert answer.refusal.where == where
    assert (server.store.version, server.store.facts["A.seat"].value) == (1, "BAY-1")


def test_facts_that_an_arm_in_motion_changes_are_stated_and_none_is_written(server):
    moving = ["A"]
    server = Server(server.store, KEY, motions=lambda: moving)
    held = {"A.joints": [0.0], "A.holding": "X", "X.frame": [0.0] * 6 + [1.0], "X.mass": 1.0, "B.joints": [0.0]}
    assert isinstance(server.answer(commit("C-1/4", held, ("A", "B", "X")), 5.0), Committed)
    view = server.answer(ReadView(request="q"), 6.0)
    assert set(view.changing) == {"A.joints", "X.frame"}
    assert {fact.validity for fact in view.facts} == {Validity.VALID}
    assert server.answer(ReadView(request="q", since=view.version), 6.0).changing == view.changing
    assert wire.decoder(View)(wire.encode(Packer().pack(view))) == view
    moving.clear()
    assert server.answer(ReadView(request="q"), 7.0).changing == []


def test_a_reader_who_is_up_to_date_gets_nothing(server):
    assert server.answer(ReadView(request="q", since=1), 0.0) == View(request="q", version=1, facts=[])


def test_a_reader_from_another_database_gets_everything(server):
    assert len(server.answer(ReadView(request="q", since=99), 0.0).facts) == 2


def test_history(server):
    server.answer(commit("C-1/4", {"A.seat": "RACK-1"}), 0.0)
    history = server.answer(WorldHistory(request="h", key="A.seat"), 0.0)
    assert [f.value for f in history.facts] == ["RACK-1", "BAY-1"]


def test_a_packed_view_is_the_same_on_the_wire_before_and_after_a_change(server):
    packer = Packer()
    for job in ("C-1/4", "C-1/5", "C-1/6"):
        view = server.answer(ReadView(request="q"), 0.0)
        assert wire.encode(packer.pack(view)) == wire.encode(packer.pack(view)) == wire.encode(view)
        answer = server.answer(commit(job, {"A.seat": job}), 0.0)
        assert packer.pack(answer) is answer


@pytest.mark.parametrize("limit", [-(1 << 63), -1, 0, (1 << 63) - 1, (1 << 64) - 1])
def test_a_history_of_any_length_is_answered(server, limit):
    assert len(server.answer(WorldHistory(request="q", key="A.seat", limit=limit), 0.0).facts) == int(limit > 0)


def test_a_value_too_deep_to_be_shown_is_refused(server):
    deep = 0
    for _ in range(5000):
        deep = [deep]
    answer = server.answer(commit("j", {"A.note": deep}), 0.0)
    assert answer.refusal.reason == RefusalReason.NOT_ALLOWED


# --- doubt ---------------------------------------------------------------------------------------------


def doubt(job="doubt/k7f2", key=KEY):
    return Doubt(request="r", lease=sign(key, job, ()), why="the journal was lost")


def test_a_doubt_makes_suspect_what_a_motion_changes_and_nothing_else(server):
    server = Server(server.store, KEY, lambda: ["B"])  # B is fixed
    server.store.write("more", [WorldChange(key="A.mass", value=2.0)], "cell", 0.0)
    answer = server.answer(doubt(), 5.0)
    facts = server.store.facts
    assert answer == Committed(request="r", version=3)
    assert (facts["A.seat"].value, facts["A.seat"].validity) == ("BAY-1", Validity.SUSPECT)
    assert facts["A.seat"].source == "the journal was lost"
    assert [facts[key].validity for key in ("B.seat", "A.mass")] == [Validity.VALID] * 2


def test_the_same_doubt_again_changes_nothing(server):
    server.answer(doubt(), 5.0)
    server.answer(commit("C-1/4", {"A.seat": "RACK-1"}), 6.0)
    server.answer(doubt(), 7.0)
    assert server.store.facts["A.seat"].validity is Validity.VALID


def test_a_lease_that_the_broker_has_not_signed_makes_nothing_suspect(server):
    assert isinstance(server.answer(doubt(key=b"other" * 7), 0.0), WorldRefused)
    assert server.store.facts["A.seat"].validity is Validity.VALID


def doubt_of_analysis(*locations):
    lease = sign(KEY, "C-1/4", locations)
    return Doubt(request="r", lease=lease, why="the analysis of C-1 was given up")


def test_the_lease_of_an_analysis_makes_its_own_locations_suspect(server):
    assert isinstance(server.answer(doubt_of_analysis("A"), 1.0), Committed)
    validity = {key: server.store.facts[key].validity for key in ("A.seat", "B.seat")}
    assert validity == {"A.seat": Validity.SUSPECT, "B.seat": Validity.VALID}


def test_what_a_doubtful_arm_holds_is_doubtful_too(server):
    server.store.write("held", [WorldChange(key="ARM.holding", value="A")], "cell", 0.0)
    server.answer(doubt_of_analysis("ARM"), 1.0)
    validity = {key: server.store.facts[key].validity for key in ("ARM.holding", "A.seat", "B.seat")}
    assert validity == {"ARM.holding": Validity.SUSPECT, "A.seat": Validity.SUSPECT, "B.seat": Validity.VALID}


def test_an_analysis_that_has_written_its_changes_makes_nothing_suspect(server):
    server.answer(commit("C-1/4", {"A.seat": "RACK-1"}), 1.0)
    server.answer(doubt_of_analysis("A"), 2.0)
    assert server.store.facts["A.seat"].validity is Validity.VALID


def test_changes_that_come_after_the_doubt_of_their_job_are_not_written(server):
    """A worker that counted as dead may still answer."""
    server.answer(doubt_of_analysis("A"), 1.0)
    server.answer(commit("C-1/4", {"A.seat": "RACK-1"}), 2.0)
    fact = server.store.facts["A.seat"]
    assert (fact.value, fact.validity) == ("BAY-1", Validity.SUSPECT)


# --- beginning -----------------------------------------------------------------------------------------


class Notes:
    def __init__(self):
        self.notes = []
        self.note = self.notes.append


@pytest.fixture
def given(tmp_path):
    return Handover.make(Settings(run_dir=str(tmp_path), cell="swapout", run="r"), KEY, "t")


def begun(given):
    """One life of the world database."""
    store, me = Store(given.settings.path / "world.db"), Notes()
    _begin(me, given, store)
    store.saved = lambda version: given.save_counters("world", BORN, version)
    return store, me.notes


def validity(store, key):
    return store.facts[key].validity


def test_a_new_run_begins_with_the_cell_and_trusts_it(given):
    store, notes = begun(given)
    assert notes == []
    assert validity(store, "MACS-NEW.frame") is Validity.VALID


def test_a_new_run_knows_the_places_that_were_taught_before(given, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    file = taught_file.save(Cell.load("swapout"), {"P1": {"RIGHT-ARM": [0.1] * 6}})
    store, notes = begun(given)
    assert store.facts["P1.posture_of_right_arm"].value == [0.1] * 6
    assert notes == []
    store.close()
    (given.settings.path / "world.db").unlink()
    file.write_bytes(b"no json")
    store, notes = begun(given)
    assert any(str(file) in note for note in notes)  # reported, and the cluster starts
    assert validity(store, "MACS-NEW.mass") is Validity.VALID


def test_a_restart_believes_what_it_knew(given):
    begun(given)[0].close()
    store, notes = begun(given)
    assert (notes, store.version) == ([], 1)
    assert validity(store, "MACS-NEW.frame") is Validity.VALID


def test_a_database_that_begins_anew_in_an_old_run_is_in_doubt(given):
    first, _ = begun(given)
    first.write("C-1/4", [WorldChange(key="MACS-NEW.held_by", value="RIGHT-ARM")], "C-1/4", 1.0)
    first.save()
    first.close()
    (given.settings.path / "world.db").unlink()
    store, notes = begun(given)
    assert notes == ["the world database began anew; facts of arms and things are suspect"]
    assert validity(store, "MACS-NEW.held_by") is Validity.SUSPECT
    assert validity(store, "RIGHT-ARM.joints") is Validity.SUSPECT
    assert validity(store, "MACS-NEW.mass") is Validity.VALID
    assert store.version > first.version  # who has read the one before reads this one whole


def test_a_database_that_is_older_than_it_was_is_in_doubt(given):
    begun(given)[0].close()
    given.save_counters("world", BORN, 9)
    store, notes = begun(given)
    assert notes == ["the world database lost its last changes; facts of arms and things are suspect"]
    assert validity(store, "MACS-NEW.frame") is Validity.SUSPECT
    assert store.version == 10
