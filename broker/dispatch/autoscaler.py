"""Autoscaler: the number of workers per kind follows the length of their queues, within limits (R50, R124).

Pure. A kind with waiting jobs gets one more worker at a time, up to a maximum. A worker that is idle for long retires,
down to a minimum. A kind without workers gets one as soon as a job waits. The supervisor starts and ends the processes.
While a worker of a kind starts, no further one is ordered: on a slow machine more processes would only start later.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from broker.dispatch.worker_registry import QUEUES, Worker, WorkerRegistry
from rtc.protocol.messages import REHEARSER, ProcessRow, RetireWorker, SpawnWorker, WorkerKind

WAIT_S = 0.25  # waiting time of a job that shows a shortage of workers
COMING_S = 5.0  # time limit for the start of a worker; then it is ordered again
IDLE_S = 20.0  # time without a job after which a worker may retire
REHEARSERS = 2  # maximum; the first starts with the first TEST sentence, and none is kept for later ones
COMING = ("pending", "starting", "restarting")  # states of a process that is about to be ready

Processes = Sequence[ProcessRow]


class Autoscaler:
    """Orders workers by the queues and by the supervisor's latest process list. The limits hold per kind; rehearsers
    have their own."""

    def __init__(self, least: int, most: int) -> None:
        self._least, self._most = least, max(least, most, 1)
        self._asked: dict[str, tuple[float, int]] = {}  # when a worker was asked for, how many there were then

    def orders(
        self, registry: WorkerRegistry, processes: Processes, now: float
    ) -> Iterator[SpawnWorker | RetireWorker]:
        """Yield orders for the supervisor. A worker that is to retire gets no further jobs."""
        for queue in QUEUES:
            workers = [w for w in registry.workers.values() if w.queue == queue and not w.retiring]
            waiting_s = registry.waiting_s(queue, now)
            if waiting_s is not None:
                if not _coming(queue, workers, processes) and self._too_few(queue, len(workers), waiting_s, now):
                    self._asked[queue] = now, len(workers)
                    yield _spawn(queue)
            elif (idle := self._surplus(queue, workers, processes, now)) is not None:
                idle.retiring = True
                yield RetireWorker(name=idle.name)

    def _surplus(self, queue: str, workers: Sequence[Worker], processes: Processes, now: float) -> Worker | None:
        """A local worker that may retire. Workers on other machines do not count: they may leave at any time, and the
        supervisor does not own them."""
        names = {row.name for row in processes}
        own = [worker for worker in workers if worker.name in names]
        least = 0 if queue == REHEARSER else self._least
        return _idle(own, now) if len(own) > least else None

    def _too_few(self, queue: str, there: int, waiting_s: float, now: float) -> bool:
        asked_s, before = self._asked.get(queue, (-COMING_S, 0))
        unseen = now - asked_s < COMING_S and there <= before
        most = REHEARSERS if queue == REHEARSER else self._most
        return there < most and not unseen and (there == 0 or waiting_s > WAIT_S)


def _spawn(queue: str) -> SpawnWorker:
    if queue == REHEARSER:
        return SpawnWorker(kind=WorkerKind.ELABORATOR, rehearses=True)
    return SpawnWorker(kind=WorkerKind(queue))


def _coming(queue: str, workers: Sequence[Worker], processes: Processes) -> bool:
    """True if a process of this kind is starting and has not registered."""
    known = {worker.name for worker in workers}
    rows = (row for row in processes if row.name.startswith(f"{queue}@") and row.name not in known)
    return any(row.state in COMING for row in rows)


def _idle(workers: Sequence[Worker], now: float) -> Worker | None:
    """The idle worker with the highest address, so that the cube stays complete; None: all are busy."""
    idle = (worker for worker in workers if not worker.assigned and now - worker.since_s > IDLE_S)
    return max(idle, key=lambda worker: worker.node, default=None)
