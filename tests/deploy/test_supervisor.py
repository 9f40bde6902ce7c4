"""The supervisor with real, small processes and a real broker's end of its socket."""

from __future__ import annotations

import errno
import os
import select
import signal
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import zmq

from deploy import child
from deploy.child import Spec
from deploy.restarts import DEFAULT, Policy
from deploy.supervisor import Hooks, Supervisor
from rtc.protocol import wire
from rtc.protocol.messages import (
    KillProcess,
    ProcessExited,
    ProcessHello,
    ProcessTable,
    RetireWorker,
    Shutdown,
    SpawnWorker,
    SupervisorToBroker,
    WorkerKind,
)
from rtc.protocol.outcomes import ClusterError
from rtc.runtime.process import Process, now_s, send

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

GOOD = "import signal; print('ready', flush=True); signal.pause()"
STUBBORN = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('ready', flush=True); signal.pause()"
BAD = "import sys; sys.exit('no such cell: moon base')"
MUTE = "import signal; signal.pause()"
CHATTY = "import signal; print('build time: today\\nready\\nmore', flush=True); signal.pause()"


def spec(name, code, node=None):
    return Spec(name, (sys.executable, "-S", "-E", "-c", code), node)


class Cluster:
    """A supervisor at work in a thread, its broker, and what it printed and saved."""

    def __init__(self, path, specs, policy=DEFAULT, new_worker=None):
        self.lines, self.saved = [], []
        self.broker_process = Process("broker", path)
        endpoint = f"ipc://{path}/supervisor.sock"
        self.broker = self.broker_process.socket(zmq.ROUTER, endpoint, bind=True)
        self.read = wire.reader(SupervisorToBroker)
        self.process = Process("supervisor", path)
        self.supervisor = Supervisor(
            self.process,
            specs,
            path,
            endpoint,
            Hooks(
                new_worker=new_worker or (lambda address: spec(f"new@{address}", GOOD, address)),
                show=self.lines.append,
                save=self.saved.append,
            ),
            policy=policy,
        )
        self.thread = threading.Thread()

    def _run(self):
        try:
            self.supervisor.run()
        finally:
            self.supervisor.stop(limit_s=0.3)

    def go(self):
        # Children die with the thread that has forked them, so it is the one that also runs the supervisor.
        started = threading.Event()
        self.thread = threading.Thread(target=lambda: (self.supervisor.start(), started.set(), self._run()))
        self.thread.start()
        assert started.wait(10)
        return self

    def recv(self, kind):
        """The next message of this kind."""
        while True:
            assert self.broker_process.wait(10), f"no {kind.__name__} came"
            _, *parts = self.broker.recv_multipart()
            message = self.read(parts)
            if isinstance(message, kind):
                return message

    def recv_table(self, wanted):
        """The next process table for which `wanted` is true, by name."""
        end_s = now_s() + 30
        while True:
            assert now_s() < end_s, self.lines
            table = {row.name: row for row in self.recv(ProcessTable).processes}
            if wanted(table):
                return table

    def send(self, message):
        assert send(self.broker, message, to=b"supervisor")

    def close(self):
        self.process.stop()
        if self.thread.ident:
            self.thread.join(10)
            assert not self.thread.is_alive()
        self.process.close()
        self.broker_process.close()


@pytest.fixture
def cluster(tmp_path):
    made = []

    def make(*specs, **kw):
        made.append(Cluster(tmp_path, specs, **kw))
        return made[-1]

    yield make
    for each in made:
        each.close()


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_all_are_started_and_the_broker_is_informed(cluster):
    it = cluster(spec("world", GOOD), spec("binder@2", GOOD, 2)).go()
    it.recv(ProcessHello)
    table = it.recv_table(lambda t: True)
    assert {name: row.state for name, row in table.items()} == {"world": "ready", "binder@2": "ready"}
    assert all(alive(row.pid) for row in table.values())
    assert it.saved[-1] == list(table.values())


def test_a_killed_process_is_reported_at_once_and_comes_back(cluster):
    it = cluster(spec("world", GOOD), spec("binder@2", GOOD, 2)).go()
    before = it.recv_table(lambda t: True)["binder@2"].pid
    os.kill(before, signal.SIGKILL)
    exited = it.recv(ProcessExited)
    assert exited == ProcessExited(name="binder@2", pid=before, status=-9)
    row = it.recv_table(lambda t: t["binder@2"].state == "ready")["binder@2"]
    assert (row.pid != before, row.restarts) == (True, 1)


FORKS = "import os,signal; os.fork() and print('calls phase ODD\\nready', flush=True); signal.pause()"


def test_what_a_process_has_forked_ends_with_it_and_its_last_call_is_reported(cluster):
    it = cluster(spec("binder@2", FORKS, 2)).go()
    pid = it.recv_table(lambda t: t["binder@2"].state == "ready")["binder@2"].pid
    (child,) = map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
    pidfd = os.pidfd_open(child)
    os.kill(pid, signal.SIGKILL)
    assert it.recv(ProcessExited) == ProcessExited(name="binder@2", pid=pid, status=-9, called="phase ODD")
    assert select.select([pidfd], [], [], 10)[0]
    os.close(pidfd)


def test_a_process_in_a_crash_loop_is_held_back_reported_as_such_and_goes_on_trying(cluster):
    it = cluster(spec("binder@2", GOOD, 2), policy=Policy(short_s=60.0, spared=1, first_delay_s=0.01)).go()
    for _ in range(2):
        pid = it.recv_table(lambda t: t["binder@2"].state == "ready")["binder@2"].pid
        os.kill(pid, signal.SIGKILL)
        assert it.recv(ProcessExited).pid == pid
    assert it.recv_table(lambda t: t["binder@2"].state == "crash loop")["binder@2"].pid == 0
    assert it.recv_table(lambda t: t["binder@2"].state == "ready")["binder@2"].restarts == 2


def test_what_cannot_start_fails_the_whole_with_the_end_of_its_log(cluster):
    it = cluster(spec("world", GOOD), spec("MCM", BAD))
    with pytest.raises(ClusterError, match=r"(?s)MCM ended with status 1.*no such cell: moon base"):
        it.supervisor.start()
    pids = [row.pid for row in it.supervisor.table() if row.pid]
    it.supervisor.stop()
    assert not any(alive(pid) for pid in pids)


def test_who_hangs_before_it_is_ready_is_named(cluster, quick):
    it = cluster(spec("world", GOOD), spec("MCM", MUTE))
    with pytest.raises(ClusterError, match=r"MCM is not ready, and hung"):
        it.supervisor.start()
    it.supervisor.stop()


def test_the_cluster_waits_for_one_that_works_to_get_ready_and_says_so(cluster, quick):
    it = cluster(spec("world", GOOD), spec("MCM", SLOW)).go()
    assert "waiting for MCM" in it.lines
    pid = it.recv_table(lambda t: True)["MCM"].pid
    os.kill(pid, signal.SIGKILL)
    it.recv_table(lambda t: (t["MCM"].state, t["MCM"].restarts) == ("ready", 1))
    assert not any("is killed" in line for line in it.lines)


def test_who_never_gets_ready_however_busy_is_killed(cluster, quick, monkeypatch):
    monkeypatch.setattr("deploy.supervisor.START_LIMIT_S", 0.3)
    it = cluster(spec("MCM", "while True: pass"))
    with pytest.raises(ClusterError, match=r"MCM is not ready within "):
        it.supervisor.start()
    it.supervisor.stop()


def test_while_a_template_hangs_no_two_workers_start_by_themselves_at_once(cluster, quick, tmp_path):
    """Its second life hangs before it is ready: it is killed, and again has a delay."""
    hangs = (sys.executable, "-c", ONCE.format(file=str(tmp_path / "once")) + TEMPLATE)
    names = [f"binder@{address}" for address in (2, 6, 10)]
    it = cluster(replace(template(), command=hangs), *map(forked, names)).go()
    table = it.recv_table(lambda t: True)
    for row in table.values():
        os.kill(row.pid, signal.SIGKILL)
    it.recv_table(lambda t: all(t[name].state == "ready" and t[name].restarts == 1 for name in names))
    assert any("template" in line and "hung" in line for line in it.lines)
    starting = [sum(row.state == "starting" and "@" in row.name for row in table) for table in it.saved]
    last = next(n for n, table in enumerate(it.saved) if any(row.restarts for row in table))
    assert max(starting[last:]) == 1


@pytest.fixture
def quick(monkeypatch):
    for name, value in (("TABLE_S", 0.05), ("IDLE_S", 0.4), ("REPORT_WAITING_S", 0.1)):
        monkeypatch.setattr(f"deploy.supervisor.{name}", value)


SLOW = "import time\nwhile time.process_time() < 0.6: pass\n" + GOOD
ONCE = """
import pathlib, signal
try:
    pathlib.Path({file!r}).touch(exist_ok=False)
except FileExistsError:
    signal.pause()
"""


def test_one_that_will_not_end_is_killed(cluster):
    it = cluster(spec("world", STUBBORN)).go()
    pid = it.recv_table(lambda t: True)["world"].pid
    it.process.stop()
    it.thread.join(10)
    assert not alive(pid)
    assert it.saved[-1][0].state == "ended"


def test_what_a_process_prints_goes_to_its_log(cluster, tmp_path):
    it = cluster(spec("MCM", CHATTY)).go()
    it.recv_table(lambda t: t["MCM"].state == "ready")
    it.process.stop()
    it.thread.join(10)
    assert (tmp_path / "MCM.log").read_text() == "build time: today\nmore\n"


def test_the_broker_has_a_hung_process_killed_but_never_its_successor(cluster):
    it = cluster(spec("binder@2", STUBBORN, 2)).go()
    pid = it.recv_table(lambda t: True)["binder@2"].pid
    it.send(KillProcess(name="binder@2", pid=pid + 100_000, why="an old story"))
    it.send(KillProcess(name="binder@2", pid=pid, why="no answer for 30 s"))
    assert it.recv(ProcessExited).status == -9
    assert it.recv_table(lambda t: t["binder@2"].state == "ready")["binder@2"].restarts == 1
    assert [line for line in it.lines if "story" in line] == []


def test_one_that_should_say_that_it_is_alive_and_does_not_is_killed_and_replaced(cluster, monkeypatch):
    monkeypatch.setattr("deploy.supervisor.TABLE_S", 0.05)
    monkeypatch.setattr("deploy.supervisor.SILENT_S", 0.3)
    hanging = "import signal\nprint('ready\\nalive', flush=True)\nsignal.pause()"
    it = cluster(Spec("world", (sys.executable, "-S", "-E", "-c", hanging), beats=True), spec("mute", GOOD)).go()
    pid = it.recv_table(lambda t: True)["world"].pid
    assert it.recv(ProcessExited) == ProcessExited(name="world", pid=pid, status=-9)
    back = it.recv_table(lambda t: t["world"].state == "ready")
    assert (back["world"].restarts, back["mute"].restarts) == (1, 0)
    assert any("world" in line and "hung, silent" in line for line in it.lines)


def test_one_that_is_stopped_is_killed_and_replaced(cluster, monkeypatch):
    monkeypatch.setattr("deploy.supervisor.TABLE_S", 0.05)
    monkeypatch.setattr("deploy.supervisor.STOPPED_S", 0.2)
    it = cluster(spec("binder@2", GOOD, 2), spec("binder@6", GOOD, 6)).go()
    pid = it.recv_table(lambda t: True)["binder@2"].pid
    os.kill(pid, signal.SIGSTOP)
    assert it.recv(ProcessExited) == ProcessExited(name="binder@2", pid=pid, status=-9)
    back = it.recv_table(lambda t: t["binder@2"].state == "ready")
    assert (back["binder@2"].restarts, back["binder@6"].restarts) == (1, 0)


def test_workers_are_added_at_the_next_free_address_and_retired(cluster):
    it = cluster(spec("world", GOOD), spec("binder@2", GOOD, 2)).go()
    it.send(SpawnWorker(kind=WorkerKind.BINDER))
    row = it.recv_table(lambda t: "new@6" in t and t["new@6"].state == "ready")["new@6"]
    it.send(RetireWorker(name="new@6"))
    assert it.recv(ProcessExited) == ProcessExited(name="new@6", pid=row.pid, status=-15)
    it.recv_table(lambda t: "new@6" not in t)
    it.send(RetireWorker(name="world"))  # not a worker: stays
    it.send(SpawnWorker(kind=WorkerKind.PARSER))
    assert "world" in it.recv_table(lambda t: "new@0" in t)


def test_rubbish_from_the_socket_is_dropped(cluster):
    it = cluster(spec("world", GOOD)).go()
    it.recv_table(lambda t: True)
    it.broker.send_multipart([b"supervisor", b"RTC1", b"\xff"])
    it.send(SpawnWorker(kind=WorkerKind.PARSER))
    it.recv_table(lambda t: "new@0" in t)


def test_the_broker_can_end_the_cluster(cluster):
    it = cluster(spec("world", GOOD)).go()
    pid = it.recv_table(lambda t: True)["world"].pid
    it.send(Shutdown())
    it.thread.join(10)
    assert not alive(pid)


def test_a_killed_process_leaves_no_zombie_and_no_open_file(cluster):
    it = cluster(spec("binder@2", GOOD, 2)).go()
    fds = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        os.kill(it.recv_table(lambda t: t["binder@2"].state == "ready")["binder@2"].pid, signal.SIGKILL)
        it.recv(ProcessExited)
    it.recv_table(lambda t: t["binder@2"].state == "ready" and t["binder@2"].restarts == 5)
    assert len(os.listdir("/proc/self/fd")) <= fds  # fewer: something older was collected meanwhile


TEMPLATE = """
import os, signal, sys
from rtc.runtime.fork_server import serve
def be(order):
    print(f"{order.decode()} of {os.getppid()}", file=sys.stderr, flush=True)
    if order == b"analyzer@7":
        raise ZeroDivisionError("a bug")
    if order == b"template":
        serve(be)
    print("ready", flush=True)
    signal.pause()
serve(be)
"""


def template(**about):
    return Spec("template", (sys.executable, "-c", TEMPLATE), is_fork_server=True, **about)


def forked(name, **about):
    command = (sys.executable, "-S", "-E", "-c", GOOD)
    return Spec(name, command, int(name.split("@")[1]), fork_server="template", order=name.encode(), **about)


def command_line(pid):
    with open(f"/proc/{pid}/cmdline", "rb") as file:
        return file.read()


def test_workers_are_forked_from_the_template_and_are_the_supervisors_own_children(cluster, tmp_path):
    it = cluster(forked("binder@2"), forked("parser@0"), template()).go()
    table = it.recv_table(lambda t: True)
    assert {row.state for row in table.values()} == {"ready"}
    assert b"rtc.runtime.fork_server" in command_line(table["binder@2"].pid)
    assert (tmp_path / "binder@2.log").read_text() == f"binder@2 of {os.getpid()}\n"
    os.kill(table["binder@2"].pid, signal.SIGKILL)
    assert it.recv(ProcessExited).status == -9
    it.recv_table(lambda t: t["binder@2"].state == "ready" and t["binder@2"].restarts == 1)


def test_a_bug_in_a_forked_worker_is_in_its_log_and_its_status(cluster, tmp_path):
    it = cluster(forked("analyzer@7"), template())
    with pytest.raises(ClusterError, match=r"(?s)analyzer@7 ended with status 1.*ZeroDivisionError: a bug"):
        it.supervisor.start()
    it.supervisor.stop()


def test_a_template_that_does_not_answer_is_replaced_and_then_forks_the_worker(cluster):
    it = cluster(forked("binder@2"), template()).go()
    table = it.recv_table(lambda t: True)
    os.kill(table["template"].pid, signal.SIGSTOP)  # it exists, but does not answer
    os.kill(table["binder@2"].pid, signal.SIGKILL)
    back = it.recv_table(lambda t: t["binder@2"].state == "ready" and t["binder@2"].restarts == 1)
    assert back["template"].restarts == 1
    assert b"rtc.runtime.fork_server" in command_line(back["binder@2"].pid)


def test_what_was_forked_too_late_never_begins_and_leaves_no_zombie(cluster, tmp_path, monkeypatch):
    """The supervisor has given up on it, so no supervisor would watch it: two brokers would use one journal."""
    monkeypatch.setattr("deploy.child.FORK_LIMIT_S", 0.2)
    monkeypatch.setattr("deploy.supervisor.TABLE_S", 0.05)
    late = Spec("template", (sys.executable, "-c", LATE + TEMPLATE), is_fork_server=True)
    it = cluster(forked("broker@0"), late).go()
    os.kill(it.recv_table(lambda t: t["template"].state == "ready")["broker@0"].pid, signal.SIGKILL)
    it.recv_table(lambda t: t["template"].restarts == 1 and t["broker@0"].state == "ready")
    stray = int((tmp_path / "template.log").read_text().split()[1])
    it.recv_table(lambda t: not alive(stray))
    assert (tmp_path / "broker@0.log").read_text().count("broker@0 of") == 2  # before and after


LATE = """
import signal, sys
from rtc.runtime import fork_server as template
fork, first = template._fork_away, iter([True])
def fork_and_say_so_once(child):
    if next(first, False):
        return fork(child)
    print("forked", fork(child), file=sys.stderr, flush=True)
    signal.pause()
template._fork_away = fork_and_say_so_once
"""


def test_without_a_template_workers_start_by_themselves(cluster):
    policy = Policy(short_s=60.0, spared=0, first_delay_s=60.0, longest_delay_s=60.0)
    it = cluster(template(), policy=policy, new_worker=lambda address: forked(f"new@{address}")).go()
    table = it.recv_table(lambda t: True)
    os.kill(table["template"].pid, signal.SIGKILL)
    it.recv_table(lambda t: t["template"].state == "crash loop")
    it.send(SpawnWorker(kind=WorkerKind.PARSER))
    now = it.recv_table(lambda t: "new@0" in t and t["new@0"].state == "ready")
    assert b"signal.pause()" in command_line(now["new@0"].pid)


def fork_servers():
    """One that is forked from another; by its own command it could not start."""
    common = replace(template(), name="common")
    return common, replace(template(), fork_server="common", order=b"template", command=("/no/such/program",))


def test_a_fork_server_is_forked_from_another_and_from_it_all_else(cluster):
    it = cluster(*fork_servers(), forked("binder@2")).go()
    for n in (1, 2):
        table = it.recv_table(lambda t: all(row.state == "ready" for row in t.values()))
        for name in ("template", "binder@2"):
            os.kill(table[name].pid, signal.SIGKILL)
        back = lambda t: all(row.state == "ready" for row in t.values()) and t["binder@2"].restarts == n  # noqa: B023, E731
        it.recv_table(back)
        os.kill(table["common"].pid, signal.SIGKILL)  # the next fork server must come from the new one
        it.recv_table(lambda t: t["common"].restarts == n and t["common"].state == "ready")  # noqa: B023


def test_when_all_are_killed_each_waits_for_its_fork_server(cluster):
    """Each could start by itself; on a slow machine they would then all start for ever."""
    names = [f"binder@{address}" for address in (2, 6, 10)]
    it = cluster(*fork_servers(), *map(forked, names)).go()
    table = it.recv_table(lambda t: all(row.state == "ready" for row in t.values()))
    for name in ("template", "common", *names):
        os.kill(table[name].pid, signal.SIGKILL)
    back = it.recv_table(lambda t: all((row.state, row.restarts) == ("ready", 1) for row in t.values()))
    assert all(b"rtc.runtime.fork_server" in command_line(back[name].pid) for name in names)


def test_what_cannot_be_run_later_is_given_up_and_the_rest_goes_on(cluster):
    lost = Spec("new@0", ("/no/such/program",), 0)
    it = cluster(spec("world", GOOD), policy=Policy(unready_deaths=2), new_worker=lambda address: lost).go()
    it.recv_table(lambda t: True)
    it.send(SpawnWorker(kind=WorkerKind.PARSER))
    table = it.recv_table(lambda t: "new@0" in t and t["new@0"].state == "failed")
    assert table["world"].state == "ready"
    assert "given up after 2 deaths" in it.lines[-1]


def test_a_full_disk_costs_words_but_no_process(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("deploy.supervisor.TABLE_S", 0.05)
    full = OSError(errno.ENOSPC, "No space left on device")
    it = cluster(spec("binder@2", GOOD, 2), template()).go()
    table = it.recv_table(lambda t: t["template"].state == "ready")
    lines = []

    def no_room(what):
        lines.append(what)
        raise full

    hooks = it.supervisor._hooks
    it.supervisor._hooks = replace(hooks, save=no_room, show=no_room)
    (tmp_path / "binder@2.log").unlink()
    (tmp_path / "binder@2.log").symlink_to("/dev/full")
    os.kill(table["binder@2"].pid, signal.SIGKILL)
    table = it.recv_table(lambda t: t["binder@2"].state == "ready" and t["binder@2"].restarts == 1)
    for _ in range(3):
        it.recv_table(lambda t: True)
    assert len([line for line in lines if "No space left" in line]) == 1
    it.supervisor._hooks = hooks  # there is room again
    it.recv_table(lambda t: it.saved[-1] == list(t.values()))
    assert it.saved[-1] == list(table.values())


def test_words_that_find_no_room_are_lost(tmp_path, monkeypatch):
    (tmp_path / "MCM.log").symlink_to("/dev/full")
    it = child.Child(spec("MCM", CHATTY), tmp_path / "MCM.log")
    it.start()
    assert zmq.select([it.output_fd], [], [], 10)[0]
    assert it.read_output()
    it.signal(signal.SIGKILL)
    assert it.reap() == -signal.SIGKILL
    assert child.open_log(tmp_path / "no such folder" / "new@6.log").name == os.devnull


def test_a_long_log_on_a_full_disk_is_cut(tmp_path, monkeypatch):
    monkeypatch.setattr(child, "LOG_LIMIT", 100)
    (tmp_path / "MCM.log").write_text("x" * 101)
    (tmp_path / "MCM.log.1").symlink_to("/dev/full")
    child.limit_log(tmp_path / "MCM.log")
    assert (tmp_path / "MCM.log").read_text() == ""


def test_a_long_log_is_put_aside(tmp_path, monkeypatch):
    monkeypatch.setattr(child, "LOG_LIMIT", 100)
    log = tmp_path / "MCM.log"
    log.write_text("x" * 101)
    child.limit_log(log)
    assert (log.read_text(), (tmp_path / "MCM.log.1").read_text()) == ("", "x" * 101)
