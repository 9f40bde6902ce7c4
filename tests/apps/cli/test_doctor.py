"""`rtc doctor`: each trouble is a warning that names what would mend it; without a cluster it works too."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest

from rtc.apps.cli import doctor
from rtc.protocol import messages as m
from tests.apps.cli.in_process import call

STATUS: dict[str, Any] = {
    "cluster": "abcd",
    "run_dir": "/run",
    "uptime_s": 12.0,
    "supervisor_silent_s": 0.2,
    "processes": [
        {"name": "MCM", "state": "ready", "restarts": 0},
        {"name": "MCM-template", "state": "pending", "restarts": 0},
    ],
    "subsystems": [{"name": "MCM", "state": "connected", "injected": []}],
    "resources": [{"name": "LEFT-ARM", "owner": "C-1"}],
    "queues": {"binder": 1},
    "decision_ms": {"p99": 1.5},
}


def warnings(status: dict[str, Any]) -> list[str]:
    return [one.about for one in doctor.of_status(msgspec.convert(status, m.Status)) if one.mend]


def changed(place: str, **values: object) -> dict[str, Any]:
    """STATUS with values changed in the first row of a list."""
    first, *rest = STATUS[place]
    return STATUS | {place: [first | values, *rest]}


def test_a_cluster_in_order_has_no_warning():
    assert warnings(STATUS) == []


@pytest.mark.parametrize(
    ("status", "about"),
    [
        (STATUS | {"supervisor_silent_s": 9.0}, "supervisor"),
        (changed("processes", state="crash loop"), "processes"),
        (changed("processes", restarts=2), "processes"),
        (changed("subsystems", state="lost"), "MCM"),
        (changed("subsystems", injected=["F-1: joint_2 of LEFT-ARM sticks"]), "MCM"),
        (changed("resources", quarantine="MCM"), "LEFT-ARM"),
        (STATUS | {"decision_ms": {"p99": 50.0}}, "broker"),
    ],
)
def test_each_trouble_of_a_cluster_is_a_warning(status, about):
    assert warnings(status) == [about]


def test_the_load_is_judged_by_the_cores():
    assert not doctor.of_load(1.9, 2).mend
    assert doctor.of_load(2.1, 2).mend
    assert doctor.of_load(0.0, 1).mend


def test_memory_and_priority():
    assert not doctor.of_memory("MemTotal: 9 kB\nMemAvailable:    4000000 kB\n").mend
    assert doctor.of_memory("MemAvailable:    4000 kB\n").mend
    assert "rtprio" in doctor.of_priority(False).mend
    assert not doctor.of_priority(True).mend


def telemetry(at_s: float, ticks: int, late: int) -> m.Telemetry:
    return m.Telemetry(subsystem="MCM", at_s=at_s, sim_s=at_s, ticks=ticks, late_ticks=late, arms={})


@pytest.mark.parametrize(("late", "warned"), [(3, False), (300, True)])
def test_late_ticks_count_from_now_on(late, warned):
    samples = [telemetry(0.1 * n, 100 * n, 5000 + late * n // 10) for n in range(12)]
    (one,) = doctor.of_ticks(iter(samples))
    assert bool(one.mend) is warned


def test_an_mcm_without_telemetry_is_a_warning():
    (one,) = doctor.of_ticks(iter([]))
    assert one.mend


def test_the_slowest_job_is_named_with_its_command():
    note = m.ProgressNote(seq=1, at_s=0.0, command="C-1", phase=m.Phase.BINDING, node="binder@2", took_s=0.2)
    slow = msgspec.structs.replace(note, command="C-2", node="elaborator@1", took_s=9.0)
    mcm = msgspec.structs.replace(note, node="MCM", took_s=60.0)
    about = {"source": "operator", "request": "r", "accepted_at_s": 0.0, "phase": m.Phase.ENDED}
    records = [
        m.CommandRecord(command="C-1", text="X", notes=[note, mcm], **about),
        m.CommandRecord(command="C-2", text="X", notes=[slow], **about),
    ]
    (one,) = doctor.of_work(records)
    assert "elaborator@1 for C-2" in one.found
    assert one.mend
    assert list(doctor.of_work([])) == []


def test_without_a_cluster_the_machine_is_checked_and_the_status_tells(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (0.1, 0.1, 0.1))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(doctor, "may_be_real_time", lambda rank: True)
    monkeypatch.setattr(doctor, "compiled", lambda: True)
    monkeypatch.setattr(doctor, "MIN_MEMORY", 0)
    monkeypatch.setattr(doctor, "MIN_DISK", 0)
    done = call("doctor", "--json", "--run-dir", str(tmp_path / "none"))
    report = json.loads(done.stdout)
    assert (done.returncode, report["ok"]) == (0, True)
    assert {"load", "rtc", "libraries", "disk", "cluster"} <= {one["about"] for one in report["findings"]}
    monkeypatch.setattr(doctor, "may_be_real_time", lambda rank: False)
    assert call("doctor", "--run-dir", str(tmp_path / "none")).returncode == 1
