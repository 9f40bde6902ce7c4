"""Remote workers as actors of a real Ray on this machine, which are killed in three ways. Needs the extra `ray`."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from deploy.engines.ray_workers import Fleet, main, parser
from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.messages import NoteKind, WorkerKind
from rtc.protocol.outcomes import OutcomeKind
from rtc.protocol.roles import Role
from rtc.runtime.keys import KeyFile, KeyRing
from tests.processes.test_gateway import free_ports

ROOT = Path(__file__).parents[2]
COUNT = 2
LIMIT_S, LOST_AFTER_S = 60.0, 5.0
SENTENCES = ["STOW RIGHT-ARM", "STOW LEFT-ARM"] * 3  # one primitive each
FIRST_REMOTE = 16  # address
PAUSE = threading.Event()

needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason="Ray is not installed; `make test-ray` installs it and runs this"
)


def test_the_launcher_needs_kind_and_key(capsys: pytest.CaptureFixture[str]) -> None:
    given = parser().parse_args(["--kind", "binder", "--count", "8", "--with", "w1.key"])
    assert (given.kind, given.count, given.key) == (WorkerKind.BINDER, 8, Path("w1.key"))
    with pytest.raises(SystemExit):
        parser().parse_args(["--kind", "binder"])


@pytest.mark.parametrize("options", [["--count", "0"], ["--lost-after", "0"], ["--lost-after", "nan"]])
def test_the_launcher_refuses_what_would_start_nothing(options: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ray_workers", "--kind", "binder", "--with", "missing.key", *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2  # of argparse, before Ray or the key is looked for


@pytest.fixture(scope="module")
def ray() -> Iterator[Any]:
    """Ray with a node of its own, as small as it can be. The last test of this file ends it."""
    environment = pytest.MonkeyPatch()
    environment.setenv("RAY_USAGE_STATS_ENABLED", "0")
    environment.setenv("PYTHONPATH", str(ROOT))
    import ray

    ray.init(
        address="local",
        num_cpus=COUNT,
        object_store_memory=80 << 20,
        include_dashboard=False,
        log_to_driver=False,
    )
    yield ray
    ray.shutdown()
    environment.undo()


@pytest.fixture(scope="module")
def run_dir() -> Iterator[Path]:
    """A cluster whose own workers are started only if there are no others."""
    with own_cluster(mcm="kinematic", speed="max", least=0, listen=f"tcp://127.0.0.1:{free_ports()}") as path:
        yield path


@pytest.fixture(scope="module")
def key(run_dir: Path) -> KeyFile:
    with Client(run_dir) as rtc:
        return KeyRing(run_dir).new("w1", Role.WORKER, rtc.settings.listen, run_dir / "w1.key")


class Load:
    """Sentences without a pause, in a thread, until `finish`."""

    def __init__(self, run_dir: Path) -> None:
        self._run_dir, self._enough = run_dir, threading.Event()
        self.ended: list[Any] = []
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        with Client(self._run_dir) as rtc:
            while not self._enough.is_set():
                self.ended += rtc.run_many(SENTENCES, timeout_s=LIMIT_S)

    def finish(self) -> list[Any]:
        self._enough.set()
        self._thread.join()
        return self.ended


@pytest.mark.slow
@needs_ray
def test_workers_in_actors_end_in_order_and_wait_for_a_free_cpu(
    run_dir: Path, key: KeyFile, ray: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with Client(run_dir) as rtc:
        fleet = Fleet(ray, key, WorkerKind.PARSER, COUNT + 1, LOST_AFTER_S)
        step_until(fleet, lambda: sum("@" in member.address for member in fleet.members) == COUNT)
        pids = {row.pid for row in rtc.status().workers if row.name in ("parser@16", "parser@20")}
        assert len(pids) == COUNT
        assert "asked for 3 of kind parser; joined: parser@16, parser@20; 1 wait" in capsys.readouterr().out

        fleet.stop()

        assert set(re.findall(r"parser@\d+", capsys.readouterr().out)) == {"parser@16", "parser@20"}
        wait_for(lambda: not any(row.pid in pids for row in rtc.status().workers))
        wait_for(lambda: not any(map(runs, pids)))


@pytest.mark.slow
@needs_ray
def test_workers_in_actors_bind_and_their_loss_harms_no_command(run_dir: Path, key: KeyFile, ray: Any) -> None:
    with Client(run_dir) as rtc:
        fleet = Fleet(ray, key, WorkerKind.BINDER, COUNT, LOST_AFTER_S)
        step_until(fleet, lambda: len(binders(rtc)) == COUNT and all("@" in m.address for m in fleet.members))
        pids = set(binders(rtc).values())
        load = Load(run_dir)
        try:
            killed = binders(rtc)[fleet.members[0].address]
            os.kill(killed, signal.SIGKILL)
            step_until(fleet, lambda: killed not in binders(rtc).values() and len(binders(rtc)) == COUNT)
            pids |= set(binders(rtc).values())

            killed = binders(rtc)[fleet.members[1].address]
            ray.kill(fleet.members[1].actor)
            step_until(fleet, lambda: killed not in binders(rtc).values() and len(binders(rtc)) == COUNT)
            pids |= set(binders(rtc).values())

            ray.shutdown()
            wait_for(lambda: not pids & set(binders(rtc).values()))
            before = len(load.ended)
            wait_for(lambda: len(load.ended) > before + len(SENTENCES))
        finally:
            ended = load.finish()
        wait_for(lambda: not any(map(runs, pids)))

        assert {one.outcome.kind for one in ended} == {OutcomeKind.SUCCEEDED}
        nodes: set[str] = set()
        for one in ended:
            notes = rtc.trace(one.command).notes
            assert [note.kind for note in notes if note.node == "MCM"] == [NoteKind.STARTED, NoteKind.STEP_ENDED]
            nodes |= {note.node for note in notes if note.node.startswith("binder@")}
        assert {is_remote(node) for node in nodes} == {True, False}  # on Ray, and later here


def binders(rtc: Client) -> dict[str, int]:
    """Address -> pid of the remote binders; the cluster may start some of its own."""
    rows = {row.name: row.pid for row in rtc.status().workers if row.name.startswith("binder@")}
    return {name: pid for name, pid in rows.items() if is_remote(name)}


def is_remote(address: str) -> bool:
    return int(address.partition("@")[2]) >= FIRST_REMOTE


def step_until(fleet: Fleet, condition: Callable[[], bool]) -> None:
    def step() -> bool:
        fleet.step()
        return condition()

    wait_for(step)


def wait_for(condition: Callable[[], bool]) -> None:
    end = os.times().elapsed + LIMIT_S
    while not condition():
        assert os.times().elapsed < end
        PAUSE.wait(0.05)


def runs(pid: int) -> bool:
    """Whether this process exists and is not a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
