"""The package of docs/own-mechanism.md, as the page shows it: its own test passes, and its steps survive faults."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.messages import NoteKind, Phase, ProgressNote, Validity
from rtc.protocol.outcomes import Outcome, OutcomeKind, StopReason

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

PAGE = Path(__file__).parents[2] / "docs" / "own-mechanism.md"
LIMIT_S = 60.0
FILES = {"toml": ["pyproject.toml"], "python": ["grounding.py", "test_grounding.py"]}
FILES["yaml"] = ["grounding.yaml", "cell.yaml"]

#: a second mechanism: what it does wrong depends on the amount of the sentence
HOSTILE = """
from workers.mechanisms.mechanism import Mechanism
def ready(candidate):
    n = round(100 * candidate.figures["amount_m"])
    if n == 1:
        raise SystemExit
    if n == 2:
        return 3
    while n == 3:
        pass
def done(task, validity):
    raise KeyboardInterrupt
MECHANISM = Mechanism(name="hostile", needs={"hostile.ready": ready}, effects={"hostile.done": done})
"""
ODD = """
parser: |
  %extend work: ODD hand amount maintain reflex -> command
  ODD: "ODD"
elaborator:
  decision_tree: [{verb: ODD, script: odd}]
  command_object_table: [{verb: ODD, values: {}}]
  scripts:
    - script: odd
      case: 1
      uses: [hand, amount]
      needs: [hostile.ready]
      steps: [{do: hold, stop: hold, label: wait, args: {duration_s: 0.1}, words: {effect: hostile.done}}]
"""


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The files of the page in a folder, on the path as an installation would leave them."""
    folder = tmp_path_factory.mktemp("grounding")
    for language, names in FILES.items():
        for name, text in zip(names, blocks(language), strict=True):
            (folder / name).write_text(text)
    (folder / "hostile.py").write_text(HOSTILE)
    points = tomllib.loads((folder / "pyproject.toml").read_text())["project"]["entry-points"]
    points["rtc.mechanisms"]["hostile"] = "hostile:MECHANISM"
    info = folder / "grounding-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: grounding\nVersion: 1.0\n")
    rows = [f"[{group}]\n" + "".join(f"{n} = {p}\n" for n, p in of.items()) for group, of in points.items()]
    (info / "entry_points.txt").write_text("".join(rows))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
        yield folder


def test_the_test_of_the_page_passes(package: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "rtc",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        str(package / "test_grounding.py"),
    ]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=package)
    assert ran.returncode == 0, ran.stdout[-4000:]


@pytest.fixture(scope="module")
def rtc(package: Path) -> Iterator[Client]:
    """A client of a cluster whose right arm holds a module, of whose charge nothing is known."""
    cell = str(package / "cell.yaml")
    with own_cluster(cell=cell, mcm="kinematic", speed="max", dim=2) as run_dir, Client(run_dir) as rtc:
        rtc.load_sections(package / "grounding.yaml")
        for sentence in ("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "EXTRACT MACS-NEW FROM RACK-1", "LOCATE MACS-NEW"):
            assert rtc.run(sentence, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        yield rtc


def charge(rtc: Client) -> tuple[object, Validity]:
    (fact,) = rtc.world.view(keys=["MACS-NEW.charge"]).facts
    return fact.value, fact.validity


def test_a_step_that_has_gone_wrong_leaves_a_doubt_and_its_advice_leads_on(rtc: Client) -> None:
    def end(sentence: str) -> Outcome:
        return rtc.run(sentence, timeout_s=LIMIT_S).outcome

    assert end("LIFT MACS-NEW BY 1 CM MAINTAIN GRIP-FORCE 15 N").kind is OutcomeKind.SUCCEEDED
    failed = end("GROUND MACS-NEW")
    assert (failed.kind, failed.stop) == (OutcomeKind.FAILED, StopReason.SLIP)
    assert "15 N" in failed.message  # wording: the placeholder of the package is filled in
    assert charge(rtc) == (None, Validity.SUSPECT)
    assert end("ALIGN MACS-NEW TO BAY-2").kind is OutcomeKind.REFUSED
    assert failed.refusal is not None
    (advice,) = failed.refusal.clears
    for sentence in (*advice.sentences, "GROUND MACS-NEW"):
        assert end(sentence).kind is OutcomeKind.SUCCEEDED
    assert charge(rtc) == ("NONE", Validity.VALID)


def test_a_fact_of_the_package_is_stated_and_judged_by_it(rtc: Client) -> None:
    ends = [rtc.run(f"SET MACS-NEW CHARGE {value}", timeout_s=LIMIT_S).outcome for value in ("MUCH", "SOME")]
    assert [end.kind for end in ends] == [OutcomeKind.REFUSED, OutcomeKind.SUCCEEDED]
    assert charge(rtc) == ("SOME", Validity.VALID)


def test_a_function_that_fails_refuses_the_sentence_and_ends_no_worker(rtc: Client, tmp_path: Path) -> None:
    """In an analyzer an interrupt; in an elaborator an exit, an odd value, an endless loop. A program whose first job
    fails is taken back, so the elaborator does well first."""
    (tmp_path / "odd.yaml").write_text(ODD)
    rtc.load_sections(tmp_path / "odd.yaml")
    workers = {row.pid for row in rtc.status().workers}
    for amount in (4, 1, 2, 3):
        end = rtc.run(f"ODD LEFT-ARM BY {amount} CM", timeout_s=LIMIT_S).outcome
        assert end.kind is not OutcomeKind.SUCCEEDED
        assert "mechanism hostile" in end.message  # wording: it names the package
    assert workers <= {row.pid for row in rtc.status().workers}
    assert rtc.run("STOW LEFT-ARM", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED


def test_a_worker_that_is_killed_in_a_job_of_the_package_is_replaced(rtc: Client) -> None:
    """While its sentence is planned, or its step bound or judged; another worker does the job."""
    killed = set[int]()

    def kill(note: ProgressNote) -> None:
        if note.phase in (Phase.ELABORATING, Phase.BINDING, Phase.ANALYZING) and len(killed) < 2:
            for row in asking.status().workers:
                if row.busy_with.startswith(f"{note.command}/") and row.pid not in killed:
                    killed.add(row.pid)
                    os.kill(row.pid, signal.SIGKILL)

    with Client(rtc.run_dir) as asking:
        for _ in range(10):  # until one is met in the milliseconds of a job
            end = rtc.run("GROUND MACS-NEW", kill, LIMIT_S)
            assert end.outcome.kind is OutcomeKind.SUCCEEDED
            if any(note.kind is NoteKind.WORKER_LOST for note in asking.trace(end.command).notes):
                return
    raise AssertionError("no worker was met in a job")
