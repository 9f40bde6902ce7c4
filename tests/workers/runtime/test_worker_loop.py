"""One worker's loop between a real broker's socket and a real world database, with a tiny function inside."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import msgspec
import pytest
import zmq

from rtc.plugins import guard
from rtc.protocol import wire
from rtc.protocol.messages import (
    Assessment,
    CancelJobs,
    Fact,
    Heartbeat,
    HelloWanted,
    Job,
    JobBatch,
    JobCrashed,
    JobDone,
    JobRefused,
    ParserInput,
    ProgramBody,
    ProgramWanted,
    ResultBatch,
    Shutdown,
    Validity,
    View,
    WorkerHello,
    WorkerKind,
    WorkerToBroker,
    WorldChange,
)
from rtc.protocol.outcomes import ProgramError, Refusal, RefusalReason, StopReason
from rtc.protocol.versions import VERSION
from rtc.runtime.link import Link
from rtc.runtime.process import Process, now_s, send
from rtc.world.__main__ import serve
from rtc.world.client import WorldClient
from rtc.world.lease import sign
from rtc.world.model import World
from rtc.world.server import Server
from rtc.world.store import Store
from workers.runtime import arithmetic
from workers.runtime import worker_loop as shells
from workers.runtime.worker_loop import WorkerLoop, WorldView

KEY = b"k" * 32
HELLO = WorkerHello(protocol=VERSION, name="parser@0", node=0, kind=WorkerKind.PARSER, pid=1)


class Function:
    """The worker function of these tests: what it does is in the text of the job."""

    INPUT = ParserInput
    NEEDS_WORLD = True
    NEEDS_CELL = False

    def __init__(self):
        self.compiled = []
        self.began = threading.Event()
        self.go_on = threading.Event()

    def compile(self, program):
        self.compiled.append(program)
        if program == b"bad":
            raise ProgramError("$.steps[3]: no such word")
        return program.decode()

    def run(self, compiled, cell, world, data):
        match data.text.split():
            case ["seat", key]:
                return [compiled, world.value(key), world.version]
            case ["refuse"]:
                return Refusal(reason=RefusalReason.STATE, message="hand not empty")
            case ["raise"]:
                raise IndexError("a bug")
            case ["divide"]:
                raise ZeroDivisionError("by a figure")
            case ["plugin"]:
                with guard.guarded("phase ODD"):
                    raise SystemExit(1)
            case ["write", key, value]:
                changes = [WorldChange(key=key, value=value)]
                return Assessment(verdict="continue", reason=StopReason.GOAL, changes=changes)
            case ["inside"]:
                with guard.guarded("phase SLOW"):
                    self.began.set()
                    assert self.go_on.wait(10)
            case ["wait"]:
                self.began.set()
                assert self.go_on.wait(10)
                with self.loop._pulse._lock:
                    self.socket.poll(1000)  # messages of the broker have arrived
                return "waited"
            case ["compute"]:
                self.began.set()
                while not self.go_on.is_set():
                    pass
                return "computed"
        return data.text


class Broker:
    """The broker's end of the workers' socket."""

    def __init__(self, process, path):
        self.process = process
        self.socket = process.socket(zmq.ROUTER, f"ipc://{path}/workers.sock", bind=True)
        self.read = wire.reader(WorkerToBroker)
        self.asks = False  # who it is that sends heartbeats, as the broker asks a stranger

    def recv(self):
        """The next message that is no heartbeat."""
        for _ in range(40):
            assert self.process.wait(10), "the worker sent nothing"
            _, *parts = self.socket.recv_multipart()
            message = self.read(parts)
            if not isinstance(message, Heartbeat):
                return message
            if self.asks:
                self.send(HelloWanted())
        raise AssertionError("the worker sent only heartbeats")

    def recv_heartbeat(self):
        assert self.process.wait(10), "the worker sent nothing"
        _, *parts = self.socket.recv_multipart()
        message = self.read(parts)
        assert isinstance(message, Heartbeat)
        return message

    def send(self, message):
        assert send(self.socket, message, to=b"parser@0")

    def give(self, *texts, program="p1", lease=None, first=1):
        jobs = [
            Job(id=f"C-1/{n}", attempt=1, program=program, input=wire.raw(ParserInput(text=text)), lease=lease)
            for n, text in enumerate(texts, first)
        ]
        self.send(JobBatch(jobs=jobs))

    def provide(self, body=b"v1"):
        wanted = self.recv()
        assert isinstance(wanted, ProgramWanted)
        self.send(ProgramBody(digest=wanted.digest, body=body))

    def results(self, count):
        found = []
        while len(found) < count:
            batch = self.recv()
            assert isinstance(batch, ResultBatch)
            found += batch.results
        return found


def value(result):
    assert isinstance(result, JobDone), result
    return msgspec.msgpack.decode(result.product)


@pytest.fixture
def world(tmp_path):
    process = Process("world", tmp_path)
    socket = process.socket(zmq.ROUTER, f"ipc://{tmp_path}/world.sock", bind=True)

    def run():
        store = Store(":memory:")
        store.write("cell", [WorldChange(key="A.seat", value="BAY-1")], "cell", 0.0)
        serve(process, socket, Server(store, KEY))
        store.close()

    thread = threading.Thread(target=run)
    thread.start()
    yield f"ipc://{tmp_path}/world.sock"
    process.stop()
    thread.join(5)
    process.close()


@pytest.fixture
def at(tmp_path, world, monkeypatch):
    """A worker loop in a thread, its broker, and its function; hello has been sent. It reads the socket before every
    job: tests do not wait."""
    monkeypatch.setattr("workers.runtime.worker_loop.LISTEN_S", 0.0)
    process, mine = Process("parser@0", tmp_path), Process("broker", tmp_path)
    broker = Broker(mine, tmp_path)
    link = Link.connect(process, f"ipc://{tmp_path}/workers.sock", "parser@0")
    client = WorldClient(world, process.context)
    function = Function()
    loop = WorkerLoop(process, HELLO, function, link, client, lambda cell: None, {"made": "v0"})
    function.socket, function.loop = link.socket, loop
    thread = threading.Thread(target=loop.run)
    thread.start()
    assert broker.recv() == HELLO
    yield SimpleNamespace(
        broker=broker, function=function, thread=thread, process=process, process_of_broker=mine, path=tmp_path
    )
    function.go_on.set()
    process.stop()
    thread.join(5)
    assert not thread.is_alive()
    client.close()
    process.close()
    mine.close()


def test_a_job_gets_its_program_and_the_world_and_answers(at):
    at.broker.give("seat A.seat")
    at.broker.provide(b"v1")
    (done,) = at.broker.results(1)
    assert (done.id, done.attempt, value(done)) == ("C-1/1", 1, ["v1", "BAY-1", 1])
    assert 0 < done.took_s < 10


def test_a_program_is_fetched_and_compiled_once(at):
    at.broker.give("a", "b")
    at.broker.provide(b"v1")
    at.broker.results(2)
    at.broker.give("c")
    at.broker.results(1)
    at.broker.give("d", program="p2")
    at.broker.provide(b"v2")
    at.broker.results(1)
    assert at.function.compiled == [b"v1", b"v2"]


def test_a_program_that_was_made_before_is_not_fetched(at):
    at.broker.give("seat A.seat", program="made")
    (done,) = at.broker.results(1)
    assert (value(done)[0], at.function.compiled) == ("v0", [])


def test_a_program_that_does_not_check_is_refused_each_time_and_compiled_once(at):
    at.broker.give("a", "b", program="p-bad")
    at.broker.provide(b"bad")
    results = at.broker.results(2)
    assert [(type(r), r.refusal.reason) for r in results] == [(JobRefused, RefusalReason.PROGRAM)] * 2
    assert results[0].refusal.where == "p-bad"
    assert at.function.compiled == [b"bad"]


def test_a_program_that_the_broker_has_not_is_a_refusal(at):
    at.broker.give("a")
    at.broker.provide(None)
    (refused,) = at.broker.results(1)
    assert refused.refusal.reason == RefusalReason.PROGRAM


def test_a_program_that_never_comes_is_asked_for_again_and_then_refused(at, monkeypatch):
    monkeypatch.setattr(shells, "PROGRAM_LIMIT_S", 0.1)
    monkeypatch.setattr(shells, "ASK_AGAIN_S", 0.03)
    at.broker.give("a")
    assert [at.broker.recv() for _ in range(2)] == [ProgramWanted(digest="p1")] * 2
    while isinstance(answer := at.broker.recv(), ProgramWanted):
        pass
    assert answer.results[0].refusal.reason == RefusalReason.TIMEOUT  # the program is not to blame


def test_a_refusal_and_a_crash_are_results_and_the_worker_lives_on(at):
    at.broker.give("refuse", "raise", "hello", "plugin", "divide")
    at.broker.provide()
    refused, crashed, done, failed, divided = at.broker.results(5)
    assert refused.refusal == Refusal(reason=RefusalReason.STATE, message="hand not empty")
    assert isinstance(crashed, JobCrashed)
    assert "IndexError: a bug" in crashed.evidence
    assert value(done) == "hello"
    assert failed.refusal.reason is RefusalReason.PROGRAM
    assert "phase ODD" in failed.refusal.message  # wording: whose code has failed
    assert divided.refusal.reason is RefusalReason.INFEASIBLE


def test_arithmetic_that_fails_names_the_fact_that_no_computation_bears():
    huge = Fact(key="A.mass", value=1e300, validity=Validity.VALID, version=1, source="test", at_s=0.0)
    assert arithmetic.doubtful(World(1, {"A.mass": huge})).startswith("A.mass")
    assert arithmetic.doubtful(World(1, {"A.mass": msgspec.structs.replace(huge, value=2.0)})) == ""


def test_code_of_a_package_is_named_in_signs_of_life_and_announced_after_a_death(at, monkeypatch):
    monkeypatch.setattr("workers.runtime.pulse.BEAT_S", 0.05)
    announced = []
    monkeypatch.setattr(at.process, "calls", announced.append)
    at.broker.give("inside", program="made")
    assert at.function.began.wait(10)
    while at.broker.recv_heartbeat().inside != "phase SLOW":
        pass
    at.function.go_on.set()
    at.broker.results(1)
    assert announced == []
    again = Job(id="C-1/1", attempt=2, program="made", input=wire.raw(ParserInput(text="inside")))
    at.broker.send(JobBatch(jobs=[again]))
    at.broker.results(1)
    assert announced == ["phase SLOW"]


@pytest.mark.parametrize("data", [{"text": 7}, {"text": "hello", "not_before": 3.0}])
def test_an_input_with_another_value_or_a_newer_key_is_refused(at, data):
    job = Job(id="C-1/1", attempt=1, program="p1", input=wire.raw(data))
    at.broker.send(JobBatch(jobs=[job]))
    at.broker.provide()
    (refused,) = at.broker.results(1)
    assert isinstance(refused, JobRefused)
    assert refused.refusal.reason is RefusalReason.STATE
    assert refused.refusal.clears


def test_changes_are_committed_before_the_answer_and_seen_by_the_next_job(at):
    at.broker.give("write A.seat RACK-1", "seat A.seat", lease=sign(KEY, "C-1/1", ["A"]))
    at.broker.provide()
    assessment, after = at.broker.results(2)
    assert value(assessment)["verdict"] == "continue"
    assert value(after)[1:] == ["RACK-1", 2]


def test_a_job_with_a_doubt_makes_its_leased_facts_suspect_without_its_program(at, world):
    lease = sign(KEY, "C-1/1", ["A"])
    doubtful = Job(
        id="C-1/1", attempt=1, program="lost", input=wire.raw(ParserInput(text="raise")), lease=lease, doubt="given up"
    )
    at.broker.send(JobBatch(jobs=[doubtful]))
    (done,) = at.broker.results(1)
    assert isinstance(done, JobDone)
    client = WorldClient(world, at.process_of_broker.context)
    (fact,) = client.view(keys=["A.seat"]).facts
    client.close()
    assert (fact.value, fact.validity, fact.source) == ("BAY-1", Validity.SUSPECT, "given up")


def test_a_commit_outside_the_lease_is_a_refusal(at):
    at.broker.give("write B.seat RACK-1", lease=sign(KEY, "C-1/1", ["A"]))
    at.broker.provide()
    (refused,) = at.broker.results(1)
    assert refused.refusal.reason == RefusalReason.NOT_ALLOWED


def test_without_a_lease_nothing_is_written_and_the_job_is_refused(at):
    at.broker.give("write A.seat RACK-1", "seat A.seat")
    at.broker.provide()
    refused, after = at.broker.results(2)
    assert refused.refusal.reason is RefusalReason.PROGRAM
    assert value(after)[1:] == ["BAY-1", 1]


@pytest.mark.parametrize("work", ["compute", "wait"])
def test_a_job_in_progress_reports_its_processor_time(at, monkeypatch, work):
    monkeypatch.setattr("workers.runtime.pulse.BEAT_S", 0.05)
    at.broker.recv_heartbeat()  # the next one comes after the new period
    at.broker.give(work, program="made")
    assert at.function.began.wait(10)
    beats = [at.broker.recv_heartbeat().own_s for _ in range(6)][2:]  # without those before the job
    if work == "compute":
        assert beats[-1] - beats[0] > 0.01
    else:
        assert 0.0 <= beats[-1] - beats[0] < 0.001  # it waits: no processor time passes
    at.function.go_on.set()
    (done,) = at.broker.results(1)
    assert isinstance(done, JobDone)


def test_a_dropped_job_that_has_not_begun_is_not_done(at):
    at.broker.give("wait", "never", "last")
    at.broker.provide()
    assert at.function.began.wait(10)
    at.broker.send(CancelJobs(jobs=["C-1/2"]))
    at.function.go_on.set()
    waited, dropped, last = sorted(at.broker.results(3), key=lambda r: r.id)
    assert (value(waited), value(last)) == ("waited", "last")
    assert dropped.refusal.reason is RefusalReason.STATE


def test_a_broker_begun_anew_gets_a_hello_and_no_work_of_the_old_one(at):
    at.broker.recv_heartbeat()
    at.broker.recv_heartbeat()  # the second comes after half a second: the first hello is past
    at.broker.give("wait", "old")
    at.broker.provide()
    assert at.function.began.wait(10)
    for _ in range(3):  # it has received three heartbeats of a stranger
        at.broker.send(HelloWanted())
    at.broker.give("new", first=7)
    at.function.go_on.set()
    received = [at.broker.recv(), at.broker.recv(), at.broker.recv()]
    assert received.count(HELLO) == 1
    done = [r.id for message in received if isinstance(message, ResultBatch) for r in message.results]
    assert done == ["C-1/1", "C-1/7"]


def test_a_broker_that_was_killed_and_is_back_gets_a_hello(at):
    at.process_of_broker.poller.unregister(at.broker.socket)
    at.broker.socket.close(linger=0)
    at.broker = Broker(at.process_of_broker, at.path)
    at.broker.asks = True  # the hello may have gone to the old one, which closes in its own time
    assert at.broker.recv() == HELLO
    at.broker.give("new")
    at.broker.provide()
    assert [r.id for r in at.broker.results(1)] == ["C-1/1"]


def test_results_of_quick_jobs_travel_together_and_in_order(at):
    at.broker.give(*["x"] * 500)
    at.broker.provide()
    at.broker.results(500)
    at.broker.give(*(str(n) for n in range(500)))
    messages, results = 0, []
    while len(results) < 500:
        messages += 1
        results += at.broker.recv().results
    assert [value(r) for r in results] == [str(n) for n in range(500)]
    assert messages < 250


def test_a_retiring_worker_does_what_it_has_and_ends(at):
    at.broker.give("a", "b")
    at.broker.provide()
    at.broker.send(Shutdown())
    assert [value(r) for r in at.broker.results(2)] == ["a", "b"]
    at.thread.join(5)
    assert not at.thread.is_alive()


def test_a_worker_stopped_while_it_waits_for_a_program_answers_nothing(at):
    at.broker.give("a")
    assert isinstance(at.broker.recv(), ProgramWanted)
    at.process.stop()
    at.thread.join(5)
    assert not at.thread.is_alive()
    assert at.broker.socket.poll(0) == 0


class Database:
    """A world database without a process: `version` as in the handover file, `reads` of its clients."""

    def __init__(self):
        self.version, self.reads = 7, 0

    def stored(self, since):
        self.reads += 1
        now = self.version
        fact = Fact(key="A.seat", value=now, validity=Validity.VALID, version=now, source="test", at_s=0.0)
        return View(request="1", version=now, facts=[fact])


def test_a_world_whose_version_is_unchanged_is_not_read_again():
    database = Database()
    view = WorldView(database, lambda: database.version)
    seen = [view.at(came_s=now_s()).value("A.seat") for _ in range(3)]
    assert (seen, database.reads) == ([7, 7, 7], 1)
    database.version = 8
    assert view.at(came_s=now_s()).value("A.seat") == 8
    assert database.reads == 2


def test_a_world_whose_version_is_not_known_is_read_for_each_batch():
    database = Database()
    view = WorldView(database, lambda: None)
    assert [view.at(came_s=now_s()).value("A.seat") for _ in range(3)] == [7, 7, 7]
    assert database.reads == 3
