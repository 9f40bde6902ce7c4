"""Trouble made on purpose: who is hit, and when each is back; on processes that do nothing else."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys

import pytest

from rtc.protocol.outcomes import NoCluster
from rtc.runtime.process import now_s
from rtc.runtime.process_table import processes
from rtc.runtime.settings import Settings
from tests.campaigns.chaos import Chaos

pytestmark = [pytest.mark.slow, pytest.mark.untimed]


class Supervised:
    """Processes, and the report of them that a supervisor writes."""

    def __init__(self, path):
        self.path, self.running, self.rows = path, [], {}

    def start(self, name, node=None, state="ready"):
        self.running.append(subprocess.Popen([sys.executable, "-S", "-E", "-c", "import signal; signal.pause()"]))
        pid = self.running[-1].pid
        self.rows[name] = {"name": name, "pid": pid, "state": state, "restarts": 0, "since_s": now_s(), "node": node}
        (self.path / "supervisor.json").write_text(json.dumps({"processes": list(self.rows.values())}))
        return pid

    def ended(self, pid):
        return next(process for process in self.running if process.pid == pid).wait(10)


@pytest.fixture
def cluster(tmp_path):
    Settings(run_dir=str(tmp_path)).save()
    made = Supervised(tmp_path)
    yield made
    for process in made.running:
        process.kill()
        process.wait()


def chaos(cluster, **how):
    return Chaos(cluster.path, random.Random(1), **how)


def test_only_who_is_meant_and_at_work_is_hit(cluster):
    cluster.start("broker")
    cluster.start("parser@0", node=0, state="starting")
    pid = cluster.start("binder@2", node=2)
    maker = chaos(cluster)
    assert maker.strike("worker").pid == pid
    assert cluster.ended(pid) == -9
    assert maker.strike("worker") is None  # no process is hit twice
    assert maker.strike("world") is None


def test_one_is_back_when_another_process_of_its_name_is_ready(cluster):
    pid = cluster.start("MCM")
    maker = chaos(cluster)
    strike = maker.strike("mcm")
    assert (maker.returned(), maker.missing) == ([], [strike])
    new = cluster.start("MCM", state="starting")
    assert maker.returned() == []
    cluster.rows["MCM"]["state"] = "ready"
    new = cluster.start("MCM")
    assert maker.returned() == [strike]
    assert (strike.pid, strike.new_pid, maker.missing) == (pid, new, [])
    assert 0 < strike.back_s < 10
    assert maker.returned() == []  # reported once


def test_a_process_that_ended_by_itself_is_not_taken_for_another(cluster):
    pid = cluster.start("world")
    os.kill(pid, 9)
    cluster.ended(pid)
    assert chaos(cluster).strike("world") is None


def test_the_same_seed_hits_the_same(cluster):
    for node in range(8):
        cluster.start(f"parser@{4 * node}", node=4 * node)
    makers = [chaos(cluster, stop=True) for _ in range(2)]
    names = [[maker.strike("any").name for _ in range(4)] for maker in makers]
    assert names[0] == names[1]
    assert len(set(names[0])) == 4


def test_without_a_cluster_it_says_so(tmp_path):
    with pytest.raises(NoCluster, match="rtc up"):
        processes(tmp_path)
