"""Who is alive, and who gets the job. Pure: the time is an argument; it knows neither commands nor sockets.

Workers of a kind share one queue. A worker that answers in microseconds is given several jobs in one message and
one such handful ahead, so that it never waits for the broker; a slow one is given one job at a time, so that none
lies with a busy worker while another is idle. Jobs are done in the order given, so the first one a worker holds is
the one in its hands.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import NamedTuple

from broker.effects import DispatchJob
from rtc.messages import WorkerKind

HANDFUL_S = 0.002  # of work that may go to a worker in one message
HANDFUL_MAX = 64
SLOW_S = 0.005  # jobs longer than this are given one at a time
# An analyzer waits for the world, which may be away for half of that.
DEADLINE_S = {WorkerKind.PARSER: 3.0, WorkerKind.ELABORATOR: 15.0, WorkerKind.BINDER: 15.0, WorkerKind.ANALYZER: 10.0}
SILENCE_S = 3.0  # an idle worker says something every half second
QUEUE_LIMIT_S = 60.0  # longest wait of a job for a worker of its kind


Queue = OrderedDict[str, tuple[float, DispatchJob]]  # job -> since when it waits; the oldest first


class Lost(NamedTuple):
    """A job whose worker is gone. `in_hand`: it was being worked on."""

    job: DispatchJob
    in_hand: bool


class Worker:
    __slots__ = ("done", "heard_at_s", "held", "kind", "mean_s", "name", "node", "pid", "retiring", "since_s")

    def __init__(self, name: str, node: int, kind: WorkerKind, pid: int, now: float) -> None:
        self.name, self.node, self.kind, self.pid = name, node, kind, pid
        self.held: dict[str, DispatchJob] = {}  # in order; the first is in its hands
        self.since_s = now  # since when the first has been in its hands
        self.heard_at_s = now
        self.done = 0
        self.mean_s = 1.0  # of a job; unknown is slow, until shown otherwise
        self.retiring = False  # told to end: it gets no more jobs

    @property
    def handful(self) -> int:
        return max(1, min(HANDFUL_MAX, int(HANDFUL_S / max(self.mean_s, 1e-6))))

    @property
    def room(self) -> int:
        if self.retiring:
            return 0
        most = 1 if self.mean_s > SLOW_S else 2 * self.handful
        return most - len(self.held)


class Roster:
    def __init__(self) -> None:
        self.workers: dict[str, Worker] = {}
        self.queues: dict[WorkerKind, Queue] = {kind: OrderedDict() for kind in WorkerKind}

    # --- workers come and go --------------------------------------------------------------------------

    def hello(self, name: str, node: int, kind: WorkerKind, pid: int, now: float) -> list[Lost]:
        """A worker is ready. What its name held before is lost, whether the process is a new one or not."""
        lost = self.gone(name)
        self.workers[name] = Worker(name, node, kind, pid, now)
        return lost

    def gone(self, name: str) -> list[Lost]:
        worker = self.workers.pop(name, None)
        if worker is None:
            return []
        return [Lost(job, in_hand=first == 0) for first, job in enumerate(worker.held.values())]

    def heard(self, name: str, now: float) -> bool:
        """Any sign of life. False: nobody of that name is known, it should say hello."""
        worker = self.workers.get(name)
        if worker is not None:
            worker.heard_at_s = now
        return worker is not None

    def answered(self, name: str, job: str, attempt: int, took_s: float, now: float) -> None:
        worker = self.workers.get(name)
        if worker is None:
            return
        worker.heard_at_s = worker.since_s = now
        held = worker.held.get(job)
        if held is not None and held.attempt == attempt:  # a late answer to an earlier attempt frees nothing
            del worker.held[job]
            worker.done += 1
            worker.mean_s = took_s if worker.done == 1 else 0.8 * worker.mean_s + 0.2 * took_s

    # --- jobs -----------------------------------------------------------------------------------------

    def submit(self, job: DispatchJob, now: float) -> None:
        self.queues[job.kind][job.job] = (now, job)

    def cancel(self, job: str) -> str:
        """Nobody wants it any more. Returns the worker that holds it and should be told, or an empty name."""
        for queue in self.queues.values():
            queue.pop(job, None)
        return next((worker.name for worker in self.workers.values() if job in worker.held), "")

    def assign(self, now: float) -> Iterator[tuple[str, list[DispatchJob]]]:
        """Give out what can be given out: (worker, jobs) pairs, the least loaded worker first."""
        for kind, queue in self.queues.items():
            while queue:
                free = [w for w in self.workers.values() if w.kind is kind and w.room > 0]
                if not free:
                    break
                worker = min(free, key=lambda w: len(w.held))
                most = min(worker.handful, worker.room, len(queue))
                jobs = [queue.popitem(last=False)[1][1] for _ in range(most)]
                if not worker.held:
                    worker.since_s = now
                worker.held.update((job.job, job) for job in jobs)
                yield worker.name, jobs

    def waiting_s(self, kind: WorkerKind, now: float) -> float | None:
        """How long the first job in line has waited for a worker of this kind; None: none waits."""
        first = next(iter(self.queues[kind].values()), None)
        return None if first is None else now - first[0]

    # --- trouble --------------------------------------------------------------------------------------

    def hung(self, now: float) -> list[tuple[Worker, str]]:
        """Workers that are alive and make no progress, with the evidence."""
        found = []
        for worker in self.workers.values():
            in_hand_s = now - max(worker.since_s, 0.0)
            if worker.held and in_hand_s > DEADLINE_S[worker.kind]:
                job = next(iter(worker.held))
                found.append((worker, f"hung: job {job} in hand for {in_hand_s:.1f} s"))
            elif not worker.held and now - worker.heard_at_s > SILENCE_S:
                found.append((worker, f"hung: silent for {now - worker.heard_at_s:.1f} s"))
        return found

    def unheard(self, name: str, ready_since_s: float, now: float) -> bool:
        """Whether a worker process that is ready for so long should have said a word by now, and has not: it hung
        before this broker came. One that is busy for another broker may be silent for the length of a job."""
        kind = name.partition("@")[0]
        if name in self.workers or kind not in DEADLINE_S:
            return False
        return now - ready_since_s > DEADLINE_S[WorkerKind(kind)]

    def waited_too_long(self, now: float) -> list[DispatchJob]:
        """Jobs taken out of a queue because no worker of their kind took them within the limit."""
        expired = []
        for queue in self.queues.values():
            while queue and now - next(iter(queue.values()))[0] > QUEUE_LIMIT_S:
                expired.append(queue.popitem(last=False)[1][1])
        return expired
