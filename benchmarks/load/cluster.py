"""Starts and ends a cluster under load: the real broker and world, trivial workers, an instant subsystem.

    with cluster(dim=2) as running:
        ...Client(running.run_dir)...

It has no supervisor: a process that dies makes the benchmark fail. The workers are processes of their own, or Ray
actors (`engine`).
"""

from __future__ import annotations

import contextlib
import os
import secrets
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.load.ray_workers import ray_workers
from deploy.hypercube import addresses, kind_of
from rtc.model.cells.cell import Cell
from rtc.protocol.messages import WorkerKind
from rtc.runtime.handover import OPTION, Handover
from rtc.runtime.process import die_with_parent
from rtc.runtime.settings import Settings, prepare_run_dir
from rtc.world.lease import KEY_BYTES, KEY_FILE

END_LIMIT_S = 10.0
PROFILED = ("-m", "cProfile", "-o")


@dataclass
class Running:
    run_dir: Path
    settings: Settings
    handed: Handover  # as from a supervisor
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    actors: dict[str, int] = field(default_factory=dict)  # workers that are Ray actors -> process id

    def cpu_s(self) -> dict[str, float]:
        """Processor time used by each process so far (user and system); workers of a kind together."""
        used: dict[str, float] = {}
        pids = {name: process.pid for name, process in self.processes.items()} | self.actors
        for name, pid in pids.items():
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            kind = name.partition("@")[0]
            used[kind] = used.get(kind, 0.0) + (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return used

    def memory_mb(self, name: str) -> float:
        """Resident memory of a process."""
        pages = int(Path(f"/proc/{self.processes[name].pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


@contextlib.contextmanager
def cluster(
    dim: int = 2,
    *,
    profile: Path | None = None,
    busy_s: float = 0.0,
    asleep_s: float = 0.0,
    real: Sequence[WorkerKind] = (),
    engine: str = "process",
) -> Iterator[Running]:
    """A cluster with 2^dim workers.

    `profile`: a file for the broker's profile (cProfile, at about half the speed). `busy_s`, `asleep_s`: work, or
    sleep, of each trivial job. `real`: kinds with their real functions; the subsystem then has the arms of the cell.
    `engine`: "process" or "ray". Raises ImportError if there is no Ray.
    """
    with contextlib.ExitStack() as ended, tempfile.TemporaryDirectory(prefix="rtc-bench-") as folder:
        run_dir = prepare_run_dir(Path(folder) / "run")
        settings = Settings(run_dir=str(run_dir), run=secrets.token_hex(4), dim=dim)
        settings.save()
        key = secrets.token_bytes(KEY_BYTES)
        (run_dir / KEY_FILE).write_bytes(key)
        handed = Handover.make(settings, key, token="")
        ended.callback(os.close, handed.fd)
        running = Running(run_dir, settings, handed)
        try:
            handing = (OPTION, str(handed.fd))
            _start(running, "world", "-m", "rtc.world", *handing)
            _start(running, "broker", *((*PROFILED, str(profile)) if profile else ()), "-m", "broker", *handing)
            arms = [arm.name for arm in Cell.load(settings.cell).arms] if real else []
            _start(running, "MCM", "-m", "benchmarks.load.subsystem", *(("--performers", *arms) if arms else ()))
            trivial = ("benchmarks.load.worker", "--busy-s", str(busy_s), "--asleep-s", str(asleep_s))
            for node in addresses(dim) if engine == "process" else ():
                kind = kind_of(node)
                module = ("workers", *handing) if kind in real else trivial
                _start(running, f"{kind}@{node}", "-m", *module, "--kind", kind, "--node", str(node))
            for name, process in running.processes.items():
                assert process.stdout is not None
                if process.stdout.readline() != b"ready\n":
                    raise SystemExit(f"{name} did not start:\n{_log(running, name).read_text()}")
            if engine == "ray":
                running.actors = ended.enter_context(ray_workers(run_dir, dim, busy_s, asleep_s, real))
            yield running
        finally:
            ended.close()
            for process in reversed(running.processes.values()):
                process.terminate()
            for process in running.processes.values():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(END_LIMIT_S)
                process.kill()
                process.wait()


def _start(running: Running, name: str, *command: str) -> None:
    me = os.getpid()
    with open(_log(running, name), "ab") as log:
        running.processes[name] = subprocess.Popen(
            [sys.executable, *command, "--run-dir", str(running.run_dir)],
            stdout=subprocess.PIPE,
            stderr=log,
            preexec_fn=lambda: die_with_parent(me),
            pass_fds=(running.handed.fd,),
        )


def _log(running: Running, name: str) -> Path:
    return running.run_dir / f"{name}.log"
