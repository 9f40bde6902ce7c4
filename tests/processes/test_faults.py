"""Processes of a real cluster die and hang in the middle of work; every command still ends as it should, once.

Exact arms in real time, two workers of each kind. Half a minute in all.
"""

from __future__ import annotations

import os
import random
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import pytest
import zmq

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.client.handle import CommandHandle
from rtc.protocol import messages as m
from rtc.protocol.outcomes import OutcomeKind
from rtc.runtime.process_table import processes
from tests.campaigns.chaos import Chaos, Strike

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

LIMIT_S = 60.0
ARM = "RIGHT-ARM"
AWAY = "MOVE RIGHT-ARM TO JOINTS -40 110 -160 0 50 0 DEG JOINT-MOTION"
STOW = "STOW RIGHT-ARM"


@pytest.fixture(scope="module")
def run_dir() -> Iterator[Path]:
    with own_cluster(mcm="kinematic", dim=3) as path:
        yield path


@pytest.fixture
def rtc(run_dir: Path) -> Iterator[Client]:
    with Client(run_dir) as client:
        assert client.run(STOW, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        yield client


@pytest.fixture
def chaos(run_dir: Path) -> Chaos:
    return Chaos(run_dir, random.Random(1))


def back(chaos: Chaos, strike: Strike | None) -> Strike:
    """Wait until it has come back."""
    assert strike is not None
    end = os.times().elapsed + LIMIT_S
    while strike.back_s is None:
        assert os.times().elapsed < end, f"{strike.name} did not come back"
        zmq.Poller().poll(5)  # leave the processor to those we wait for
        chaos.returned()
    return strike


def submit_and_move(rtc: Client, text: str) -> CommandHandle:
    """Its handle, once the arm moves."""
    samples = rtc.telemetry(silence_s=LIMIT_S)
    next(samples)
    command = rtc.submit(text)
    for sample in samples:
        if max(map(abs, sample.arms[ARM].velocities)) > 0.05:
            return command
    raise AssertionError("no telemetry")


def begun(run_dir: Path, command: CommandHandle | str) -> int:
    """How often the MCM began the first primitive of this command, in all its lives."""
    return len(re.findall(rf"begins {command}\.1(?:@\w+)?$", (run_dir / "logs" / "MCM.log").read_text(), re.MULTILINE))


def test_the_job_of_a_killed_worker_is_done_by_another(rtc: Client, chaos: Chaos, run_dir: Path) -> None:
    with Client(run_dir) as asking:
        struck: list[Strike] = []

        def kill_holder(note: m.ProgressNote) -> None:
            if note.phase is m.Phase.BINDING and not struck:
                for worker in asking.status().workers:
                    if worker.kind == "binder" and worker.busy_with.startswith(f"{note.command}/"):
                        struck.append(back(chaos, chaos.strike("worker", worker.name)))

        for text in 10 * [AWAY, STOW]:  # until one is met in the milliseconds of a bind
            end = rtc.run(text, kill_holder, LIMIT_S)
            assert end.outcome.kind is OutcomeKind.SUCCEEDED
            notes = asking.trace(end.command).notes
            again = [note for note in notes if note.kind is m.NoteKind.WORKER_LOST]
            if again:
                break
            struck.clear()
        assert [note.about for note in again] == [struck[0].name]
        assert begun(run_dir, end.command) == 1
        address = {row.name: row.node for row in processes(run_dir).values()}
        assert address[struck[0].name] == int(struck[0].name.partition("@")[2])  # under its address


@pytest.mark.parametrize("name", ["binder@2", "world", "broker"])
def test_one_that_is_stopped_is_found_and_replaced_and_the_work_goes_on(rtc: Client, run_dir: Path, name: str) -> None:
    stopper = Chaos(run_dir, random.Random(1), stop=True)
    strike = stopper.strike("any", name)
    ends = [rtc.run(text, timeout_s=LIMIT_S) for text in (AWAY, STOW)]
    assert {end.outcome.kind for end in ends} == {OutcomeKind.SUCCEEDED}
    assert (back(stopper, strike).back_s or LIMIT_S) < 10.0


def test_a_motion_goes_on_while_the_broker_is_dead_and_its_result_arrives(
    rtc: Client, chaos: Chaos, run_dir: Path
) -> None:
    command = submit_and_move(rtc, AWAY)
    strike = chaos.strike("broker")
    end = command.wait(LIMIT_S)
    assert end.outcome.kind is OutcomeKind.SUCCEEDED
    assert begun(run_dir, command) == 1
    assert back(chaos, strike).new_pid != strike.pid if strike else False
    with Client(run_dir) as asking:
        status = asking.status()
        assert status.counters["broker_restarts"] >= 1
        assert 0 < status.broker_uptime_s < status.uptime_s  # the cluster is older than its broker
        assert asking.trace(command.number).outcome == end.outcome


def test_a_command_keeps_its_programs_when_one_is_loaded_and_the_broker_restarts(
    rtc: Client, chaos: Chaos, run_dir: Path, tmp_path: Path
) -> None:
    """Given a command that waits for a paused one, a script is loaded, then the broker is killed; the command is
    elaborated after that, with the script it began with. A later command gets the new script."""
    script = tmp_path / "stow.yaml"
    script.write_text((files("rtc.programs") / f"default/elaborator/scripts/{script.name}").read_text())
    script.write_text(script.read_text().replace('label: "stow', 'label: "newly stow'))
    first = submit_and_move(rtc, AWAY)
    assert rtc.run(f"PAUSE {first}", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
    waiting = rtc.submit(f"{STOW} AFTER {first}")
    rtc.load("elaborator", script)
    try:
        back(chaos, chaos.strike("broker"))
        with Client(run_dir) as asking:
            assert first.number in {row.command for row in asking.status().commands}  # so the other still waits
        later = rtc.submit(f"{STOW} AFTER {waiting}")
        assert rtc.run(f"RESUME {first}", timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
        labels = {}
        for command in (waiting, later):
            assert command.wait(LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
            with Client(run_dir) as asking:
                labels[command.number] = {note.step for note in asking.trace(command.number).notes if note.step}
    finally:
        rtc.reset("elaborator")
    assert labels == {waiting.number: {"1 of 1: stow RIGHT-ARM"}, later.number: {"1 of 1: newly stow RIGHT-ARM"}}


def test_the_world_comes_back_with_all_that_was_believed(rtc: Client, chaos: Chaos) -> None:
    before = {fact.key: fact for fact in rtc.world.view().facts}
    strike = chaos.strike("world")
    after = {fact.key: fact for fact in rtc.world.view().facts}
    back(chaos, strike)
    assert after == before
    assert rtc.run(AWAY, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED


def test_what_a_killed_mcm_was_doing_is_lost_and_the_arm_stays_where_it_was(
    rtc: Client, chaos: Chaos, run_dir: Path
) -> None:
    command = submit_and_move(rtc, AWAY)
    strike = chaos.strike("mcm")
    end = command.wait(LIMIT_S)
    assert end.outcome.kind is OutcomeKind.LOST_SUBSYSTEM
    fact = rtc.world.view(keys=[f"{ARM}.joints"]).facts[0]
    assert fact.validity is m.Validity.SUSPECT
    back(chaos, strike)
    stow, away = 0.0, -40.0
    assert away < rtc.truth().joints[ARM][0] * 57.3 < stow  # on its way, not at home
    again = rtc.run(STOW, timeout_s=LIMIT_S)  # waits until rest is confirmed, and first reads where the arm stands
    assert again.outcome.kind is OutcomeKind.SUCCEEDED
    assert begun(run_dir, command) == 1


def test_what_was_queued_when_the_mcm_died_is_planned_from_where_the_arm_really_stands(
    rtc: Client, chaos: Chaos, run_dir: Path
) -> None:
    moving = submit_and_move(rtc, AWAY)
    queued = [rtc.submit(text) for text in (f"MOVE {ARM} BY 1 CM ALONG UP", STOW, AWAY)]
    strike = chaos.strike("mcm")
    assert moving.wait(LIMIT_S).outcome.kind is OutcomeKind.LOST_SUBSYSTEM
    outcomes = [command.wait(LIMIT_S).outcome for command in queued]
    assert [outcome.kind for outcome in outcomes] == [OutcomeKind.SUCCEEDED] * 3, outcomes
    assert outcomes[0].steps_done == 2  # it looked first where the arm stands
    back(chaos, strike)


def test_what_is_given_at_once_is_begun_in_the_order_given_while_workers_die(
    rtc: Client, chaos: Chaos, run_dir: Path
) -> None:
    commands = []
    for n in range(12):
        commands.append(rtc.submit(f"HOLD {ARM} FOR 0.1 SEC"))
        if n % 4 == 0:
            chaos.strike("worker")
    assert {command.wait(LIMIT_S).outcome.kind for command in commands} == {OutcomeKind.SUCCEEDED}
    begun_at_s = [
        note.at_s for command in commands for note in rtc.trace(command.number).notes if note.kind is m.NoteKind.STARTED
    ]
    assert len(begun_at_s) == len(commands)
    assert begun_at_s == sorted(begun_at_s)


TIED = """
import sys
from rtc.client.client import Client
rtc = Client(sys.argv[1], halt_if_lost=True)
print(rtc.submit(sys.argv[2]), flush=True)
rtc.submit(sys.argv[2]).wait()
"""


def test_the_commands_of_a_dead_client_are_halted_if_it_wanted_that(rtc: Client, run_dir: Path) -> None:
    free = rtc.submit("HOLD LEFT-ARM")
    words = [sys.executable, "-c", TIED, str(run_dir), "HOLD RIGHT-ARM FOR 60 SEC"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        command = other.stdout.readline().strip()
        other.kill()
    record = None
    for event in rtc.events(silence_s=LIMIT_S):
        if event.command == command and isinstance(event, m.CommandEnded):
            record = rtc.trace(command)
            break
    assert record is not None
    assert record.outcome is not None
    assert record.outcome.kind is OutcomeKind.HALTED
    assert any("its client disconnected" in note.message for note in record.notes)  # wording: why
    assert rtc.trace(free.number).phase is m.Phase.EXECUTING  # no other command was halted
    free.halt()
    assert free.wait(LIMIT_S).outcome.kind is OutcomeKind.HALTED


def test_all_at_once(rtc: Client, chaos: Chaos, run_dir: Path) -> None:
    """Everything but the MCM is killed in the middle of a motion."""
    command = submit_and_move(rtc, AWAY)
    for name in [row.name for row in processes(run_dir).values() if row.name != "MCM"]:
        chaos.strike("any", name)
    assert command.wait(LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
    assert begun(run_dir, command) == 1
    assert rtc.run(STOW, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
    for strike in chaos.strikes:
        back(chaos, strike)


def test_a_cluster_without_workers_gets_them_with_its_first_command(tmp_path_factory: pytest.TempPathFactory) -> None:
    where = ["--run-dir", str(tmp_path_factory.mktemp("p"))]
    deploy = [sys.executable, "-P", "-m", "rtc.apps.cli.entry"]
    subprocess.run([*deploy, "up", "-d", "--mcm", "kinematic", "--least", "0", *where], check=True, timeout=LIMIT_S)
    try:
        with Client(where[1]) as rtc:
            assert rtc.status().workers == []
            assert rtc.run(STOW, timeout_s=LIMIT_S).outcome.kind is OutcomeKind.SUCCEEDED
            names = {worker.name for worker in rtc.status().workers}
        assert names >= {"parser@0", "elaborator@1", "binder@2", "analyzer@3"}  # more where one was slow to come
    finally:
        subprocess.run([*deploy, "down", *where], check=True, timeout=LIMIT_S)
