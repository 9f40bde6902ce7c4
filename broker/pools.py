"""How many workers of each kind there should be: pool sizes follow the queues, within limits (R50, R124). Pure.

A kind whose jobs wait gets one worker more, again and again, up to a most; a worker that has had nothing to do for long
retires, down to a least. A kind that nobody is left of gets one as soon as a job waits for it. Who starts and ends
processes is the supervisor; while one is on its way, or was asked for and is not seen, no other of that kind is asked
for: when nothing but time is short (all were killed, the machine is slow), more of them would only come later.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from broker.roster import Worker, WorkerRegistry
from rtc.messages import RetireWorker, SpawnWorker, WorkerKind

WAIT_S = 0.25  # a job that has waited this long for a worker of its kind shows that there are too few
COMING_S = 5.0  # to start one; then the supervisor is asked again
IDLE_S = 20.0  # without a job: there are too many
COMING = ("starting", "restarting")  # states of a process that will soon be there

Processes = Sequence[dict[str, Any]]


class Autoscaler:
    """`look` now and then, with what the supervisor last told of its processes. Limits are of each kind."""

    def __init__(self, least: int, most: int) -> None:
        self._least, self._most = least, max(least, most, 1)
        self._asked: dict[WorkerKind, tuple[float, int]] = {}  # when a worker was asked for, how many there were then

    def orders(
        self, registry: WorkerRegistry, processes: Processes, now: float
    ) -> Iterator[SpawnWorker | RetireWorker]:
        """What to ask of the supervisor. Who is to retire gets no more jobs from here on."""
        for kind in WorkerKind:
            workers = [w for w in registry.workers.values() if w.kind is kind and not w.retiring]
            waiting_s = registry.waiting_s(kind, now)
            if waiting_s is not None:
                if not _coming(kind, workers, processes) and self._too_few(kind, len(workers), waiting_s, now):
                    self._asked[kind] = now, len(workers)
                    yield SpawnWorker(kind=kind)
            elif (idle := self._surplus(workers, processes, now)) is not None:
                idle.retiring = True
                yield RetireWorker(name=idle.name)

    def _surplus(self, workers: Sequence[Worker], processes: Processes, now: float) -> Worker | None:
        """One of the supervisor's own that may retire. Who has come from another machine may leave at any time, so it
        does not count, and is not ours to end."""
        names = {row["name"] for row in processes}
        own = [worker for worker in workers if worker.name in names]
        return _idle(own, now) if len(own) > self._least else None

    def _too_few(self, kind: WorkerKind, there: int, waiting_s: float, now: float) -> bool:
        asked_s, before = self._asked.get(kind, (-COMING_S, 0))
        unseen = now - asked_s < COMING_S and there <= before
        return there < self._most and not unseen and (there == 0 or waiting_s > WAIT_S)


def _coming(kind: WorkerKind, workers: Sequence[Worker], processes: Processes) -> bool:
    """Is a process of this kind on its way, and has not said hello?"""
    known = {worker.name for worker in workers}
    rows = (row for row in processes if row["name"].startswith(f"{kind.value}@") and row["name"] not in known)
    return any(row["state"] in COMING for row in rows)


def _idle(workers: Sequence[Worker], now: float) -> Worker | None:
    """One that has had nothing to do for long: the one with the highest address, so that a cube stays whole."""
    idle = (worker for worker in workers if not worker.assigned and now - worker.since_s > IDLE_S)
    return max(idle, key=lambda worker: worker.node, default=None)
