"""Worker registry: liveness of the workers and assignment of jobs to them.

Pure: the time is an argument; it does not know commands or sockets. Workers of a kind share one queue. A worker that
answers in microseconds gets a batch of jobs per message and one batch ahead, so that it never waits for the broker. A
slow worker gets one job at a time, so that no job waits at a busy worker while another worker is idle. Workers process
jobs in order, so the first job assigned to a worker is in progress.

A worker reports during a job how much processor time the job has used. The limits of a job count this time, because on
a busy machine a healthy job may take any time on the clock.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from broker.decisions.effects import DispatchJob
from rtc.protocol.messages import REHEARSER, WorkerKind

BATCH_S = 0.002  # maximum duration of the jobs in one message
BATCH_MAX = 64  # maximum number of jobs in one message
SLOW_S = 0.005  # workers with longer jobs get one at a time
# Limit of the processor time of a job, and of the time in which its worker reports that it has not used any. An
# analyzer waits for the world database for up to half of it.
DEADLINE_S: dict[str, float] = {
    WorkerKind.PARSER: 3.0,
    WorkerKind.ELABORATOR: 15.0,
    WorkerKind.BINDER: 15.0,
    WorkerKind.ANALYZER: 10.0,
}
REHEARSAL_S = 60.0  # the same of a rehearsal, which does the work of many such jobs
UNWANTED_S = 2.0  # the same of a job whose command has ended: its worker is killed, so that it serves others
QUEUES: tuple[str, ...] = (*WorkerKind, REHEARSER)  # names; each is shared by the workers of one kind
PROGRESS_S = 0.001  # least processor time that counts as progress of a job
SILENCE_S = 3.0  # time limit for a sign of life of an idle worker, which sends one every 0.5 s
BUSY_SILENCE_S = 30.0  # the same during a job: on a busy machine its signs of life are late
MAX_JOB_S = 600.0  # of any job, by the clock: one that only looks busy
QUEUE_LIMIT_S = 60.0  # maximum wait of a job while no worker of its kind answers or makes progress


Lane = OrderedDict[str, tuple[float, DispatchJob]]  # job -> (time when it was queued, job); the oldest first


class Queue:
    """Jobs of one kind that wait for a worker, round-robin by client.

    A client with thousands of commands delays another by one job only. The jobs of one client stay in order."""

    def __init__(self) -> None:
        self._lanes: OrderedDict[str, Lane] = OrderedDict()  # by client, the next one first; none is empty
        self._client_of: dict[str, str] = {}

    def __len__(self) -> int:
        return len(self._client_of)

    def add(self, job: DispatchJob, now: float) -> None:
        client, name = job.client, job.job
        self._client_of[name] = client
        lane = self._lanes.get(client)
        if lane is None:
            lane = self._lanes[client] = OrderedDict()
        lane[name] = (now, job)

    def take(self, most: int) -> list[DispatchJob]:
        """Remove the next jobs, one of each client in turn; at most this many."""
        lanes, client_of = self._lanes, self._client_of
        jobs: list[DispatchJob] = []
        while lanes and len(jobs) < most:
            client, lane = next(iter(lanes.items()))
            name, (_, job) = lane.popitem(last=False)
            del client_of[name]
            jobs.append(job)
            if not lane:
                del lanes[client]
            elif len(lanes) > 1:
                lanes.move_to_end(client)
        return jobs

    def drop(self, job: str) -> None:
        client = self._client_of.pop(job, None)
        if client is not None:
            del self._lanes[client][job]
            if not self._lanes[client]:
                del self._lanes[client]

    def oldest_s(self) -> float | None:
        """Time when the oldest waiting job was queued; None if the queue is empty."""
        return min((next(iter(lane.values()))[0] for lane in self._lanes.values()), default=None)

    def waiting_since(self, before_s: float) -> list[DispatchJob]:
        """The jobs queued before this time."""
        found = []
        for lane in self._lanes.values():
            for since_s, job in lane.values():
                if since_s >= before_s:
                    break
                found.append(job)
        return found


class LostJob(NamedTuple):
    """A job whose worker is lost. `in_hand`: it was in progress. `inside`: the code of a package that ran in it."""

    job: DispatchJob
    in_hand: bool
    inside: str = ""


class Worker:
    __slots__ = (
        *("abilities", "assigned", "done", "last_seen_s", "mean_s", "name", "node", "pid", "queue"),
        *("inside", "progress_at_s", "retiring", "since_s", "unwanted", "worked_s"),
    )

    def __init__(self, name: str, node: int, queue: str, pid: int, now: float, abilities: Sequence[str] = ()) -> None:
        self.name, self.node, self.queue, self.pid, self.abilities = name, node, queue, pid, list(abilities)
        self.assigned: dict[str, DispatchJob] = {}  # jobs in order; the first is in progress
        self.unwanted: set[str] = set()  # those of them whose command has ended
        self.since_s = now  # time when the first job began
        self.worked_s = 0.0  # processor time that it has reported for the first job
        self.inside = ""  # the code of an installed package that ran in its latest sign of life
        self.progress_at_s = now  # time when `worked_s` last rose, or of `since_s`
        self.last_seen_s = now
        self.done = 0
        self.mean_s = 1.0  # mean duration of a job; an unknown worker counts as slow
        self.retiring = False  # ordered to end: it gets no further jobs

    def begin_job(self, now: float) -> None:
        """The first of its assigned jobs is in progress from now on."""
        self.since_s = self.progress_at_s = now
        self.worked_s = 0.0

    @property
    def batch_size(self) -> int:
        return max(1, min(BATCH_MAX, int(BATCH_S / max(self.mean_s, 1e-6))))

    @property
    def free_slots(self) -> int:
        if self.retiring:
            return 0
        most = 1 if self.mean_s > SLOW_S else 2 * self.batch_size
        return most - len(self.assigned)


class WorkerRegistry:
    def __init__(self) -> None:
        self.workers: dict[str, Worker] = {}
        self.queues: dict[str, Queue] = {name: Queue() for name in QUEUES}
        self.active_at_s: dict[str, float] = {}  # queue -> time of the latest result or progress

    # --- workers come and go --------------------------------------------------------------------------

    def register(
        self, name: str, node: int, queue: str, pid: int, now: float, abilities: Sequence[str] = ()
    ) -> list[LostJob]:
        """Add a ready worker of this kind, or a rehearser. Returns the jobs that an earlier one of that name lost."""
        lost = self.remove(name)
        self.workers[name] = Worker(name, node, queue, pid, now, abilities)
        return lost

    def remove(self, name: str) -> list[LostJob]:
        worker = self.workers.pop(name, None)
        if worker is None:
            return []
        return [
            LostJob(job, in_hand=number == 0, inside=worker.inside if number == 0 else "")
            for number, job in enumerate(worker.assigned.values())
        ]

    def mark_alive(self, name: str, now: float, worked_s: float = 0.0, inside: str = "") -> bool:
        """Record a sign of life. `worked_s`: processor time of the job in progress. False: the worker is not registered
        and must send its hello."""
        worker = self.workers.get(name)
        if worker is None:
            return False
        worker.last_seen_s, worker.inside = now, inside
        if worker.assigned and worked_s - worker.worked_s >= PROGRESS_S:
            worker.worked_s = worked_s
            worker.progress_at_s = self.active_at_s[worker.queue] = now
        return True

    def answered(self, name: str, job: str, attempt: int, took_s: float, now: float) -> bool:
        """Record a result. False: this attempt is not assigned to this worker, or was declared lost."""
        worker = self.workers.get(name)
        if worker is None:
            return False
        worker.last_seen_s = worker.since_s = worker.progress_at_s = self.active_at_s[worker.queue] = now
        worker.worked_s, worker.inside = 0.0, ""  # the next of its jobs is in progress
        assigned = worker.assigned.get(job)
        if assigned is None or assigned.attempt != attempt:  # a late result of an earlier attempt
            return False
        del worker.assigned[job]
        worker.unwanted.discard(job)
        worker.done += 1
        worker.mean_s = took_s if worker.done == 1 else 0.8 * worker.mean_s + 0.2 * took_s
        return True

    # --- jobs -----------------------------------------------------------------------------------------

    def submit(self, job: DispatchJob, now: float) -> None:
        """Queue a job."""
        self.queues[job.queue].add(job, now)

    def cancel(self, job: str) -> str:
        """Remove a job from the queues. Returns the worker that has it and must drop it, or an empty name. One that
        is in progress there, and lasts, is `hung`."""
        for queue in self.queues.values():
            queue.drop(job)
        worker = next((worker for worker in self.workers.values() if job in worker.assigned), None)
        if worker is None:
            return ""
        worker.unwanted.add(job)
        return worker.name

    def assign(self, now: float) -> Iterator[tuple[str, list[DispatchJob]]]:
        """Assign queued jobs. Yields (worker, jobs) pairs, the least loaded worker first."""
        for name, queue in self.queues.items():
            while queue:
                free = [w for w in self.workers.values() if w.queue == name and w.free_slots > 0]
                if not free:
                    break
                worker = min(free, key=lambda w: len(w.assigned))
                jobs = queue.take(min(worker.batch_size, worker.free_slots))
                if not worker.assigned:
                    worker.begin_job(now)
                worker.assigned.update({job.job: job for job in jobs})
                yield worker.name, jobs

    def waiting_s(self, queue: str, now: float) -> float | None:
        """Waiting time of the oldest job of this queue, in seconds; None: the queue is empty."""
        since_s = self.queues[queue].oldest_s()
        return None if since_s is None else now - since_s

    # --- trouble --------------------------------------------------------------------------------------

    def hung(self, now: float) -> list[tuple[Worker, str]]:
        """Workers without progress or without a sign of life, each with the evidence."""
        found = ((worker, _why_hung(worker, now)) for worker in self.workers.values())
        return [(worker, f"hung: {why}{_inside(worker)}") for worker, why in found if why]

    def never_registered(self, name: str, ready_since_s: float, now: float) -> bool:
        """True if a ready worker process has not registered in time: it hung before this broker started.

        A worker that is busy for an earlier broker registers after its job."""
        kind = name.partition("@")[0]
        return name not in self.workers and kind in QUEUES and now - ready_since_s > BUSY_SILENCE_S

    def waited_too_long(self, now: float) -> list[DispatchJob]:
        """Remove and return the jobs that waited longer than the limit while no worker of their kind made progress.

        As long as workers answer or work, the queue is only long, and its jobs stay."""
        expired = []
        for name, queue in self.queues.items():
            if now - self.active_at_s.get(name, -QUEUE_LIMIT_S) < QUEUE_LIMIT_S:
                continue
            late = queue.waiting_since(now - QUEUE_LIMIT_S)
            for job in late:
                queue.drop(job.job)
            expired += late
        return expired


def _inside(worker: Worker) -> str:
    return f", in the {worker.inside} of an installed package" if worker.inside else ""


def _why_hung(worker: Worker, now: float) -> str:
    """The evidence that a worker hangs; empty if it does not."""
    silent_s, limit_s = now - worker.last_seen_s, DEADLINE_S.get(worker.queue, REHEARSAL_S)
    if not worker.assigned:
        return f"silent for {silent_s:.1f} s" if silent_s > SILENCE_S else ""
    job, in_hand_s, idle_s = (
        next(iter(worker.assigned)),
        now - worker.since_s,
        worker.last_seen_s - worker.progress_at_s,
    )
    if job in worker.unwanted and max(worker.worked_s, idle_s) > UNWANTED_S:
        return f"job {job} goes on although its command has ended"
    if worker.worked_s > limit_s:
        return f"job {job} has used {worker.worked_s:.1f} s of processor time"
    if idle_s > limit_s:
        return f"job {job} has not used the processor for {idle_s:.1f} s"
    if silent_s > BUSY_SILENCE_S:
        return f"silent for {silent_s:.1f} s, with job {job} in hand for {in_hand_s:.1f} s"
    return f"job {job} in hand for {in_hand_s:.1f} s" if in_hand_s > MAX_JOB_S else ""
