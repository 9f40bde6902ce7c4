"""When to ask an engine for workers on other machines: one command line of the user, run by the supervisor. Pure.

Asked only when jobs of a kind wait although this machine has all the workers of that kind that it may have. Workers
that were asked for and have not joined are not asked for again before the declared time (`rtc up --more-wait`) has
passed. The supervisor's table states what was asked, so that a restarted broker does not ask again either.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from broker.dispatch.worker_registry import Worker, WorkerRegistry
from rtc.protocol.messages import ProcessRow, RequestWorkers, WorkerKind, WorkerRequest

WAITED_S = 1.0  # waiting time of a job that shows that this machine alone is too slow
PAUSE_S = 5.0  # least time between two requests for a kind, so that those that have joined take jobs first
FAILED_S = 30.0  # time after a failed command line until it is tried again, if `wait_s` is not shorter
ORDER_S = 3.0  # time for an order to appear in the supervisor's table


class MoreWorkers:
    """Orders requests for more workers; none if `command` is empty.

    `own`: workers of a kind up to which this machine starts more; `far`: maximum of a kind on other machines; `wait_s`:
    time for workers to join.
    """

    def __init__(self, command: str, own: int, far: int, wait_s: float) -> None:
        self._command, self._own, self._far, self._wait_s = command, own, far, wait_s
        self._ordered_s: dict[WorkerKind, float] = {}

    def orders(
        self,
        registry: WorkerRegistry,
        processes: Sequence[ProcessRow],
        asked: Collection[WorkerRequest],
        now: float,
    ) -> Iterator[RequestWorkers]:
        """Yield at most one order. `asked`: the latest requests, from the supervisor's table."""
        if not self._command or any(one.running for one in asked):
            return
        if any(now - at_s < ORDER_S for at_s in self._ordered_s.values()):
            return
        local = {row.name for row in processes}
        latest = {one.kind: one for one in asked}
        for kind in WorkerKind:
            workers = [worker for worker in registry.workers.values() if worker.queue == kind and not worker.retiring]
            far = far_of(workers, local)
            if not self._too_few(registry, kind, len(workers), now) or not self._may_ask(latest.get(kind), far, now):
                continue
            waiting = len(registry.queues[kind]) if "{count}" in self._command else 1
            if (count := min(waiting, self._far - far)) > 0:
                self._ordered_s[kind] = now
                yield RequestWorkers(kind=kind, count=count, registered_before=far)
                return

    def _too_few(self, registry: WorkerRegistry, kind: WorkerKind, there: int, now: float) -> bool:
        waiting_s = registry.waiting_s(kind, now)
        return waiting_s is not None and waiting_s > WAITED_S and there >= self._own

    def _may_ask(self, last: WorkerRequest | None, far: int, now: float) -> bool:
        if last is None:
            return True
        ago_s = now - last.at_s
        if last.failed:
            return ago_s >= min(FAILED_S, self._wait_s)
        missing = last.count - joined(last, far)
        return ago_s >= (self._wait_s if missing > 0 else PAUSE_S)


def far_of(workers: Collection[Worker], local: Collection[str]) -> int:
    """The number of workers that are not processes of this machine's supervisor."""
    return sum(1 for worker in workers if worker.name not in local)


def joined(asked: WorkerRequest, far: int) -> int:
    """How many of the workers asked for have joined; `far`: workers of that kind on other machines now."""
    return min(asked.count, max(0, far - asked.registered_before))
