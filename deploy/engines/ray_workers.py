"""Workers as actors of Ray: `python -m rtc deploy.engines.ray_workers --kind binder --count 8 --with w.key`.

The loop of a worker runs in a method of its actor, without a child process, so that `ray.kill` ends all of it. Ray
restarts an actor whose process died. A worker that ended by itself (rejected, or without its broker) is replaced here.
Every host of Ray needs this package; the key travels through Ray, which must be trusted like the key.
"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import Any

from rtc.protocol.messages import WorkerKind
from rtc.protocol.outcomes import ClusterError, KeyTrouble
from rtc.runtime import process
from rtc.runtime.environment import ROOMS
from rtc.runtime.keys import KeyFile
from rtc.runtime.process import Every, Process, now_s
from workers.runtime.contact import LIMIT_S, BrokerContact
from workers.runtime.start import join

AGAIN_S = 3.0  # pause before a worker that ended is replaced
GRACE_S = 20.0  # time limit of an orderly end; longer than the longest job (15 s)
STEP_S = 0.5


class RayWorker:
    """One worker in an actor. Ray calls the methods in threads: `run` occupies one until the worker ends."""

    def __init__(self, key: KeyFile, kind: str, lost_after_s: float) -> None:
        self._key, self._kind, self._lost_after_s = key, WorkerKind(kind), lost_after_s
        self._me: Process | None = None
        self._contact: BrokerContact | None = None
        self._stopping = False

    def run(self) -> str:
        """Run the worker. Returns the reason if it ended by itself."""
        with process.start(self._kind, ".") as me:
            self._me, self._contact = me, BrokerContact(now_s(), self._lost_after_s)
            try:
                if not self._stopping:
                    join(self._key, self._kind, None, self._contact, me)
            except (ClusterError, KeyTrouble) as error:
                return str(error)
            finally:
                self._me = self._contact = None
        return ""

    def address(self) -> str:
        """ "binder@18"; empty while the worker is not in its cluster."""
        return "" if self._contact is None else self._contact.worker

    def stop(self) -> None:
        """Order the end after the job in progress."""
        self._stopping = True
        if self._me is not None:
            self._me.stop()


class Member:
    """An actor, its pending calls of `run` and `address`, and the last address it reported."""

    def __init__(self, actor: Any) -> None:
        self.actor, self.run, self.asked = actor, actor.run.remote(), actor.address.remote()
        self.started, self.address = False, ""


class Fleet:
    """`count` workers of one kind as actors. `ray` is the module, connected to a cluster of Ray."""

    def __init__(self, ray: Any, key: KeyFile, kind: WorkerKind, count: int, lost_after_s: float = LIMIT_S) -> None:
        self._ray, self._kind, self._count = ray, kind, count
        # Only Ray's own failures are retried: an actor whose process died is restarted, and runs its worker again.
        made = ray.remote(num_cpus=1, max_restarts=-1, max_task_retries=-1, max_concurrency=3)(RayWorker)
        self._start = lambda: Member(made.remote(key, kind.value, lost_after_s))
        self.members: list[Member] = []
        self._again = Every(AGAIN_S)
        self._shown = ""

    def step(self) -> None:
        """Start the missing workers and print what has changed; takes up to STEP_S."""
        if len(self.members) < self._count and self._again.due(now_s()):
            self.members += [self._start() for _ in range(self._count - len(self.members))]
        runs = [member.run for member in self.members]
        ended = set(self._ray.wait(runs, num_returns=len(runs), timeout=STEP_S)[0]) if runs else set()
        for member in [*self.members]:
            if member.run in ended:
                self.members.remove(member)
                self._ray.kill(member.actor)
                print(f"{member.address or self._kind} ended: {self._result(member.run)}", flush=True)
            elif self._ray.wait([member.asked], timeout=0)[0]:
                member.started, member.address = True, self._result(member.asked)
                member.asked = member.actor.address.remote()
        self._show()

    def stop(self) -> None:
        """End all workers in order, within GRACE_S; an actor that Ray has not placed yet is removed at once."""
        started = [member for member in self.members if member.started]
        for member in started:
            member.actor.stop.remote()
        runs = [member.run for member in started]
        if runs:
            self._ray.wait(runs, num_returns=len(runs), timeout=GRACE_S)
        for member in self.members:
            self._ray.kill(member.actor)
        print(f"ended: {', '.join(member.address for member in started if member.address) or 'none'}", flush=True)
        self.members.clear()

    def _result(self, call: Any) -> str:
        """The text that a finished call returned, or the failure of Ray."""
        try:
            return str(self._ray.get(call))
        except self._ray.exceptions.RayError as error:
            return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"

    def _show(self) -> None:
        joined = sorted(member.address for member in self.members if "@" in member.address)
        started = sum(member.started for member in self.members)
        words = f"asked for {self._count} of kind {self._kind}; joined: {', '.join(joined) or 'none'}"
        if started > len(joined):
            words += f"; {started - len(joined)} started and not joined"
        if started < len(self.members):
            words += f"; {len(self.members) - started} wait for Ray (a free CPU?)"
        if words != self._shown:
            print(words, flush=True)
        self._shown = words


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        prog="python -m rtc deploy.engines.ray_workers",
        description="Workers of a cluster as Ray actors; Ctrl-C ends them.",
    )
    made.add_argument("--kind", choices=[kind.value for kind in WorkerKind], required=True)
    made.add_argument("--count", type=int, default=1, metavar="N", help="number of workers; each takes one CPU of Ray")
    made.add_argument("--with", dest="key", type=Path, metavar="FILE", required=True, help="a worker's key")
    made.add_argument("--lost-after", type=float, default=LIMIT_S, metavar="S", help="as of python -m rtc workers")
    made.add_argument("--ray", metavar="ADDRESS", help="address of the Ray cluster; default: as of ray.init")
    return made


def main() -> None:
    asked = parser()
    given = asked.parse_args()
    if given.count < 1:
        asked.error("--count must be at least 1")
    if not given.lost_after > 0.0:
        asked.error("--lost-after must be longer than 0 s")
    try:
        import ray
    except ImportError:
        sys.exit("Ray is not installed; install it with: pip install 'telerobot-rtc[ray]'")
    try:
        key = KeyFile.load(given.key)
        key.endpoint("workers")
    except KeyTrouble as error:
        sys.exit(str(error))
    try:
        rooms = {"env_vars": {"PYTHONPATH": ROOMS}} if ROOMS in sys.path else None  # of an installed rtc
        ray.init(address=given.ray, runtime_env=rooms)
    except (ConnectionError, ValueError, RuntimeError) as error:
        sys.exit(f"Ray cannot be reached at {given.ray or 'its default address'} (--ray): {error}")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    fleet = Fleet(ray, key, WorkerKind(given.kind), given.count, given.lost_after)
    try:
        while True:
            fleet.step()
    except KeyboardInterrupt:
        fleet.stop()


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
