"""Whole clusters, as the command line starts and ends them: real processes, the exact arm without physics."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import zmq

from deploy import cluster
from rtc.client.client import Client
from rtc.protocol import wire
from rtc.protocol.messages import Telemetry, Validity
from rtc.protocol.outcomes import ClusterError, NoCluster, OutcomeKind
from rtc.runtime.settings import Settings
from tests.apps.cli.in_process import call

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

LIMIT_S = 90.0
WORKERS = ["parser@0", "elaborator@1", "binder@2", "analyzer@3"]
TEMPLATES = ["common-template", "template", "broker-template", "world-template", "MCM-template"]
NAMES = [*TEMPLATES, "cli-template", "broker", "world", "MCM", "S&P", *WORKERS]


def deploy(*arguments, run_dir):
    """A call of `rtc`; what starts and ends no cluster, in this process."""
    words = [*arguments, "--run-dir", str(run_dir)]
    if arguments[0] not in ("up", "down"):
        return call(*words)
    command = [sys.executable, "-m", "rtc.apps.cli.entry", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)


def up(run_dir, *more):
    return deploy("up", "-d", "--mcm", "kinematic", "--speed", "max", *more, run_dir=run_dir)


def report(run_dir):
    return json.loads((run_dir / "supervisor.json").read_text())


def rows(run_dir):
    return {row["name"]: row for row in report(run_dir)["processes"]}


def gone(pids):
    """Wait until none of these processes is left."""
    for pid in filter(None, pids):
        try:
            fd = os.pidfd_open(pid)
        except ProcessLookupError:
            continue
        poller = zmq.Poller()
        poller.register(fd, zmq.POLLIN)
        ended = poller.poll(10_000)
        os.close(fd)
        assert ended, f"process {pid} is still there"


def all_ready(run_dir):
    end = os.times().elapsed + LIMIT_S
    while {row["state"] for row in rows(run_dir).values()} != {"ready"}:
        assert os.times().elapsed < end, rows(run_dir)
        zmq.Poller().poll(10)


def ready_again(run_dir, name, old_pid):
    """The row of a process once it runs anew; the supervisor's report is replaced at every change."""
    end = os.times().elapsed + LIMIT_S
    while os.times().elapsed < end:
        row = rows(run_dir)[name]
        if row["pid"] != old_pid and row["state"] == "ready":
            return row
        zmq.Poller().poll(10)  # leave the processor to those we wait for
    raise AssertionError(f"{name} did not come back")


@pytest.fixture
def run_dir(tmp_path_factory):
    path = tmp_path_factory.mktemp("c", numbered=True)
    yield path
    with contextlib.suppress(NoCluster):
        cluster.down(path)


def ends_in_order(run_dir):
    table = report(run_dir)
    ended = deploy("down", run_dir=run_dir)
    assert (ended.returncode, str(table["pid"]) in ended.stdout) == (0, True)
    gone([table["pid"], *(row["pid"] for row in table["processes"])])
    assert list(run_dir.glob("*.sock")) == []
    assert not (run_dir / "supervisor.json").exists()


def test_up_work_down_beside_another_one(run_dir, tmp_path):
    started = up(run_dir)
    assert started.returncode == 0, started.stdout + started.stderr
    assert [line.split()[0] for line in started.stdout.splitlines()[-1:]] == ["ready"]
    assert sorted(rows(run_dir)) == sorted(NAMES)
    for name, row in rows(run_dir).items():  # all are forked: what they import and build is made once
        of_it = Path(f"/proc/{row['pid']}")
        assert b"deploy.common_imports" in (of_it / "cmdline").read_bytes()
        shown = (of_it / "comm").read_text().strip()
        if name in TEMPLATES:
            assert shown.endswith("template")
            assert len(list((of_it / "task").iterdir())) == 1  # a fork would leave other threads behind
        else:
            assert shown == name
    all_ready(run_dir)
    before = report(run_dir)
    second = up(run_dir)
    assert second.returncode == 1
    (message,) = (second.stdout + second.stderr).splitlines()
    assert message.startswith(f"rtc: a cluster is already running in {run_dir}: supervisor pid {before['pid']}")
    assert f"rtc down --run-dir {run_dir}" in message
    assert report(run_dir) == before
    assert (run_dir / "front.sock").exists()

    assert up(tmp_path, "--dim", "3").returncode == 0
    assert len(rows(tmp_path)) == len(TEMPLATES) + 5 + 8
    assert report(run_dir)["cluster"] != report(tmp_path)["cluster"]
    ends_in_order(tmp_path)
    all_ready(run_dir)
    ends_in_order(run_dir)


def test_down_without_a_cluster_is_what_was_wanted(run_dir):
    ended = deploy("down", run_dir=run_dir)
    assert (ended.returncode, ended.stdout.strip()) == (0, f"no cluster is running in {run_dir}")
    with pytest.raises(NoCluster):
        cluster.down(run_dir / "nowhere")


def test_any_process_killed_comes_back_and_nothing_outlives_a_killed_supervisor(run_dir):
    assert up(run_dir).returncode == 0
    all_ready(run_dir)
    for name in NAMES:
        pid = rows(run_dir)[name]["pid"]
        os.kill(pid, signal.SIGKILL)
        assert ready_again(run_dir, name, pid)["restarts"] == 1
    pids = [row["pid"] for row in rows(run_dir).values()]
    os.kill(report(run_dir)["pid"], signal.SIGKILL)
    gone(pids)
    # Given: a dead cluster's files lie about. When: a new one is started there
    again = up(run_dir)
    assert again.returncode == 0, again.stdout + again.stderr
    table = rows(run_dir)
    assert {row["restarts"] for row in table.values()} == {0}
    # And: stopped processes do not outlive their supervisor either
    for name in ("MCM", "broker", "parser@0"):
        os.kill(table[name]["pid"], signal.SIGSTOP)
    os.kill(report(run_dir)["pid"], signal.SIGKILL)
    gone([row["pid"] for row in table.values()])


def test_a_bad_cell_is_reported_in_the_first_line_that_matters(run_dir):
    failed = up(run_dir, "--cell", "moon-base")
    assert failed.returncode == 2
    assert "no cell moon-base" in failed.stdout + failed.stderr
    assert not (run_dir / "supervisor.json").exists()


def test_a_directory_that_takes_no_files_is_reported_in_one_line(run_dir):
    (run_dir / "supervisor.lock").touch()  # it was a run directory before
    (run_dir / "settings.json.new").symlink_to("/dev/full")
    failed = up(run_dir)
    assert failed.returncode == 1
    assert "Traceback" not in failed.stdout + failed.stderr
    assert f"no cluster can be started in {run_dir}: [Errno 28]" in failed.stdout + failed.stderr


def test_a_run_directory_too_deep_for_sockets_is_refused(tmp_path):
    failed = up(tmp_path / ("d" * 100))
    assert failed.returncode == 1
    assert "too long for sockets" in failed.stdout + failed.stderr


def test_a_settings_file_of_old_does_not_matter(run_dir):
    Path(run_dir, "settings.json").write_text("not json")
    Path(run_dir, "supervisor.json").write_text('{"pid": 1}')
    with pytest.raises(NoCluster):
        cluster.down(run_dir)
    with cluster._lock(run_dir), pytest.raises(ClusterError, match="just starting or ending"), cluster._lock(run_dir):
        pass


def test_a_new_cluster_in_the_directory_does_nothing_of_what_was_sent_to_the_old_one(run_dir):
    """Given a client with one command in progress and one sentence not received, when another cluster starts there."""
    assert deploy("up", "-d", "--mcm", "kinematic", run_dir=run_dir).returncode == 0
    with Client(run_dir) as rtc:
        moving = rtc.submit("MOVE RIGHT-ARM TO RACK-1-FRONT MAINTAIN SPEED 5 CM/S")
        supervisor = report(run_dir)["pid"]
        os.kill(supervisor, signal.SIGSTOP)
        os.kill(rows(run_dir)["broker"]["pid"], signal.SIGKILL)  # alive, it would send the outcome: halted
        os.kill(supervisor, signal.SIGKILL)
        gone([row["pid"] for row in rows(run_dir).values()])
        with pytest.raises(NoCluster, match="its supervisor has ended"):
            rtc.submit("STOW LEFT-ARM")
        assert deploy("up", "-d", "--mcm", "kinematic", run_dir=run_dir).returncode == 0
        with pytest.raises(NoCluster, match="another one is in its place"):
            moving.wait(LIMIT_S)

    with Client(run_dir) as anew:
        status = anew.status()
        assert (status.commands_accepted, status.commands) == (0, [])
        # And: when its supervisor is stopped by a signal, then it still ends in order
        moving = anew.submit("MOVE RIGHT-ARM TO RACK-1-FRONT MAINTAIN SPEED 5 CM/S")
        os.kill(report(run_dir)["pid"], signal.SIGSTOP)
        assert moving.number in deploy("down", run_dir=run_dir).stdout  # the supervisor has named what it stopped


@pytest.fixture
def cluster_of_its_own(run_dir):
    began = up(run_dir)
    assert began.returncode == 0, began.stderr
    return run_dir


def kill(run_dir, name):
    old = rows(run_dir)[name]["pid"]
    os.kill(old, signal.SIGKILL)
    ready_again(run_dir, name, old)


def notes(run_dir, name):
    return " ".join(rows(run_dir)[name]["notes"])


def tcp_x_m(run_dir):
    """Where the hand of RIGHT-ARM is along X, as the simulated hardware publishes it."""
    with zmq.Context() as context, context.socket(zmq.SUB) as telemetry:
        telemetry.subscribe(b"")
        telemetry.connect(f"ipc://{run_dir}/telemetry.sock")
        assert telemetry.poll(5000)
        return wire.reader(Telemetry)(telemetry.recv_multipart()).arms["RIGHT-ARM"].tcp_pose[0]


def test_databases_that_were_lost_or_damaged_are_got_over_and_reported(cluster_of_its_own):
    run_dir = cluster_of_its_own
    with Client(run_dir) as rtc:
        for distance_cm in (-8, 1):
            assert rtc.run(f"MOVE RIGHT-ARM BY {distance_cm} CM ALONG X").outcome.kind is OutcomeKind.SUCCEEDED
        for file in run_dir.glob("journal.db*"):
            file.unlink()
        kill(run_dir, "broker")
        before_m = tcp_x_m(run_dir)
        ended = rtc.run("MOVE RIGHT-ARM BY -1 CM ALONG X")
        assert (ended.command, ended.outcome.kind) == ("C-3", OutcomeKind.SUCCEEDED)
        assert tcp_x_m(run_dir) == pytest.approx(before_m - 0.01, abs=0.002)  # the arm moved: no old report counted
        assert "the journal was lost" in notes(run_dir, "broker")

        (run_dir / "world.db-wal").unlink()  # which has the newer pages
        (run_dir / "world.db").write_bytes(b"noise" * 2000)
        kill(run_dir, "world")
        assert "world.db was damaged" in notes(run_dir, "world")
        assert len(list(run_dir.glob("world.db.damaged-*[0-9]"))) == 1
        (fact,) = rtc.world.view(keys=["MACS-NEW.frame"]).facts
        assert fact.validity is Validity.SUSPECT
        assert "the world database began anew" in fact.source


@pytest.mark.parametrize("module", ["broker", "sim_mcm", "rtc.world"])
def test_a_second_process_of_a_role_ends_with_a_sentence(run_dir, module):
    with cluster._lock(run_dir):  # as a supervisor holds it
        Settings(run_dir=str(run_dir)).save()
        command = [sys.executable, "-m", module, "--run-dir", str(run_dir)]
        second = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
    assert second.returncode == 1
    assert "a second one is not started" in second.stderr
    assert list(run_dir.glob("*.sock")) == []


SMALL = ["settings.json", "lease.key", "supervisor.lock", "supervisor.json"]


def there_again(paths):
    end = os.times().elapsed + LIMIT_S
    while not all(path.exists() for path in paths):
        assert os.times().elapsed < end, [path.name for path in paths if not path.exists()]
        zmq.Poller().poll(10)


def last_speed_rad_s(telemetry):
    """The greatest joint speed of RIGHT-ARM in the last sample that was published."""
    speed_rad_s = None
    while telemetry.poll(0):
        sample = wire.reader(Telemetry)(telemetry.recv_multipart()).arms["RIGHT-ARM"]
        speed_rad_s = max(map(abs, sample.velocities))
    return speed_rad_s


def test_what_is_deleted_in_the_directory_comes_back_and_without_the_directory_the_cluster_ends(run_dir):
    assert deploy("up", "-d", "--mcm", "kinematic", run_dir=run_dir).returncode == 0  # in real time
    before = report(run_dir)
    deleted = [run_dir / name for name in SMALL] + list(run_dir.glob("*.sock"))
    for path in deleted:
        path.unlink()
    for row in before["processes"]:
        if row["name"] in ("binder@2", "world", "MCM", "broker"):  # none of them needs a file for its start
            os.kill(row["pid"], signal.SIGKILL)
    there_again(deleted)
    with Client(run_dir) as rtc:
        assert rtc.halt().confirmed
        assert rtc.run("MOVE RIGHT-ARM BY -1 CM ALONG X").outcome.kind is OutcomeKind.SUCCEEDED
    assert up(run_dir).returncode == 1  # the lock is held again

    pids = [before["pid"], *(row["pid"] for row in rows(run_dir).values())]
    with Client(run_dir) as rtc, zmq.Context() as context, context.socket(zmq.SUB) as telemetry:
        telemetry.setsockopt(zmq.RCVHWM, 100_000)
        telemetry.subscribe(b"")
        telemetry.connect(f"ipc://{run_dir}/telemetry.sock")
        rtc.submit("MOVE RIGHT-ARM BY -12 CM ALONG X MAINTAIN SPEED 1 CM/S")
        while not (last_speed_rad_s(telemetry) or 0.0) > 0.01:
            assert telemetry.poll(5000)
        run_dir.rename(run_dir.with_name("elsewhere"))
        second = up(run_dir)  # while the first still ends, or after that, but never beside it
        assert second.returncode == 0 or "was renamed or removed" in second.stdout + second.stderr
        gone(pids)
        assert last_speed_rad_s(telemetry) < 0.001  # it was braked before the cluster ended


def test_a_taught_place_is_known_in_the_next_run_and_a_reset_keeps_it(run_dir):
    assert up(run_dir).returncode == 0
    assert "P1" in deploy("teach", "P1", "RIGHT-ARM", run_dir=run_dir).stdout
    assert deploy("teach", "RACK-1", "RIGHT-ARM", run_dir=run_dir).returncode == 2  # the name of a seat
    with Client(run_dir) as client:
        hold = client.submit("HOLD LEFT-ARM")
        busy = deploy("world", "reset", run_dir=run_dir)
        assert (busy.returncode, hold.number in busy.stderr) == (2, True)
        hold.halt()
        hold.wait(LIMIT_S)
    assert deploy("do", "SET MACS-NEW FRAME 80 -70 60 CM", run_dir=run_dir).returncode == 0
    assert deploy("world", "reset", run_dir=run_dir).returncode == 0
    with Client(run_dir) as client:
        (frame,) = client.world.view(keys=["MACS-NEW.frame"]).facts
    assert frame.value[:3] == pytest.approx([0.8, -0.8, 0.6])
    deploy("down", run_dir=run_dir)
    assert up(run_dir).returncode == 0  # again in the same directory
    assert sorted(rows(run_dir)) == sorted(NAMES)
    assert {"world.db", "journal.db", "logs"} <= {path.name for path in (run_dir / "previous").iterdir()}
    assert "P1" in deploy("names", "places", run_dir=run_dir).stdout
    assert deploy("do", "STOW RIGHT-ARM", "MOVE RIGHT-ARM TO P1", run_dir=run_dir).returncode == 0
    assert deploy("teach", "P1", "--forget", run_dir=run_dir).returncode == 0
    assert deploy("do", "MOVE RIGHT-ARM TO P1", run_dir=run_dir).returncode == 2
    ends_in_order(run_dir)
    assert json.loads(deploy("teach", "--json", run_dir=run_dir).stdout)["places"] == {}
