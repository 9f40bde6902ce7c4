"""What is made before the first job is what the broker will ask for by digest."""

from __future__ import annotations

from broker.journal import Journal
from broker.program_store import ProgramStore
from broker.state import State
from rtc import program
from rtc.cell import Cell
from rtc.messages import WorkerKind
from rtc.settings import Settings
from workers.warm import warm


def test_digests_are_the_brokers(tmp_path):
    Settings(run_dir=str(tmp_path)).save()
    made = warm(tmp_path)
    store = ProgramStore(Journal.open(tmp_path / "journal.db", "run", State()))
    for kind in WorkerKind:
        assert list(made.programs[kind]) == [store.keep(program.default(kind))]
    assert list(made.cells) == [store.keep(Cell.load("swapout").encode())]
    (model,) = made.cells.values()
    assert sorted(model.arms) == ["LEFT-ARM", "RIGHT-ARM"]
