"""The files of deploy/engines: each line of a worker that they contain is one that our own parsers accept."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from argparse import Namespace
from pathlib import Path
from typing import Any

import pytest
import yaml

from broker.dispatch.worker_registry import DEADLINE_S
from broker.gateway.sessions import PEERS_OF_KEY
from rtc.protocol.messages import WorkerKind
from workers.__main__ import parser
from workers.runtime import health
from workers.runtime.contact import LIMIT_S

ENGINES = Path(__file__).parents[2] / "deploy" / "engines"
PYTHON = "/opt/telerobot-rtc/.venv/bin/python"
MAX_JOB_S = max(DEADLINE_S.values())


def worker(line: list[str], python: str = PYTHON) -> Namespace:
    """The options of the line of a worker, parsed by the worker's own parser."""
    assert line[:4] == [python, "-m", "rtc", "workers"]
    given = parser().parse_args(line[4:])
    assert given.kind == WorkerKind.BINDER
    assert given.node is None  # all replicas have the same line
    return given


def unit() -> dict[str, str]:
    """The settings of the systemd unit."""
    lines = (ENGINES / "rtc-worker@.service").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))


# --- Kubernetes ----------------------------------------------------------------------------------------


@pytest.fixture
def pod() -> dict[str, Any]:
    deployment = yaml.safe_load((ENGINES / "kubernetes.yaml").read_text())
    assert (deployment["apiVersion"], deployment["kind"]) == ("apps/v1", "Deployment")
    spec = deployment["spec"]
    assert spec["selector"]["matchLabels"] == spec["template"]["metadata"]["labels"]
    assert spec["replicas"] <= PEERS_OF_KEY
    return spec["template"]["spec"]  # type: ignore[no-any-return]


def test_kubernetes_starts_a_worker_with_the_secret_and_a_health_file(pod: dict[str, Any]) -> None:
    (container,) = pod["containers"]
    given = worker(container["command"], python="python")
    mounts = {mount["name"]: mount["mountPath"] for mount in container["volumeMounts"]}
    volumes = {volume["name"]: volume for volume in pod["volumes"]}
    assert mounts.keys() == volumes.keys()
    assert str(given.key.parent) == mounts["key"]
    assert str(given.health.parent) == mounts["run"]
    assert volumes["key"]["secret"]["defaultMode"] == 0o440
    assert pod["securityContext"]["fsGroup"] == pod["securityContext"]["runAsUser"] > 0


def test_kubernetes_probes_the_health_file_of_the_worker(pod: dict[str, Any]) -> None:
    (container,) = pod["containers"]
    given = worker(container["command"], python="python")
    within = {}
    for name in ("startupProbe", "readinessProbe", "livenessProbe"):
        command = container[name]["exec"]["command"]
        assert command[:4] == ["python", "-m", "rtc", "workers.runtime.health"]
        probe = health.parser().parse_args(command[4:])
        assert probe.file == given.health
        within[name] = probe.within
    assert MAX_JOB_S < within["readinessProbe"] < within["livenessProbe"]
    assert within["livenessProbe"] > LIMIT_S + MAX_JOB_S  # a worker that can end by itself does so first


def test_kubernetes_waits_for_the_job_in_progress(pod: dict[str, Any]) -> None:
    assert pod["terminationGracePeriodSeconds"] > MAX_JOB_S


# --- Nomad ---------------------------------------------------------------------------------------------


def test_nomad_starts_a_worker_with_the_secret_and_waits_for_its_job() -> None:
    text = re.sub(r"\s#.*", "", (ENGINES / "workers.nomad.hcl").read_text())
    assert text.count("{") == text.count("}")
    settings = dict(re.findall(r"^\s*(\w+)\s*=\s*(.+?)\s*$", text, re.MULTILINE))
    given = worker([json.loads(settings["command"]), *json.loads(settings["args"])])
    assert str(given.key) == json.loads(settings["destination"]).replace("secrets", "${NOMAD_SECRETS_DIR}")
    assert json.loads(settings["kill_signal"]) == "SIGTERM"
    assert int(json.loads(settings["kill_timeout"]).removesuffix("s")) > MAX_JOB_S
    assert int(settings["count"]) <= PEERS_OF_KEY


# --- systemd -------------------------------------------------------------------------------------------


def test_systemd_starts_a_worker_of_the_kind_in_the_name_of_the_instance() -> None:
    """The line is unescaped as systemd does, and its shell runs with another program in the place of Python."""
    settings = unit()
    match = re.fullmatch(r"/bin/sh -c '(.*)' %i", settings["ExecStart"])
    assert match is not None
    script = match[1].replace("$$", "$").replace("%%", "%")
    assert f"exec {PYTHON} " in script
    shown = subprocess.run(
        ["/bin/sh", "-c", script.replace(f"exec {PYTHON}", r"printf '%s\n'"), "binder-1"],
        env={"CREDENTIALS_DIRECTORY": "/run/credentials/x"},
        capture_output=True,
        text=True,
        check=True,
    )
    given = worker([PYTHON, *shown.stdout.splitlines()])
    name, _, path = settings["LoadCredential"].partition(":")
    assert str(given.key) == f"/run/credentials/x/{name}"
    assert Path(path).is_absolute()


def test_systemd_watches_the_answers_of_the_broker() -> None:
    settings = unit()
    assert (settings["Type"], settings["Restart"]) == ("notify", "always")
    assert int(settings["WatchdogSec"]) > LIMIT_S + MAX_JOB_S
    assert int(settings["TimeoutStopSec"]) > MAX_JOB_S


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_accepts_the_unit() -> None:
    done = subprocess.run(
        ["systemd-analyze", "verify", ENGINES / "rtc-worker@.service"], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")


# --- Slurm ---------------------------------------------------------------------------------------------


def test_slurm_starts_a_worker_with_the_given_key(tmp_path: Path) -> None:
    """The script runs in its shell, with another program in the place of srun."""
    script = ENGINES / "workers.sbatch"
    (tmp_path / "srun").write_text("#!/bin/sh\nprintf '%s\\n' \"$@\"\n")
    (tmp_path / "srun").chmod(0o700)

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {"PATH": f"{tmp_path}:/usr/bin:/bin"}
        return subprocess.run(["bash", script, *arguments], env=environment, capture_output=True, text=True)

    step, *line = run("w1.key").stdout.splitlines()
    assert step.startswith("--ntasks")
    assert worker(line).key == Path("w1.key")
    assert run().returncode != 0  # without a key


def test_slurm_signals_the_worker_before_the_time_limit() -> None:
    text = (ENGINES / "workers.sbatch").read_text()
    options = dict(re.findall(r"^#SBATCH --([\w-]+)=(\S+)$", text, re.MULTILINE))
    name, _, before = options["signal"].partition("@")
    assert name == "TERM"  # without "B:" it reaches the steps, and not the script alone
    assert int(before) > MAX_JOB_S
    first, _, last = options["array"].partition("-")
    assert int(last) - int(first) < PEERS_OF_KEY


# --- all -----------------------------------------------------------------------------------------------


def test_the_page_names_every_launcher() -> None:
    page = (ENGINES / "README.md").read_text()
    files = {path.name for path in ENGINES.iterdir() if path.is_file()} - {"__init__.py", "README.md"}
    assert not {name for name in files if name.removesuffix(".py") not in page}
