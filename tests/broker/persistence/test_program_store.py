"""LOAD: what does not check, or does not fit the programs it would work with, is never in use."""

from __future__ import annotations

import pytest

from broker.decisions.state import State
from broker.persistence.journal import Journal
from broker.persistence.program_store import ProgramStore, StoredProgram
from rtc.programs import loader
from rtc.programs.sandbox import check
from rtc.protocol.messages import ProgramText, WorkerKind
from rtc.protocol.outcomes import Refusal


def load(store: ProgramStore, text: ProgramText) -> StoredProgram | Refusal:
    return store.take(text, check(store.asked(text)))


STEP = "{do: move, to: HERE, stop: STOP, space: move_task, label: x}"


@pytest.mark.parametrize(("stop", "fits"), [("move_free", True), ("move_fast", False)])
def test_a_script_must_fit_the_binder_in_use(tmp_path, stop, fits):
    in_use: dict[str, str] = {}
    store = ProgramStore(Journal.open(tmp_path / "journal.db", "run", State()), in_use)
    in_use |= {kind: store.keep(loader.default(kind)) for kind in WorkerKind}
    body = f"script: mine\ncase: 1\nsteps:\n- {STEP.replace('STOP', stop)}".encode()
    text = ProgramText(request="r", kind=WorkerKind.ELABORATOR, name="mine.yaml", body=body)

    loaded = load(store, text)

    if fits:
        assert isinstance(loaded, StoredProgram), loaded
        assert b"mine" in (store.body(loaded.digest) or b"")
        assert loaded.changes[0] == "scripts: mine is new"
    else:
        assert isinstance(loaded, Refusal)
        assert loaded.message.startswith("mine.yaml, line 4: ")  # wording: the place in the file


def test_what_was_loaded_is_taken_away_again(tmp_path):
    in_use: dict[str, str] = {}
    store = ProgramStore(Journal.open(tmp_path / "journal.db", "run", State()), in_use)
    in_use |= {kind: store.keep(loader.default(kind)) for kind in WorkerKind}
    original = in_use["elaborator"]
    body = f"script: mine\ncase: 1\nsteps:\n- {STEP.replace('STOP', 'move_free')}".encode()
    mine = ProgramText(request="r", kind=WorkerKind.ELABORATOR, name="mine.yaml", body=body)
    in_use["elaborator"] = load(store, mine).digest

    reset = ProgramText(request="r", kind=WorkerKind.ELABORATOR, name="default", body=b"", reset=True)
    taken = load(store, reset)

    assert (taken.digest, taken.changes) == (original, ["scripts: mine is removed"])

    back = ProgramText(
        request="r", kind=WorkerKind.ELABORATOR, name="mine.yaml", body=b"", reset=True, to=in_use["elaborator"]
    )
    in_use["elaborator"] = taken.digest
    again = load(store, back)
    assert (again.digest, again.changes[0]) == (back.to, "scripts: mine is new")
