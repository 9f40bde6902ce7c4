"""One cluster in its run directory: exclusive start, files, process specs, and shutdown.

    settings.json  supervisor.json  lease.key  logs/NAME.log  *.sock  *.db
    previous/         databases and logs of the last cluster; previous-2/, previous-3/: of earlier ones
    supervisor.lock   locked by the supervisor; the kernel releases the lock when it dies

A new cluster begins with a new world: the databases and logs of the last one move to previous/.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn

import msgspec
import zmq

from deploy import common_imports, hypercube
from deploy.child import Spec
from deploy.directory import Directory, claim_path
from deploy.more_workers import MoreCommand
from deploy.supervisor import END_LIMIT_S, OUTCOMES_S, Hooks, Supervisor
from rtc.client.halt import HaltLine
from rtc.protocol.messages import REHEARSER, ProcessRow
from rtc.protocol.outcomes import ClusterError, NoCluster, RtcError
from rtc.protocol.subsystems import ARMS, CAMERAS, Subsystem
from rtc.runtime import handover, process, process_table
from rtc.runtime.settings import LAST_WORDS, LOCK, Settings, prepare_run_dir, shell_command
from rtc.world import lease

LOGS = "logs"
TEMPLATE = "template"  # process name of the fork server of workers; NAME-template: that of the process NAME
FROM_COMMON = {"fork_server": common_imports.NAME}
PREVIOUS = "previous"
RUNS_KEPT = 3  # in previous, previous-2, previous-3
MAX_DOWN_S = 120.0  # for a supervisor to end all, on a busy machine
ERROR = "the cluster did not come up:"  # the line of a detached process before its error
REST_S = 1.5  # limit for the arms to come to rest when the cluster ends
# Of the supervisor: it needs little time, and work of a dead process waits for it. Real-time if permitted.
RANK, NICENESS = 1, -10


def specs(settings: Settings, fd: int = -1) -> list[Spec]:
    """The processes of a cluster. `fd`: the handover file that each inherits (rtc.runtime.handover)."""
    made = [
        _spec(common_imports.NAME, "deploy.common_imports", settings, is_fork_server=True),
        _spec(TEMPLATE, "workers", settings, "--template", is_fork_server=True, **FROM_COMMON),
        *_with_template("broker", "broker", settings),
        *_with_template("world", "rtc.world", settings),
        *chain.from_iterable(_subsystem(one, settings) for one in settings.subsystems if one.module),
        *([_spec("gate", "broker.gateway.gateway", settings, beats=True)] if settings.listen else []),
        *([_recorder(settings)] if settings.record else []),
        *(worker(settings, address) for address in _first_workers(settings)),
        _spec("cli-template", "rtc.apps.cli.template", settings, **FROM_COMMON),
    ]
    return [_hand(spec, fd) for spec in made]


def _recorder(settings: Settings) -> Spec:
    """It is ready before the cluster is, so that the first command is recorded."""
    return _spec("recorder", "rtc.apps.observers.recorder", settings, "--into", settings.record, beats=True)


def _hand(spec: Spec, fd: int) -> Spec:
    """The spec with the handover file inherited, if there is one, and the order for the fork server with the common
    imports."""
    if fd >= 0:
        spec = replace(spec, command=(*spec.command, handover.OPTION, str(fd)), fds=(fd,))
    if spec.fork_server == common_imports.NAME:
        spec = replace(spec, order=common_imports.order_of(spec.name, spec.command))
    return spec


def _first_workers(settings: Settings) -> list[int]:
    """The addresses of the first workers: the whole cube, or `least_workers` of each kind."""
    if settings.least_workers is None:
        return list(hypercube.addresses(settings.dim))
    return sorted(a for kind in hypercube.KINDS for a in hypercube.replicas(kind, settings.least_workers))


def worker(settings: Settings, address: int) -> Spec:
    """The spec of the worker at a cube address."""
    kind = hypercube.kind_of(address)
    arguments = ("--kind", kind, "--node", str(address))
    order = msgspec.json.encode({"kind": kind, "node": address})
    name = hypercube.name_of(address)
    about = {"node": address, "fork_server": TEMPLATE, "order": order}
    return _spec(name, "workers", settings, *arguments, **about)


def new_rehearser(settings: Settings, number: int, fd: int) -> Spec:
    """The spec of a rehearser, which performs TEST sentences on paper."""
    order = msgspec.json.encode({"node": number})
    about = {"node": number, "fork_server": TEMPLATE, "order": order}
    return _hand(_spec(f"{REHEARSER}@{number}", "workers", settings, "--rehearser", str(number), **about), fd)


def new_worker(settings: Settings, address: int, fd: int) -> Spec | None:
    """The spec of a further worker. None if the address belongs to workers on other machines. Then this machine has its
    maximum number of workers of that kind, and one of them is starting."""
    return None if address >= settings.first_remote_node else _hand(worker(settings, address), fd)


def _subsystem(one: Subsystem, settings: Settings) -> list[Spec]:
    """The simulation of arms has a fork server. A user's module starts by its command, and ends as Python ends."""
    if one.module == ARMS.module:
        return _with_template(one.name, one.module, settings, "--name", one.name)
    common = FROM_COMMON if one.module == CAMERAS.module else {}
    return [_spec(one.name, one.module, settings, "--name", one.name, beats=True, **common)]


def _with_template(name: str, module: str, settings: Settings, *more: str) -> list[Spec]:
    """A singleton process and its fork server, of which the first one is forked too: all is imported once."""
    its_template = f"{name}-{TEMPLATE}"
    forked: dict[str, Any] = {"fork_server": its_template, "order": b"start"}
    return [
        _spec(its_template, module, settings, *more, "--template", is_fork_server=True, **FROM_COMMON),
        _spec(name, module, settings, *more, beats=True, **forked),
    ]


def _spec(name: str, module: str, settings: Settings, *more: str, **about: Any) -> Spec:
    # -P: a folder `broker` in the working directory must not shadow our package.
    return Spec(name, (sys.executable, "-P", "-m", module, "--run-dir", settings.run_dir, *more), **about)


# --- up ------------------------------------------------------------------------------------------------


def up(settings: Settings, show: Callable[[str], None], detach_output: bool = False) -> None:
    """Starts the cluster and runs it until SIGTERM, SIGINT or a shutdown request.

    `detach_output`: redirect stdout and stderr to the log when the cluster is ready. Raises ClusterError, with all
    processes stopped, when it does not start.
    """
    begun_s = process.now_s()
    settings = msgspec.structs.replace(settings, run=secrets.token_hex(4))
    run_dir = prepare_run_dir(settings.path)
    with _lock(run_dir) as lock, claim_path(run_dir):
        logs = run_dir / LOGS
        empty = process_table.Table(pid=os.getpid(), cluster=settings.run, started_at=time.time())

        def save(rows: list[ProcessRow]) -> None:
            msgspec.structs.replace(empty, processes=rows).save(run_dir)

        try:
            _clean(run_dir)
            settings.save()
            key = secrets.token_bytes(lease.KEY_BYTES)
            write_key(run_dir, key)
            logs.mkdir(mode=0o700)
            save([])
        except OSError as error:  # a full disk, most often
            raise ClusterError(f"no cluster can be started in {run_dir}: {error}") from error
        given = handover.Handover.make(settings, key, secrets.token_hex(8))
        files: dict[str, Callable[[], object]] = {
            "settings.json": settings.save,
            lease.KEY_FILE: lambda: write_key(run_dir, key),
            LOGS: lambda: logs.mkdir(mode=0o700),
        }
        directory = Directory(run_dir, lock, files)
        with process.start("supervisor", run_dir) as me:
            process.real_time_io(me.context, RANK)
            process.raise_priority(RANK, NICENESS)
            hooks = Hooks(
                new_worker=lambda address: new_worker(settings, address, given.fd),
                new_rehearser=lambda number: new_rehearser(settings, number, given.fd),
                show=show,
                save=save,
                look=directory.look,
                halt=lambda: _halt_arms(settings),
                more=MoreCommand(settings.more, logs / "more.log") if settings.more else None,
            )
            endpoint, identity = settings.endpoint("supervisor"), given.identity("supervisor")
            supervisor = Supervisor(me, specs(settings, given.fd), logs, endpoint, hooks, identity=identity)
            files[process_table.FILE] = lambda: save(supervisor.table())
            try:
                _start(supervisor, settings)
                show(f"ready in {process.now_s() - begun_s:.2f} s: cluster {settings.run} in {run_dir}")
                if detach_output:
                    _let_go(logs / "supervisor.log")
                process.freeze_heap()
                supervisor.run()
            finally:
                stopped = supervisor.stop(END_LIMIT_S * settings.timeout_scale)
                if directory.ours():
                    _leave_word(run_dir, stopped.in_words())
                    _remove_traces(run_dir)


def _halt_arms(settings: Settings) -> list[str]:
    """Halts everything by the halt sockets; returns the arms that were in motion.

    Empty also without an answer. The MCM receives SIGTERM next and then brakes by itself.
    """
    with zmq.Context() as context:
        line = HaltLine(context, settings)
        try:
            return line.halt(timeout_s=REST_S).moving
        except ClusterError:
            return []
        finally:
            line.close()


def _leave_word(run_dir: Path, words: str) -> None:
    """Writes the file that `rtc down` reads after the end of the supervisor."""
    with contextlib.suppress(OSError):
        (run_dir / LAST_WORDS).write_text(words)


def _start(supervisor: Supervisor, settings: Settings) -> None:
    try:
        supervisor.start()
    except ClusterError:
        # The most frequent cause is the cell file: its error replaces this one. The import brings numpy and would
        # delay the start of the processes if it came earlier.
        from rtc.model.cells.cell import Cell

        Cell.load(settings.cell)
        raise


def up_detached(settings: Settings, show: Callable[[str], None]) -> None:
    """Runs `up` in a forked process with its own session; returns when the cluster is ready.

    Passes its output to `show`. Raises ClusterError when it does not start, with the error of that process.
    """
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(read)
        _be_detached(settings, show, write)
    os.close(write)
    ready = False
    error = ""
    try:
        with open(read) as lines:
            for line in lines:  # ends when the child redirects its output or dies
                if line.rstrip() == ERROR:
                    error = lines.read().rstrip()
                    break
                show(line.rstrip())
                ready = ready or line.startswith("ready in")
    except KeyboardInterrupt:
        os.kill(pid, signal.SIGTERM)
        raise
    if not ready:
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        raise ClusterError(error or f"the cluster did not come up (status {status})")


def _be_detached(settings: Settings, show: Callable[[str], None], output: int) -> NoReturn:
    status = 1
    try:
        os.setsid()
        null = os.open(os.devnull, os.O_RDONLY)
        for mine, standard in ((null, 0), (output, 1), (output, 2)):
            os.dup2(mine, standard)
        os.close(null)
        os.close(output)
        up(settings, show, detach_output=True)
        status = 0
    except RtcError as error:
        print(ERROR, error, sep="\n", file=sys.stderr)
    except BaseException:
        traceback.print_exc()
    finally:
        process.leave(status)


def _let_go(log: Path) -> None:
    """Redirects stdout and stderr to a log. The parent process reads end of file, and so knows that all is ready."""
    sys.stdout.flush()
    sys.stderr.flush()
    fd = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    os.dup2(fd, 1)
    os.dup2(fd, 2)
    os.close(fd)


# --- down ----------------------------------------------------------------------------------------------


def down(run_dir: Path, limit_s: float = REST_S + OUTCOMES_S + END_LIMIT_S + 3.0) -> tuple[int, str]:
    """Ends the cluster in this directory. Returns the pid of its supervisor and a text about what was stopped.

    SIGKILL follows SIGTERM after `limit_s`. A supervisor that was stopped by a signal continues, to end in order.
    Raises NoCluster.
    """
    running = _running(run_dir)
    if running is None:
        if run_dir.is_dir():
            with _lock(run_dir):  # raises ClusterError while a cluster starts
                _remove_traces(run_dir)
        raise NoCluster(f"no cluster is running in {run_dir}")
    pid, gone = running
    try:
        for number, wait_s in ((signal.SIGTERM, limit_s), (signal.SIGKILL, 2.0)):
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(gone, number)
                signal.pidfd_send_signal(gone, signal.SIGCONT)
            if _ended(pid, gone, wait_s):
                break
    finally:
        os.close(gone)
    words = ""
    with contextlib.suppress(OSError):
        words = (run_dir / LAST_WORDS).read_text()
    with contextlib.suppress(ClusterError), _lock(run_dir):  # unless the next cluster has started already
        _remove_traces(run_dir)
    return pid, words


def _running(run_dir: Path) -> tuple[int, int] | None:
    """(pid, pidfd) of the supervisor that holds this directory."""
    pid = process_table.supervisor_pid(run_dir)
    if pid is None:
        return None
    try:
        gone = os.pidfd_open(pid)
    except OSError:
        return None
    # The pid may have been reused: it is the supervisor's only while the lock is held.
    try:
        with _lock(run_dir):
            os.close(gone)
            return None
    except ClusterError:
        return pid, gone


def _ended(pid: int, pidfd: int, wait_s: float) -> bool:
    """Wait for the end of a process; again for `wait_s` if it has used the processor, at most MAX_DOWN_S."""
    poller = zmq.Poller()
    poller.register(pidfd, zmq.POLLIN)
    until_s = process.now_s() + MAX_DOWN_S
    while process.now_s() < until_s:
        with contextlib.suppress(OSError):
            before = process.usage(pid)
            if not poller.poll(int(1000 * wait_s)) and process.usage(pid) != before:
                continue
        break
    return bool(poller.poll(0))


# --- the directory -------------------------------------------------------------------------------------


@contextlib.contextmanager
def _lock(run_dir: Path) -> Iterator[int]:
    """Locks the directory for one cluster; gives the descriptor of the lock. Raises ClusterError with the owner."""
    with open(run_dir / LOCK, "a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            end = shell_command("rtc down", run_dir)
            raise ClusterError(
                f"a cluster is already running in {run_dir}: {_owner(run_dir)}; end it with: {end}; "
                "or start another one beside it, with another --run-dir"
            ) from None
        yield lock.fileno()


def _owner(run_dir: Path) -> str:
    pid = process_table.supervisor_pid(run_dir)
    return "its supervisor is just starting or ending" if pid is None else f"supervisor pid {pid}"


def _clean(run_dir: Path) -> None:
    """Moves the files of the last cluster to previous/ and removes the oldest."""
    _remove_traces(run_dir)
    previous = run_dir / PREVIOUS
    older = [run_dir / f"{PREVIOUS}-{n}" for n in range(2, RUNS_KEPT + 1)]
    shutil.rmtree(older[-1], ignore_errors=True)
    for newer, path in reversed(list(zip([previous, *older], older, strict=False))):
        if newer.exists():
            newer.rename(path)
    previous.mkdir(mode=0o700)
    databases = [path for end in ("", "-wal", "-shm", ".damaged-*") for path in run_dir.glob(f"*.db{end}")]
    for left in (*databases, run_dir / LOGS, run_dir / LAST_WORDS):
        if left.exists():
            left.rename(previous / left.name)


def _remove_traces(run_dir: Path) -> None:
    """Removes the signs of a running cluster: sockets, which killed processes leave behind, and the process table."""
    (run_dir / process_table.FILE).unlink(missing_ok=True)
    for socket in run_dir.glob("*.sock"):
        socket.unlink(missing_ok=True)


def write_key(run_dir: Path, key: bytes) -> None:
    """Writes the lease key, readable by its owner only. Raises OSError."""
    path = run_dir / lease.KEY_FILE
    path.unlink(missing_ok=True)
    fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with open(fd, "wb") as file:
        file.write(key)
