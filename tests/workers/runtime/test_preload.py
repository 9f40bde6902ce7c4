"""What is made before the first job is what the broker will ask for by digest."""

from __future__ import annotations

import subprocess
import sys

import pytest
import zmq

from broker.decisions.state import State
from broker.persistence.journal import Journal
from broker.persistence.program_store import ProgramStore
from rtc.model.cells.cell import Cell
from rtc.programs import loader
from rtc.protocol import wire
from rtc.protocol.digest import digest
from rtc.protocol.messages import (
    Job,
    JobBatch,
    JobDone,
    ParserInput,
    ProgramWanted,
    ResultBatch,
    WorkerHello,
    WorkerKind,
    WorkerToBroker,
)
from rtc.runtime.process import Process, inbox, send
from rtc.runtime.settings import Settings
from workers.runtime.preload import preload


def test_digests_are_the_brokers(tmp_path):
    made = preload(WorkerKind, "swapout")
    store = ProgramStore(Journal.open(tmp_path / "journal.db", "run", State()))
    for kind in WorkerKind:
        assert list(made.programs[kind]) == [store.keep(loader.default(kind))]
    assert list(made.cells) == [store.keep(Cell.load("swapout").encode())]
    (model,) = made.cells.values()
    assert sorted(model.arms) == ["LEFT-ARM", "RIGHT-ARM"]


def test_a_worker_makes_what_its_kind_needs_and_no_more():
    parser, binder = preload([WorkerKind.PARSER], "swapout"), preload([WorkerKind.BINDER], "swapout")
    assert (list(parser.programs), len(parser.cells)) == ([WorkerKind.PARSER], 0)
    assert (list(binder.programs), len(binder.cells)) == ([WorkerKind.BINDER], 1)
    assert len(preload([WorkerKind.BINDER], cell=None).cells) == 0  # far away: which cell it is the first job tells


@pytest.mark.slow
@pytest.mark.untimed
def test_the_first_job_of_a_worker_that_has_started_by_itself_waits_for_nothing(tmp_path):
    Settings(run_dir=str(tmp_path)).save()
    command = [sys.executable, "-m", "workers", "--run-dir", str(tmp_path), "--kind", "parser", "--node", "0"]
    broker = Process("broker", tmp_path)
    socket = broker.socket(zmq.ROUTER, f"ipc://{tmp_path}/workers.sock", bind=True)
    job = Job(
        id="C-1/1",
        attempt=1,
        program=digest(loader.default(WorkerKind.PARSER)),
        input=wire.raw(ParserInput(text="STOW LEFT-ARM")),
    )
    received = []
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as worker:
        while not received or not isinstance(received[-1], ResultBatch | ProgramWanted):
            assert broker.wait(30), received
            for _, *parts in inbox(socket):
                received.append(wire.reader(WorkerToBroker)(parts))
                if isinstance(received[-1], WorkerHello):
                    send(socket, JobBatch(jobs=[job]), to=b"parser@0")
        worker.terminate()
    broker.close()
    assert isinstance(received[-1], ResultBatch)
    assert isinstance(received[-1].results[0], JobDone)
