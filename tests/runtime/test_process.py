"""A process's sockets, its wake-up call, and its end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading

import pytest
import zmq

from rtc.protocol import wire
from rtc.protocol.messages import Heartbeat
from rtc.protocol.outcomes import ClusterError
from rtc.protocol.roles import Role
from rtc.runtime import process
from rtc.runtime.keys import KeyRing
from rtc.runtime.priority import real_time
from rtc.runtime.process import Every, Process, inbox, now_s, send
from rtc.runtime.settings import prepare_run_dir


@pytest.fixture
def me(tmp_path):
    made = Process("test", tmp_path)
    yield made
    made.close()


def test_stop_from_another_thread_ends_a_wait_at_once(me):
    threading.Timer(0.01, me.stop).start()
    assert me.wait(timeout_s=30) == []
    assert me.stopping


def test_a_message_travels_to_a_named_peer_and_back(me, tmp_path):
    endpoint = f"ipc://{tmp_path}/x.sock"
    router = me.socket(zmq.ROUTER, endpoint, bind=True)
    dealer = me.socket(zmq.DEALER, endpoint, identity="binder@2")
    assert send(dealer, Heartbeat(name="binder@2"))
    assert me.wait(5) == [router]
    ((who, *parts),) = inbox(router)
    assert who == b"binder@2"
    assert wire.reader(Heartbeat)(parts) == Heartbeat(name="binder@2")
    assert send(router, Heartbeat(name="answer"), to=who)
    assert me.wait(5) == [dealer]


@pytest.mark.parametrize("taken", [False, True], ids=["deleted", "taken by another"])
def test_an_endpoint_whose_file_is_gone_is_bound_again_and_connections_stay(me, tmp_path, taken):
    path = tmp_path / "bound.sock"
    bound = me.socket(zmq.ROUTER, f"ipc://{path}", bind=True)
    known = me.socket(zmq.DEALER, f"ipc://{path}", identity="known")
    assert send(known, Heartbeat(name="known"))
    assert bound.poll(5000)
    bound.recv_multipart()
    path.unlink()
    other = me.context.socket(zmq.ROUTER)
    if taken:
        other.bind(f"ipc://{path}")

    me.beat(now_s() + 2.0)

    other.close(linger=0)
    new = me.socket(zmq.DEALER, f"ipc://{path}", identity="new")
    for dealer in (known, new):
        assert send(dealer, Heartbeat(name="x"))
        assert bound.poll(5000)
        assert bound.recv_multipart()[0] in (b"known", b"new")


def test_no_endpoint_is_bound_in_another_directory_of_the_same_name(me, tmp_path):
    ours = tmp_path / "run"
    ours.mkdir()
    me.socket(zmq.ROUTER, f"ipc://{ours}/bound.sock", bind=True)
    ours.rename(tmp_path / "away")
    ours.mkdir()

    me.beat(now_s() + 2.0)

    assert list(ours.iterdir()) == []


def test_sending_never_waits(me, tmp_path):
    unconnected = me.socket(zmq.DEALER, f"ipc://{tmp_path}/unbound.sock", queue_length=2)
    results = [send(unconnected, Heartbeat(name="x")) for _ in range(10)]
    assert results[0] is True
    assert results[-1] is False


def test_a_newer_bearer_of_an_identity_is_served(me, tmp_path):
    endpoint = f"ipc://{tmp_path}/x.sock"
    router = me.socket(zmq.ROUTER, endpoint, bind=True)
    old = me.socket(zmq.DEALER, endpoint, identity="w")
    send(old, Heartbeat(name="old"))
    assert me.wait(5) == [router]
    list(inbox(router))
    new = me.socket(zmq.DEALER, endpoint, identity="w")
    send(new, Heartbeat(name="new"))
    assert me.wait(5) == [router]
    list(inbox(router))
    send(router, Heartbeat(name="for the new one"), to=b"w")
    assert me.wait(5) == [new]


def test_an_oversized_frame_never_arrives(me, tmp_path):
    endpoint = f"ipc://{tmp_path}/x.sock"
    router = me.socket(zmq.ROUTER, endpoint, bind=True)
    big = me.socket(zmq.DEALER, endpoint, identity="big")
    big.send_multipart([wire.PROTOCOL, bytes(wire.MAX_BYTES + 1)])
    small = me.socket(zmq.DEALER, endpoint, identity="small")
    send(small, Heartbeat(name="small"))
    assert me.wait(5) == [router]
    assert [parts[0] for parts in inbox(router)] == [b"small"]


def test_a_period_is_due_once_and_does_not_catch_up():
    every = Every(0.5)
    assert [every.due(t) for t in (0.0, 0.1, 0.5, 3.0, 3.1, 3.5)] == [True, False, True, True, False, True]
    assert every.left_s(3.6) == pytest.approx(0.4)
    assert every.left_s(9.0) == 0.0


LOOP = textwrap.dedent("""
    import sys
    from rtc.runtime import process
    with process.start("loop", sys.argv[1]) as me:
        me.ready()
        while not me.stopping:
            me.wait(timeout_s=60)
""")


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_loop_in_order(tmp_path, number):
    child = subprocess.Popen(
        [sys.executable, "-c", LOOP, str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "ready\n"
    child.send_signal(number)
    out, log = child.communicate(timeout=10)
    assert child.returncode == 0
    assert set(out.split()) <= {"alive"}  # whether the loop turned before the signal came is chance
    assert "ended in order" in log


@pytest.mark.slow
@pytest.mark.untimed
def test_a_child_dies_with_its_parent(tmp_path):
    parent_code = textwrap.dedent("""
        import os, signal, subprocess, sys
        from rtc.runtime.process import die_with_parent
        me = os.getpid()
        child = subprocess.Popen([sys.executable, "-c", "import signal; print('up', flush=True); signal.pause()"],
                                 stdout=subprocess.PIPE, preexec_fn=lambda: die_with_parent(me))
        child.stdout.readline()
        print(child.pid, flush=True)
        signal.pause()
    """)
    parent = subprocess.Popen([sys.executable, "-c", parent_code], stdout=subprocess.PIPE, text=True)
    pid = int(parent.stdout.readline())
    gone = os.pidfd_open(pid)
    parent.kill()
    parent.wait(10)
    poller = zmq.Poller()
    poller.register(gone, zmq.POLLIN)
    assert poller.poll(10_000), "the child outlived its parent"
    os.close(gone)


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.parametrize("sent", [[], [signal.SIGSTOP], [signal.SIGSTOP, signal.SIGCONT]])
def test_one_that_ends_with_its_parent_is_asked_first_and_killed_when_it_hangs(tmp_path, sent):
    """Also if it is stopped by a signal, or was."""
    child_code = textwrap.dedent("""
        import sys
        from rtc.runtime import process
        with process.start("me", sys.argv[1]) as me:
            me.end_with_parent(0.2)
            assert not me.orphaned
            print("up", flush=True)
            while not me.stopping:
                me.wait(1.0)
            open(sys.argv[1] + "/asked", "w").write(str(me.orphaned))
            while True:
                pass
    """)
    parent_code = textwrap.dedent("""
        import os, signal, subprocess, sys
        from rtc.runtime.process import die_with_parent
        me = os.getpid()
        child = subprocess.Popen([sys.executable, "-c", sys.argv[1], sys.argv[2]],
                                 stdout=subprocess.PIPE, preexec_fn=lambda: die_with_parent(me))
        child.stdout.readline()
        print(child.pid, flush=True)
        signal.pause()
    """)
    command = [sys.executable, "-c", parent_code, child_code, str(tmp_path)]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    gone = os.pidfd_open(int(parent.stdout.readline()))
    for number in sent:
        signal.pidfd_send_signal(gone, number)
    parent.kill()
    parent.wait(10)
    poller = zmq.Poller()
    poller.register(gone, zmq.POLLIN)
    assert poller.poll(10_000), "the child outlived its parent"
    assert (tmp_path / "asked").read_text() == "True"
    os.close(gone)


@pytest.mark.slow
@pytest.mark.untimed
def test_a_process_that_a_person_continues_goes_on(tmp_path):
    code = """if True:
        import os, signal, sys
        from rtc.runtime import process
        with process.start("me", sys.argv[1]) as me:
            me.end_with_parent(0.2)
            os.kill(os.getpid(), signal.SIGCONT)
            print(me.orphaned, me.stopping)
    """
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, timeout=30)
    assert done.stdout == "False False\n"


def test_nice_never_raises(monkeypatch):
    def refuse(by: int) -> int:
        raise PermissionError

    monkeypatch.setattr(os, "nice", refuse)
    assert process.nice(-5) is False


def test_who_may_not_raise_its_priority_goes_on_all_the_same(monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "nice", lambda by: by)
    assert process.raise_priority(1, -5) == "niceness -5"
    monkeypatch.setattr(os, "nice", refuse)
    assert process.raise_priority(1, -5) == "a better priority is not permitted"


def test_a_child_of_one_that_comes_first_does_not():
    code = textwrap.dedent("""
        import os
        from rtc.runtime.process import raise_priority
        words = raise_priority(1, -5)
        child = os.fork()
        if not child:
            os._exit(os.sched_getscheduler(0) != os.SCHED_OTHER)
        print(words, os.waitpid(child, 0)[1])
    """)
    words = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30).stdout
    assert words.endswith(" 0\n"), words


def test_real_time_priority_may_be_given_up_and_requested_again():
    code = textwrap.dedent("""
        from rtc.runtime.process import lower_priority, raise_priority
        print([(raise_priority(1, 0)[:9], lower_priority(), lower_priority()) for _ in range(2)])
    """)
    words = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30).stdout
    permitted, refused = ("real-time", True, False), ("niceness ", False, False)
    assert words.strip() in (str([permitted] * 2), str([refused] * 2)), words


def test_io_threads_run_in_real_time_where_that_is_permitted():
    """Each thread is scheduled by itself: the priority of the process does not reach them."""
    code = textwrap.dedent("""
        import os, zmq
        from rtc.runtime.process import real_time_io
        permitted = True
        try:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        except OSError:
            permitted = False
        context, ends = zmq.Context(), []
        assert real_time_io(context, 1) is permitted
        for kind in (zmq.PULL, zmq.PUSH):
            ends.append(context.socket(kind))
        ends[0].bind("ipc://io.sock")
        ends[1].connect("ipc://io.sock")
        ends[1].send(b"")
        ends[0].recv()  # so the I/O thread has begun
        policies = [os.sched_getscheduler(int(task)) for task in os.listdir("/proc/self/task")]
        assert os.sched_getscheduler(0) == os.SCHED_OTHER
        print(permitted, policies.count(os.SCHED_RR))
    """)
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30, cwd=folder)
    assert done.stdout in ("True 1\n", "True 2\n", "False 0\n"), done.stdout + done.stderr


def test_without_the_permission_io_threads_keep_their_priority(monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with zmq.Context() as context:
        assert process.real_time_io(context, 1) is False
        with context.socket(zmq.DEALER) as socket, real_time(0):
            assert socket.closed is False


def test_an_impossible_run_directory_is_refused_in_a_sentence(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ClusterError, match="choose another"):
        prepare_run_dir(tmp_path / "file")


def test_a_directory_with_other_things_in_it_does_not_become_a_run_directory(tmp_path):
    """A cluster clears away what lies in its directory: that must be another cluster's."""
    (tmp_path / "logs").mkdir()
    (tmp_path / "thesis.db").write_text("mine")
    with pytest.raises(ClusterError, match=r"has logs, thesis\.db; choose a new or empty --run-dir"):
        prepare_run_dir(tmp_path)
    (tmp_path / "supervisor.lock").touch()  # a cluster was here
    assert prepare_run_dir(tmp_path) == tmp_path


def test_keys_may_be_made_in_a_run_directory_before_its_first_cluster(tmp_path):
    for _ in range(2):
        KeyRing(prepare_run_dir(tmp_path)).new("alice", Role.OPERATOR, "tcp://h:1", tmp_path.parent / "alice.key")
        (tmp_path.parent / "alice.key").unlink()
        KeyRing(tmp_path).revoke("alice")


def test_in_a_thread_the_process_keeps_its_signal_handlers_and_its_umask(tmp_path):
    """As in a worker of Ray, whose process belongs to Ray."""
    mask = os.umask(0o022)
    try:
        before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)]
        kept = []

        def run():
            with process.start("worker", tmp_path) as me:
                kept.append(os.umask(0o022))
                kept.append([signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)])
                me.stop()
                me.wait(10.0)  # returns at once
                assert me.stopping

        thread = threading.Thread(target=run)
        thread.start()
        thread.join(10)
        assert kept == [0o022, before]
    finally:
        os.umask(mask)
