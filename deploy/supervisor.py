"""The supervisor: starts, watches and restarts the processes of a cluster.

It waits on file descriptors, a pidfd and a pipe per process, and does not poll. So it reports a death to the broker
within a millisecond. `restarts.delay_s` decides when to restart. The supervisor does not know the purpose of its
processes. It gets a list of `Spec`s, and a function that makes the spec of a new worker, or None at the maximum number.
"""

from __future__ import annotations

import contextlib
import itertools
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zmq

from deploy import hypercube
from deploy.child import Child, ProcessState, Spec, limit_log, reap_orphans
from deploy.more_workers import MoreCommand
from deploy.restarts import DEFAULT, Death, Policy, delay_s
from rtc.protocol import messages as m
from rtc.protocol import wire
from rtc.protocol.outcomes import ClusterError, WireError
from rtc.protocol.versions import VERSION
from rtc.runtime.process import Every, Process, adopt_orphans, inbox, now_s, send
from rtc.runtime.process_table import in_words

START_LIMIT_S = 600.0  # limit for a process to become ready; normally some seconds, more on a slow machine
IDLE_S = 20.0  # a starting process without use of the processor for this time is hung
REPORT_WAITING_S = 10.0  # period of messages about processes that are not ready
END_LIMIT_S = 2.0  # between SIGTERM and SIGKILL, of processor time or of time without any
END_AGAIN_S = 1.0  # period of checks after the first limit
MAX_END_S = 60.0  # the same by the clock
TABLE_S = 1.0  # period of the process table for the broker and of the health checks
STOOD_STILL_S = 3.0  # longer gap between health checks: the supervisor itself, or the machine, was stopped
# A process with `beats` and without output is hung after this processor time, or this time without any, ...
SILENT_S = 4.0
MAX_SILENT_S = 60.0  # ... or this time by the clock
STOPPED_S = 2.0  # a process stopped by a signal for this time is hung
OUTCOMES_S, OUTCOMES_AGAIN_S = 3.0, 0.2  # limit for the outcomes of all commands at the end; period of requests
SHOWN = 10  # maximum number of stopped commands in a message
FORK_AGAIN_S = 0.05  # retry delay, enough to notice the death of a killed fork server


@dataclass
class StoppedWork:
    """The commands and arms that the end of the cluster stopped."""

    commands: list[str] = field(default_factory=list)
    arms: list[str] = field(default_factory=list)  # that were in motion
    doubt: str = ""

    def in_words(self) -> str:
        """As text; empty if nothing was stopped."""
        what = ", ".join([*self.commands[:SHOWN], *([f"{len(self.commands)} commands in all"] * self.too_many)])
        words = [f"halted: {what}" if what else "", f"stopped: {', '.join(self.arms)}" if self.arms else ""]
        return "; ".join(filter(None, [*words, self.doubt]))

    @property
    def too_many(self) -> bool:
        return len(self.commands) > SHOWN


@dataclass(frozen=True)
class Hooks:
    """What a supervisor calls outside of its processes."""

    new_worker: Callable[[int], Spec | None]  # for this node
    new_rehearser: Callable[[int], Spec | None] = lambda number: None  # of this number
    show: Callable[[str], None] = lambda line: None  # a line for people
    save: Callable[[list[m.ProcessRow]], None] = lambda table: None  # the process table, after each change
    # The run directory, every second: the files written again, and a reason to end the cluster or "".
    look: Callable[[float], tuple[list[str], str]] = lambda now: ([], "")
    halt: Callable[[], list[str]] = list  # stops the arms, and returns those that were in motion
    more: MoreCommand | None = None  # runs the user's command line for more workers


class Supervisor:
    """Call `start`, `run` and `stop`, and `stop` also after an exception."""

    def __init__(
        self,
        me: Process,
        specs: Sequence[Spec],
        logs: Path,
        broker: str,
        hooks: Hooks,
        policy: Policy = DEFAULT,
        identity: str = "supervisor",
    ) -> None:
        self._me = me
        self._logs = logs
        self._hooks, self._more = hooks, hooks.more
        self._all_ended: m.AllEnded | None = None
        self._policy = policy
        self._children = {spec.name: Child(spec, logs / f"{spec.name}.log") for spec in specs}
        self._by_fd: dict[int, Child] = {}
        self._broker = me.socket(zmq.DEALER, broker, identity=identity)
        self._read = wire.reader(m.BrokerToSupervisor)
        self._table = Every(TABLE_S)
        self._begun_s = now_s()
        self._up = False  # every process has been ready once
        self._looked_s = 0.0  # time of the last health check
        self._changes = False  # the process table has changed and was not sent yet
        self._unsaved = False  # the table could not be saved: the disk was full

    # --- the three phases ------------------------------------------------------------------------------

    def start(self) -> None:
        """Starts all processes and waits until each is ready. Raises ClusterError, with the log of the failed process.

        This phase does not restart processes.
        """
        self._send(m.ProcessHello(name="supervisor", protocol=VERSION))
        adopt_orphans()  # workers are forked by their fork server
        self._start_waiting()
        report_due = Every(REPORT_WAITING_S, now_s() + REPORT_WAITING_S)
        while waiting := [c for c in self._children.values() if c.state != ProcessState.READY]:
            if self._me.stopping:
                raise ClusterError("stopped before the cluster was ready")
            if report_due.due(now_s()):
                self._show(f"waiting for {', '.join(child.spec.name for child in waiting)}")
            self._once()
        self._up = self._changes = True
        self._send_changes()

    def run(self) -> None:
        """Watches, restarts and follows orders of the broker, until `me.stopping`."""
        while not self._me.stopping:
            self._once()

    def stop(self, limit_s: float = END_LIMIT_S) -> StoppedWork:
        """Halt everything, wait for rest and for the outcomes of all commands, then end all processes: SIGTERM, and
        SIGKILL for each that has not ended within the limit."""
        stopped = self._halt_all() if self._up else StoppedWork()
        self._up = False
        if self._more is not None:
            self._more.end()
        running = [child for child in self._children.values() if child.pid]
        for child in running:
            self._end(child, limit_s)
        while any(child.pid for child in running):
            self._kill_overdue()
            left_s = max(0.0, min((c.kill_at_s for c in running if c.pid), default=0.0) - now_s())
            self._handle_pending(left_s or 0.1)
        self._save_table()
        return stopped

    def _halt_all(self) -> StoppedWork:
        """Let the broker end its commands and report them; halt the arms also directly, because the broker may be dead.

        Each wait has a limit. The MCM also brakes by itself when it receives SIGTERM.
        """
        self._all_ended = None
        self._send(m.Shutdown())
        arms = self._hooks.halt()
        broker = self._children.get("broker")
        if broker is None or broker.state is ProcessState.FAILED:
            return StoppedWork(arms=arms)
        ask_again, limit_s = Every(OUTCOMES_AGAIN_S), now_s() + OUTCOMES_S
        while self._all_ended is None and now_s() < limit_s:
            if ask_again.due(now_s()):
                self._send(m.Shutdown())  # a broker that was restarted meanwhile has not received it
            self._handle_pending(OUTCOMES_AGAIN_S)
            self._start_waiting()
        ended = self._all_ended or m.AllEnded(commands=[])
        stopped = StoppedWork(commands=ended.commands, arms=sorted({*arms, *ended.arms}))
        if self._all_ended is None:
            stopped.doubt = f"the broker has not ended its commands within {OUTCOMES_S:.0f} s"
        if words := stopped.in_words():
            self._show(words)
        return stopped

    # --- one turn of the loop --------------------------------------------------------------------------

    def _once(self) -> None:
        self._handle_pending(self._timeout_s())
        self._start_waiting()
        self._send_changes()
        self._kill_overdue()
        if self._table.due(now := now_s()):
            self._look_after_all(now)

    def _handle_pending(self, timeout_s: float) -> None:
        """Handles all pending input once. It starts no process: that could get the file descriptors of a process that
        ended in this iteration, and be mistaken for it."""
        for source in self._me.wait(timeout_s):
            if source is self._broker:
                self._listen()
            elif self._more is not None and source == self._more.exited_fd:
                self._more_ended(self._more)
            elif (child := self._by_fd.get(source)) is None:
                pass  # it ended earlier in this iteration
            elif source == child.output_fd:
                self._read_output(child)
            else:
                self._exited(child)

    def _timeout_s(self) -> float:
        """Time (s) until the next timed action."""
        now = now_s()
        starts = (c.start_at_s - now for c in self._children.values() if c.waits and self._may_start(c))
        kills = (c.kill_at_s - now for c in self._children.values() if c.state == ProcessState.ENDING)
        return max(0.0, min(self._table.left_s(now), *starts, *kills, 3600.0))

    def _start_waiting(self) -> None:
        for child in self._children.values():
            if child.waits and now_s() >= child.start_at_s and self._may_start(child):
                self._spawn(child)
                self._changes = True

    def _may_start(self, child: Child) -> bool:
        """False while a process must wait for its fork server.

        A start by its own command takes as long as that of the fork server, and many at once overload a slow machine.
        Without a working fork server, processes start one at a time.
        """
        template = self._children.get(child.spec.fork_server)
        if template is None or template.state == ProcessState.READY:
            return True
        if template.state not in (ProcessState.LOOPING, ProcessState.FAILED):
            return False
        return not any(
            c.state == ProcessState.STARTING and c.spec.fork_server == template.spec.name
            for c in self._children.values()
        )

    def _kill_overdue(self) -> None:
        for child in self._children.values():
            if child.state == ProcessState.ENDING and (now := now_s()) >= child.kill_at_s:
                child.look(now)
                child.kill_at_s = now + END_AGAIN_S
                if _ended_too_late(child, now):
                    child.signal(signal.SIGKILL)

    def _look_after_all(self, now: float) -> None:
        """Once a second: sends the table, checks directory and logs, reaps orphans, kills hung processes."""
        if self._up:
            self._send_table()
        stood_still = now - self._looked_s > STOOD_STILL_S  # then missing output is not the fault of the processes
        self._looked_s = now
        self._look_at_directory(now)
        if self._unsaved:
            self._save_table()
        reap_orphans([*(child.pid for child in self._children.values()), self._more.pid if self._more else 0])
        if self._more is not None:
            limit_log(self._more.log)
            self._more.end_overdue(now)
        for child in self._children.values():
            limit_log(child.log)
            if stood_still:
                child.last_output_s = now
            if child.pid:
                child.look(now)
            if (self._up or child.state == ProcessState.STARTING) and (why := _hung(child, now)):
                self._kill_hung(child, why)

    def _look_at_directory(self, now: float) -> None:
        again, why = self._hooks.look(now)
        if again:
            self._show(f"{', '.join(again)} was deleted: written again")
        if why and not self._me.stopping:
            self._show(f"{why}: everything is halted, and the cluster ends")
            self._me.stop()

    def _kill_hung(self, child: Child, why: str) -> None:
        if not self._up:
            raise ClusterError(f"{child.spec.name} is {why}.\n{_log_of(child)}")
        self._show(f"{child.spec.name} (pid {child.pid}) is killed: {why}")
        child.signal(signal.SIGKILL)

    # --- what happens to processes ---------------------------------------------------------------------

    def _spawn(self, child: Child) -> None:
        template = self._children.get(child.spec.fork_server)
        forks = template if template is not None and template.state == ProcessState.READY else None
        try:
            child.start(forks.line if forks else None)
        except OSError as error:
            self._not_started(child, forks, error)
            return
        for fd in (child.exited_fd, child.output_fd):
            self._by_fd[fd] = child
            self._me.poller.register(fd, zmq.POLLIN)

    def _not_started(self, child: Child, template: Child | None, error: OSError) -> None:
        name = child.spec.name
        if template is not None:
            self._show(f"the fork server does not fork {name} ({error}); killing it")
            template.signal(signal.SIGKILL)  # it may be in the middle of the order
            child.start_at_s = now_s() + FORK_AGAIN_S
        elif not self._up:
            raise ClusterError(f"{name} cannot be started: {error}") from error
        else:
            child.deaths.append(Death(now_s(), was_ready=False))
            delay = delay_s(self._policy, [*child.deaths], child.was_ready)
            self._schedule_restart(child, f"{name} cannot be started: {error}", delay)

    def _read_output(self, child: Child) -> None:
        is_ready = child.read_output()
        for words in child.take_news():
            self._show(f"{child.spec.name}: {words}")
            self._changes = True
        if child.output_over:
            self._forget(child.output_fd)
        if is_ready and child.state == ProcessState.STARTING:
            took_s = now_s() - (self._begun_s if not self._up else child.since_s)
            child.become(ProcessState.READY)
            child.was_ready = True
            self._show(f"{child.spec.name:<14} ready  {took_s:5.2f} s  pid {child.pid}")
            self._changes = True
            if child.spec.name == "broker" and self._up:
                self._send(m.ProcessHello(name="supervisor", protocol=VERSION))

    def _exited(self, child: Child) -> None:
        """Reports the death to the broker first, because work of the process waits for it."""
        self._read_output(child)  # its last output
        self._forget(child.exited_fd)
        self._forget(child.output_fd)
        pid, state, name, lived_s = child.pid, child.state, child.spec.name, now_s() - child.since_s
        status = child.reap()
        if state == ProcessState.ENDING:
            child.become(ProcessState.ENDED)
            self._send(m.ProcessExited(name=name, pid=pid, status=status))
            if self._up:  # a worker that has retired
                del self._children[name]
                self._show(f"{name} has retired")
                self._changes = True
            return
        child.deaths.append(Death(now_s(), was_ready=state == ProcessState.READY, lived_s=lived_s))
        delay = delay_s(self._policy, [*child.deaths], child.was_ready) if self._up else None
        self._send(m.ProcessExited(name=name, pid=pid, status=status, called=child.called))
        if not self._up:
            raise ClusterError(f"{name} {in_words(status)} before the cluster was ready.\n{_log_of(child)}")
        self._schedule_restart(child, f"{name} {in_words(status)}", delay)

    def _schedule_restart(self, child: Child, what: str, delay: float | None) -> None:
        if delay is None:
            child.become(ProcessState.FAILED)
            self._show(f"{what}; given up after {len(child.deaths)} deaths, see {child.log}")
        else:
            child.become(ProcessState.LOOPING if delay else ProcessState.WAITING)
            child.restarts += 1
            child.start_at_s = now_s() + delay
            self._show(f"{what}; restarting" + (f" in {delay:g} s" if delay else ""))
        self._changes = True

    def _forget(self, fd: int) -> None:
        if self._by_fd.pop(fd, None):
            self._me.poller.unregister(fd)

    def _end(self, child: Child, limit_s: float) -> None:
        child.look(now_s())
        child.become(ProcessState.ENDING)
        child.kill_at_s = now_s() + limit_s
        child.signal(signal.SIGTERM)

    # --- to and from the broker ------------------------------------------------------------------------

    def _send(self, message: Any) -> None:
        if not send(self._broker, message):
            self._me.log.warning("no room for %s to the broker", type(message).__name__)

    def _send_table(self) -> None:
        self._send(m.ProcessTable(processes=self.table(), asked=self._more.asked() if self._more else []))

    def _send_changes(self) -> None:
        """Saves and sends a changed table. Called after restarts, which are more urgent."""
        if self._changes:
            self._changes = False
            self._save_table()
            if self._up:
                self._send_table()

    def _save_table(self) -> None:
        """Saves the table for people. On a full disk it is saved later."""
        try:
            self._hooks.save(self.table())
        except OSError as error:
            if not self._unsaved:
                self._show(f"the process table cannot be saved until there is room again: {error}")
            self._unsaved = True
        else:
            self._unsaved = False

    def _show(self, line: str) -> None:
        with contextlib.suppress(OSError):  # a full disk or a closed output
            self._hooks.show(line)

    def table(self) -> list[m.ProcessRow]:
        return [
            m.ProcessRow(
                name=child.spec.name,
                pid=child.pid,
                state=child.state.value,
                restarts=child.restarts,
                since_s=child.since_s,
                node=child.spec.node,
                notes=[*child.notes, *_last_words(child)],
            )
            for child in self._children.values()
        ]

    def _listen(self) -> None:
        for parts in inbox(self._broker):
            try:
                self._obey(self._read(parts))
            except WireError as error:
                self._me.log.warning("dropped a message of the broker: %s", error)

    def _obey(self, order: m.BrokerToSupervisor) -> None:
        match order:
            case m.KillProcess(name=name, pid=pid, why=why):
                child = self._children.get(name)
                if child and child.pid == pid:  # otherwise it has ended meanwhile
                    self._show(f"{name} (pid {pid}) is killed: {why}")
                    child.signal(signal.SIGKILL)
            case m.SpawnWorker(kind=kind, rehearses=rehearses):
                spec = self._new_rehearser() if rehearses else self._hooks.new_worker(self._free_address(kind))
                if spec is not None:
                    self._children[spec.name] = Child(spec, self._logs / f"{spec.name}.log")
            case m.RetireWorker(name=name):
                child = self._children.get(name)
                if child and child.spec.node is not None:
                    self._retire(child)
            case m.RequestWorkers():
                self._ask_more(order)
            case m.Declined(refusal=refusal):
                self._show(f"the broker refuses the supervisor: {refusal.message}")
            case m.Shutdown():
                self._show("the broker asks the cluster to end")
                self._me.stop()
            case m.AllEnded():
                self._all_ended = order

    def _free_address(self, kind: m.WorkerKind) -> int:
        workers = (c.spec for c in self._children.values() if not c.spec.name.startswith(f"{m.REHEARSER}@"))
        return hypercube.next_free(kind, {spec.node for spec in workers if spec.node is not None})

    def _new_rehearser(self) -> Spec | None:
        number = next(n for n in itertools.count() if f"{m.REHEARSER}@{n}" not in self._children)
        return self._hooks.new_rehearser(number)

    def _ask_more(self, order: m.RequestWorkers) -> None:
        if self._more is None or self._more.pid:
            return
        self._show(self._more.start(order))
        if self._more.exited_fd >= 0:
            self._me.poller.register(self._more.exited_fd, zmq.POLLIN)
        self._changes = True

    def _more_ended(self, more: MoreCommand) -> None:
        self._me.poller.unregister(more.exited_fd)
        if words := more.reap():
            self._show(words)
        self._changes = True

    def _retire(self, child: Child) -> None:
        if child.pid:
            self._end(child, END_LIMIT_S)
        else:
            del self._children[child.spec.name]
        self._changes = True


def _hung(child: Child, now: float) -> str:
    """The reason to kill a process, or "": not ready in time, stopped by a signal, or in an endless loop.

    A worker may be silent for the length of a job; the broker limits that. A starting process that uses the processor
    is not killed, because a restart on a slow machine would take as long again.
    """
    silent_s = now - max(child.last_output_s, child.since_s)
    idle_s = now - max(child.last_output_s, child.since_s, child.busy_s)
    if child.state == ProcessState.STARTING:
        if silent_s > START_LIMIT_S:
            return f"not ready within {silent_s:.0f} s"
        return f"not ready, and hung: it has not used the processor for {idle_s:.1f} s" if idle_s > IDLE_S else ""
    if child.state != ProcessState.READY:
        return ""
    if child.stopped_since_s and (stopped_s := now - child.stopped_since_s) >= STOPPED_S:
        return f"hung, stopped for {stopped_s:.1f} s"
    hangs = child.worked_s >= SILENT_S or idle_s > SILENT_S or silent_s > MAX_SILENT_S
    return f"hung, silent for {silent_s:.1f} s" if child.spec.beats and silent_s > SILENT_S and hangs else ""


def _ended_too_late(child: Child, now: float) -> bool:
    """Whether a process that is to end hangs. On a busy machine one that does not hang needs longer too."""
    idle_s, passed_s = now - max(child.since_s, child.busy_s), now - child.since_s
    return child.worked_s > END_LIMIT_S or idle_s >= END_LIMIT_S or passed_s > MAX_END_S


def _last_words(child: Child) -> list[str]:
    """The last log line of a process in a crash loop or given up, as a note."""
    ends = child.log_tail(1) if child.state in (ProcessState.LOOPING, ProcessState.FAILED) else ""
    return [f"{child.state.value}: {ends[:300]}"] if ends else []


def _log_of(child: Child) -> str:
    tail = child.log_tail() or "(the log is empty)"
    return f"The end of {child.log}:\n" + "\n".join(f"    {line}" for line in tail.splitlines())
