"""The command line on a real cluster (exact arms, as fast as possible): output, JSON line and exit status."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from PIL import Image
from prompt_toolkit.application import create_app_session
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput

import rtc as rtc_package
from broker.decisions.state import State
from broker.persistence.journal import Journal
from rtc.apps.cli.interpreter import interpret, obey_lines
from rtc.apps.cli.live_state import LiveState, in_words
from rtc.client.client import Client
from rtc.protocol import messages as m
from rtc.protocol.faults import JammedSeat, SlowLoop
from rtc.protocol.outcomes import RequestDeclined
from tests.apps.cli.in_process import call

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

RTC = [sys.executable, "-P", "-m", "rtc.apps.cli.main"]
LIMIT_S = 30.0
Run = Callable[..., subprocess.CompletedProcess[str]]


def command(*words: str, run_dir: Path | None = None) -> subprocess.CompletedProcess[str]:
    more = ["--run-dir", str(run_dir)] if run_dir else []
    return subprocess.run([*RTC, *words, *more], capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    run_dir = tmp_path_factory.mktemp("rtc")
    up = command("up", "-d", "--mcm", "kinematic", "--speed", "max", run_dir=run_dir)
    assert up.returncode == 0, up.stdout + up.stderr
    yield run_dir
    down = command("down", run_dir=run_dir)
    assert down.returncode == 0, down.stdout + down.stderr


@pytest.fixture(scope="module")
def rtc(run_dir: Path) -> Run:
    return lambda *words: call(*words, "--run-dir", str(run_dir))


def last_json(done: subprocess.CompletedProcess[str]) -> Any:
    return json.loads(done.stdout.splitlines()[-1])


def test_no_cluster_is_exit_status_4_with_what_to_do(tmp_path: Path) -> None:
    where = ["--run-dir", str(tmp_path)]
    answers = [
        call(*words, *where) for words in (["do", "STOW LEFT-ARM"], ["halt"], ["trace", "C-1"], ["world", "list"])
    ]
    for done in (command("status", run_dir=tmp_path), *answers):
        assert done.returncode == 4, done.args
        assert "rtc up -d" in done.stderr
        assert "Traceback" not in done.stderr


def test_do_succeeds_with_0_and_one_result(rtc: Run) -> None:
    done = rtc("do", "STOW LEFT-ARM", "--json")
    result = last_json(done)

    assert done.returncode == 0, done.stdout + done.stderr
    assert [one["kind"] for one in result["results"]] == ["succeeded"]
    assert result["results"][0]["command"].startswith("C-")


def test_a_wrong_sentence_is_2_with_a_caret_and_the_next_is_not_sent(rtc: Run) -> None:
    done = rtc("do", "STOW LEFT-LEG", "STOW LEFT-ARM")

    assert done.returncode == 2
    lines = done.stdout.splitlines()
    caret = next(n for n, line in enumerate(lines) if line.strip() == "^")
    assert lines[caret - 1][lines[caret].index("^") :] == "LEFT-LEG"
    assert any(line.startswith("NOT SENT") for line in lines)


def test_keep_going_sends_the_next_too(rtc: Run) -> None:
    done = rtc("do", "STOW LEFT-LEG", "STOW LEFT-ARM", "-k", "--json")

    assert done.returncode == 2
    assert [one["kind"] for one in last_json(done)["results"]] == ["refused", "succeeded"]


def test_two_arms_at_once(rtc: Run) -> None:
    done = rtc("do", "--parallel", "STOW LEFT-ARM", "STOW RIGHT-ARM", "--json")

    assert done.returncode == 0, done.stdout
    assert [one["text"] for one in last_json(done)["results"]] == ["STOW LEFT-ARM", "STOW RIGHT-ARM"]


def test_no_wait_gives_the_number_at_once(rtc: Run) -> None:
    done = rtc("do", "STOW LEFT-ARM", "--no-wait", "--json")

    assert done.returncode == 0
    assert last_json(done)["results"][0]["kind"] == "accepted"


def test_halt_prints_a_latency_and_confirms_rest(rtc: Run) -> None:
    done = rtc("halt", "--json")
    result = last_json(done)

    assert done.returncode == 0, done.stdout + done.stderr
    assert result["confirmed"]
    assert result["latency_s"] > 0
    assert "halt" in result["sent_to"]  # and estop, unless there is rest before that socket is connected


def test_a_lone_halt_submitted_to_do_is_that_halt(rtc: Run) -> None:
    done = rtc("do", "HALT ALL")

    assert done.returncode == 0
    assert done.stdout.startswith("HALT ALL: ")
    assert "rest confirmed" in done.stdout


@pytest.mark.parametrize("words", [["C-9999"], ["RIHGT-ARM"], ["--all"], ["RIGHT", "ARM", "--timeout", "soon"]])
def test_a_halt_of_an_unknown_scope_halts_everything_and_says_so(rtc: Run, words: list[str]) -> None:
    done = rtc("halt", *words, "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    result = last_json(done)
    assert (result["scope"], result["confirmed"]) == ("ALL", True)


def test_trace_and_why_tell_the_story(rtc: Run) -> None:
    text = "STOW LEFT-ARM MAINTAIN TIME-LIMIT 80 SEC"  # of no test before, so that a parser reads it
    number = last_json(rtc("do", text, "--json"))["results"][0]["command"]
    trace, why = rtc("trace", number, "--json"), rtc("why", number)

    nodes = {note.get("node", "") for note in last_json(trace)["notes"]}
    assert {"parser@0", "elaborator@1", "binder@2"} <= nodes
    assert last_json(trace)["case"] == 1
    assert why.stdout.startswith(f"{number} was given by the operator: {text}")
    assert "decision: SUCCEEDED" in why.stdout


def test_the_jobs_of_a_command_give_the_same_bytes_in_a_fresh_process(rtc: Run) -> None:
    done = rtc("do", "MOVE LEFT-ARM BY 2 CM ALONG Z", "--json")
    assert done.returncode == 0
    repeated = rtc("replay", last_json(done)["results"][0]["command"], "--json")
    assert repeated.returncode == 0
    kinds = [job["kind"] for job in last_json(repeated)["jobs"]]
    assert kinds == ["parser", "elaborator", "binder", "analyzer"]


def test_why_without_a_number_is_of_the_last_command_and_log_lists_it(rtc: Run) -> None:
    number = last_json(rtc("do", "STOW RIGHT-ARM", "--json"))["results"][0]["command"]
    log = last_json(rtc("log", "-n", "2", "--json"))["commands"]

    assert last_json(rtc("why", "--json"))["command"] == number
    assert last_json(rtc("trace", number.removeprefix("C-"), "--json"))["command"] == number
    assert [log[-1][key] for key in ("command", "text", "outcome")] == [number, "STOW RIGHT-ARM", "succeeded"]
    assert len(log) == 2


def test_an_unknown_command_is_2_in_one_sentence(rtc: Run) -> None:
    done = rtc("trace", "C-9999")

    assert done.returncode == 2
    assert "C-9999" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_command_of_the_run_before_is_found_with_previous(rtc: Run, run_dir: Path) -> None:
    text = "HOLD LEFT-ARM FOR 1 SEC"
    record = m.CommandRecord(
        command="C-8000", text=text, source="operator", request="r", accepted_at_s=1.0, phase=m.Phase.ENDED
    )
    journal = Journal.open(run_dir / "previous" / "journal.db", "run", State())
    journal.append([], [record])
    journal.close()

    assert "an earlier run had one: add --previous" in " ".join(rtc("why", "8000").stderr.split())
    assert "HOLD LEFT-ARM FOR 1 SEC" in rtc("why", "8000", "--previous").stdout
    assert rtc("log", "--previous").stdout.startswith("of the run that ended at ")


def test_status_names_every_worker(rtc: Run) -> None:
    shown, result = rtc("status"), last_json(rtc("status", "--json"))

    for name in ("parser@0", "elaborator@1", "binder@2", "analyzer@3", "broker", "MCM", "world"):
        assert name in shown.stdout
    assert {worker["name"] for worker in result["workers"]} == {"parser@0", "elaborator@1", "binder@2", "analyzer@3"}


def test_status_names_the_file_of_a_program_and_may_be_watched(rtc: Run, tmp_path: Path) -> None:
    file = tmp_path / "my_lift.yaml"
    file.write_bytes((Path(rtc_package.__file__).parent / "programs/default/elaborator/scripts/lift.yaml").read_bytes())
    assert rtc("load", str(file), "INTO", "elaborator").returncode == 0
    watched = rtc("status", "--watch", "--every", "100ms", "--for", "1s")

    assert watched.returncode == 0
    assert watched.stdout.count("elaborator my_lift.yaml (loaded ") >= 2
    assert watched.stdout.count("no command in progress") >= 2


def test_world_get_list_history_at(rtc: Run) -> None:
    fact = last_json(rtc("world", "get", "macs_new.frame", "--json"))["facts"][0]
    history = last_json(rtc("world", "history", "MACS-NEW.frame", "--json"))["facts"]
    then = last_json(rtc("world", "at", str(fact["version"]), "MACS-NEW.frame", "--json"))["facts"]

    assert fact["validity"] == "valid"
    assert history[0]["version"] == fact["version"]
    assert then[0]["value"] == fact["value"]
    assert "RIGHT-ARM.joints" in rtc("world", "list").stdout


def test_look_draws_the_scene_and_tells_what_is_not_where_it_is_believed(
    rtc: Run, run_dir: Path, tmp_path: Path
) -> None:
    with Client(run_dir, need_broker=False) as bench:
        bench.displace("MACS-OLD", [0.03, 0.0, 0.0, 0.0, 0.0, 0.0])
        try:
            done = rtc("look", "-o", str(tmp_path / "a.png"), "--json")
            watched = rtc("look", "-o", str(tmp_path / "b.png"), "--watch", "--every", "100ms", "--for", "200ms")
        finally:
            bench.displace("MACS-OLD", [-0.03, 0.0, 0.0, 0.0, 0.0, 0.0])
    module = next(row for row in last_json(done)["objects"] if row["name"] == "MACS-OLD")

    assert module["off_m"] == pytest.approx(0.03)
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "b.png").read_bytes().startswith(b"\x89PNG")
    assert all("MACS-OLD 30.0 mm off" in line for line in watched.stdout.splitlines())
    assert len(watched.stdout.splitlines()) >= 1
    assert rtc("look", "--camera", "nowhere").returncode == 2


def test_a_camera_locates_a_module_that_has_moved(rtc: Run, run_dir: Path, tmp_path: Path) -> None:
    with Client(run_dir, need_broker=False) as bench:
        bench.displace("MACS-OLD", [0.02, 0.0, 0.0, 0.0, 0.0, 0.05])
        try:
            done = rtc("picture", "CAMERA-2", "--locate", "--json", "-o", str(tmp_path / "a.png"))
        finally:
            bench.displace("MACS-OLD", [-0.02, 0.0, 0.0, 0.0, 0.0, -0.05])
    bodies = {row["name"]: row for row in last_json(done)["bodies"]}

    assert bodies["MACS-OLD"]["off_m"] == pytest.approx(0.02, abs=0.002)
    assert bodies["MACS-OLD"]["turned_rad"] == pytest.approx(0.05, abs=0.01)
    assert bodies["MACS-NEW"]["cause"] == "out of view"


def until_listed(faults: list[str], status: Callable[[], m.Status]) -> list[str]:
    """The MCM reports faults to the broker after its answer to `rtc inject`."""
    end = os.times().elapsed + LIMIT_S
    while True:
        listed = next(row for row in status().subsystems if row.name == "MCM").injected
        if listed == faults or os.times().elapsed > end:
            return listed


def test_injected_faults_are_in_the_status_until_they_are_undone(rtc: Run, run_dir: Path, tmp_path: Path) -> None:
    assert rtc("inject", "blind", "camera_1").returncode == 0
    active = last_json(rtc("inject", "displace", "MACS-OLD", "--by", "0,0.02,0", "--turn", "0,0,3", "--json"))["active"]
    assert [words.split(" by ")[0] for words in active] == ["blind CAMERA-1", "displace MACS-OLD"]
    assert until_listed(active, lambda: msgspec.convert(last_json(rtc("status", "--json")), m.Status)) == active
    picture = rtc("picture", "CAMERA-1", "-o", str(tmp_path / "dark.png"))
    assert picture.returncode == 0, picture.stderr
    assert Image.open(tmp_path / "dark.png").convert("L").getextrema() == (0, 0)

    assert last_json(rtc("inject", "undo", "blind", "CAMERA-1", "--json"))["active"] == active[1:]
    assert last_json(rtc("inject", "undo", "all", "--json"))["active"] == []
    with Client(run_dir) as client:
        assert client.undo_fault().active == []
        assert until_listed([], client.status) == []
        with pytest.raises(RequestDeclined, match="BAY-2, RACK-1, RACK-2"):
            client.inject(JammedSeat(seat="BAY-9"))


def test_a_slow_loop_has_late_ticks(run_dir: Path) -> None:
    with Client(run_dir, need_broker=False) as rtc:
        rtc.inject(SlowLoop(tick_s=0.005))
        looks = rtc.telemetry(silence_s=20.0)
        first = next(looks)
        assert next(look for look in looks if look.late_ticks >= first.late_ticks + 20).ticks > first.ticks
        rtc.undo_fault()


def test_a_camera_gives_its_picture(rtc: Run, tmp_path: Path) -> None:
    done = rtc("picture", "camera_1", "-o", str(tmp_path / "a.png"), "--json")
    unknown = rtc("picture", "CAMERA-9")

    assert last_json(done)["camera"] == "CAMERA-1"
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert unknown.returncode == 2
    assert "CAMERA-1, CAMERA-2, CAMERA-3, CAMERA-4" in unknown.stderr


def test_a_version_of_the_world_that_is_still_to_come_is_2(rtc: Run) -> None:
    newest = last_json(rtc("world", "list", "--json"))["version"]
    done = rtc("world", "at", "99999999", "MACS-NEW")

    assert done.returncode == 2
    assert f"no version 99999999 of the world yet; the newest is {newest}" in done.stderr


def test_the_facts_of_a_file_are_those_of_the_world_again(rtc: Run, tmp_path: Path) -> None:
    file = str(tmp_path / "before.json")
    assert rtc("world", "save", file).returncode == 0
    assert rtc("do", "SET MACS-NEW MASS 1.5 KG").returncode == 0
    changed = last_json(rtc("world", "diff", file, "--json"))["differences"]
    restored = rtc("world", "restore", file)
    left = last_json(rtc("world", "diff", file, "--json"))["differences"]

    assert restored.returncode == 0, restored.stdout + restored.stderr
    assert "MACS-NEW.mass" in [one["key"] for one in changed]
    assert "MACS-NEW.mass" not in [one["key"] for one in left]


@pytest.mark.parametrize("mode", [[], ["--parallel"], ["--no-wait"]])
def test_a_program_names_its_commands_by_labels(rtc: Run, tmp_path: Path, mode: list[str]) -> None:
    plan = tmp_path / "plan.txt"
    plan.write_text("# both at once\nC3: STOW LEFT-ARM\nC4: STOW RIGHT-ARM AFTER C3 -- then\nSTOW LEFT-ARM AFTER C-4\n")
    done = rtc("do", "--file", str(plan), *mode, "--json")
    first, second, third = last_json(done)["results"]

    assert done.returncode == 0, done.stdout + done.stderr
    assert [first["label"], second["label"]] == ["C-3", "C-4"]
    assert f"AFTER {first['command']} --" in second["text"]
    assert third["text"].endswith(f"AFTER {second['command']}")
    assert rtc("do", f"STOW RIGHT-ARM AFTER {third['command']}").returncode == 0  # the last one has succeeded


def test_a_program_goes_on_when_the_operator_has_done_what_it_gave_away(
    rtc: Run, run_dir: Path, tmp_path: Path
) -> None:
    file = tmp_path / "plan.txt"
    file.write_text("GIVE RIGHT-ARM TO OPERATOR\nHOLD RIGHT-ARM FOR 0.1 SEC\n")
    program = [*RTC, "do", "--file", str(file), "--json", "--run-dir", str(run_dir)]
    with Client(run_dir) as client, subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as running:
        limit_s = time.monotonic() + LIMIT_S
        while "OPERATOR" not in str(client.status().commands):  # the step in which the operator has the arm
            assert time.monotonic() < limit_s
        assert rtc("do", "TAKE RIGHT-ARM FROM OPERATOR").returncode == 0
        shown, _ = running.communicate(timeout=LIMIT_S)
    assert [one["kind"] for one in json.loads(shown)["results"]] == ["succeeded", "succeeded"]


def test_a_program_that_would_wait_for_itself_is_not_begun(rtc: Run) -> None:
    before = last_json(rtc("log", "-n", "1", "--json"))["commands"]
    lines = ["STOW RIGHT-ARM", "GIVE RIGHT-ARM TO OPERATOR", "TAKE RIGHT-ARM FROM OPERATOR"]
    assert rtc("do", *lines).returncode == 2
    assert last_json(rtc("log", "-n", "1", "--json"))["commands"] == before


def test_a_label_whose_sentence_became_no_command_is_refused_by_the_cluster(rtc: Run, tmp_path: Path) -> None:
    plan = tmp_path / "plan.txt"
    plan.write_text("C3: HALT\nSTOW LEFT-ARM AFTER C-3\nABORT C-3\n")
    done = rtc("do", "-k", "--file", str(plan), "--json")

    assert done.returncode == 2
    assert [one["kind"] for one in last_json(done)["results"]] == ["succeeded", "refused", "refused"]


@pytest.mark.parametrize("word", ["exit", "QUIT", ":q"])
def test_the_shell_is_left_by_the_words_people_try(
    run_dir: Path, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with create_pipe_input() as typed, create_app_session(input=typed, output=DummyOutput()):
        typed.send_text(f"STOW LEFT-LEG\n{word}\nSTOW RIGHT-LEG\n")
        interpret(run_dir)

    printed = capsys.readouterr().out
    assert "LEFT-LEG" in printed
    assert "RIGHT-LEG" not in printed


def test_the_shell_obeys_a_pipe_and_reports_what_was_sent_with_an_ampersand(run_dir: Path, rtc: Run) -> None:
    words = [*RTC, "shell", "--run-dir", str(run_dir)]
    before = len(last_json(rtc("log", "-n", "1000", "--json"))["commands"])
    shell = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert shell.stdin is not None
    assert shell.stdout is not None
    shell.stdin.write("# a comment\n\nhelp\nSTOW LEFT-ARM &\nHOLD RIGHT-ARM &\nHALT RIGHT-ARM\n")
    shell.stdin.flush()
    lines: list[str] = []
    while not ({"SUCCEEDED", "HALTED"} <= {word for line in lines for word in line.split()}):
        lines.append(shell.stdout.readline())
        assert lines[-1], lines
    rest, errors = shell.communicate(timeout=60)

    assert errors == ""
    assert sum("STOW (task): hand LEFT-ARM" in line for line in lines) == 1  # how it is understood
    assert "left running" not in rest
    assert all(line.strip() for line in lines)
    assert sum("Type a sentence" in line for line in lines) == 1
    assert sum(line.rstrip().endswith("accepted") for line in lines) == 2
    assert len(last_json(rtc("log", "-n", "1000", "--json"))["commands"]) == before + 2  # `help` is none


@pytest.mark.parametrize(
    ("words", "typed"),
    [(["do", "-k", "HOLD LEFT-ARM", "STOW LEFT-ARM"], ""), (["shell"], "HOLD LEFT-ARM\nSTOW LEFT-ARM\n")],
)
def test_a_program_ends_with_a_halt(run_dir: Path, tmp_path: Path, words: list[str], typed: str) -> None:
    lines = tmp_path / "lines.txt"
    lines.write_text(typed)
    with lines.open() as given, Client(run_dir) as client:
        program = subprocess.Popen(
            [*RTC, *words, "--run-dir", str(run_dir)], stdin=given, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        until(lambda: [one.text for one in client.status().commands] == ["HOLD LEFT-ARM"])
        client.halt()
        printed = program.communicate(timeout=60)[0].decode()

    assert "HALTED" in printed
    assert "not sent" in printed.lower()
    assert "SUCCEEDED" not in printed


def test_the_shell_takes_a_program_with_labels(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    obey_lines(["C1: STOW LEFT-ARM -- first", "STOW RIGHT-ARM AFTER C-1", "ABORT C9", "STOW LEFT-LEG"], run_dir)
    printed, errors = capsys.readouterr()
    results = re.findall(r"(C-\d+) (SUCCEEDED|REFUSED)", printed)

    assert [how for _, how in results] == ["SUCCEEDED", "SUCCEEDED", "REFUSED"]
    assert f"STOW RIGHT-ARM AFTER {results[0][0]}" in printed
    assert f"after {results[0][0]}" in printed  # in the understood record
    assert "line 3: " in errors


def test_the_shell_explains_a_sentence_by_the_grammar_of_the_cluster(
    run_dir: Path, rtc: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grammar = (Path(rtc_package.__file__).parent / "language/command.lark").read_text()
    mine = tmp_path / "mine.lark"
    mine.write_text(grammar.replace('STOW: "STOW" | "PARK"', 'STOW: "STOW" | "PARK" | "TUCK"'))
    assert rtc("load", str(mine), "INTO", "parser").returncode == 0
    obey_lines(["TUCK LEFT-ARM"], run_dir)
    assert rtc("load", "--reset", "parser").returncode == 0

    assert "STOW (task): hand LEFT-ARM" in capsys.readouterr().out


def test_the_shell_knows_the_state_of_the_cluster(run_dir: Path, rtc: Run) -> None:
    assert rtc("teach", "P1", "RIGHT-ARM").returncode == 0
    with Client(run_dir) as client, LiveState(run_dir, None) as live:
        hold = client.submit("HOLD RIGHT-ARM")
        until(lambda: hold.number in live.now.commands and "P1" in live.now.places)
        client.inject(JammedSeat(seat="RACK-2"))
        until(lambda: "injected" in words(live))
        assert f"in use by {hold.number}" in words(live)
        client.undo_fault()
        hold.halt()
        until(lambda: "no command in progress" in words(live) and "halt" in words(live))
        assert "injected" not in words(live)
    assert rtc("teach", "P1", "--forget").returncode == 0


def until(done: Callable[[], bool]) -> None:
    """Wait with a limit; the live state is asked for every 0.5 s."""
    limit_s = time.monotonic() + LIMIT_S
    while not done():
        assert time.monotonic() < limit_s
        time.sleep(0.02)


def words(live: LiveState) -> str:
    """The toolbar of the shell."""
    return "".join(text for _, text in in_words(live.now))


def test_a_status_that_the_broker_does_not_give_the_supervisor_gives(run_dir: Path, rtc: Run) -> None:
    """A broker that stands still is found and replaced; a query meanwhile gets an answer or an error."""
    broker = next(row for row in last_json(rtc("status", "--json"))["processes"] if row["name"] == "broker")
    os.kill(broker["pid"], signal.SIGSTOP)
    new_pid = broker["pid"]
    while new_pid == broker["pid"]:
        done = rtc("status", "--json")
        result = last_json(done)
        assert done.returncode == (4 if "error" in result else 0)
        assert "Traceback" not in done.stderr
        rows = {row["name"]: row for row in result["processes"]}
        assert "MCM" in rows  # although a new broker gets it a little later
        new_pid = rows.get("broker", broker)["pid"] or broker["pid"]


def test_an_unknown_place_is_2_and_shows_the_known_ones(rtc: Run) -> None:
    done = rtc("world", "get", "NOWHERE")

    assert done.returncode == 2
    assert "MACS-NEW" in done.stderr


def holding(run_dir: Path) -> tuple[subprocess.Popen[str], str]:
    """`rtc do` of a HOLD without an end, and its command, which is being executed."""
    words = [*RTC, "do", "HOLD LEFT-ARM", "--run-dir", str(run_dir)]
    doing = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert doing.stdout is not None
    line = next(line for line in doing.stdout if "executing" in line)
    return doing, line.split()[2]


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_leaves_the_commands_running_and_names_them(
    run_dir: Path, rtc: Run, number: signal.Signals, status: int
) -> None:
    doing, command = holding(run_dir)
    doing.send_signal(number)
    _, errors = doing.communicate(timeout=60)
    live = [row["command"] for row in last_json(rtc("status", "--json"))["commands"]]
    rtc("halt")

    assert doing.returncode == status
    assert errors == f"rtc: ended by {number.name}; left running: {command}; rtc halt {command}\n"
    assert command in live


def test_without_a_terminal_an_interrupt_halts_the_commands(run_dir: Path) -> None:
    """A HOLD without an end; stdin is no terminal, so Ctrl-C can not be asked about."""
    doing, _ = holding(run_dir)
    doing.send_signal(signal.SIGINT)
    _, errors = doing.communicate(timeout=60)

    assert doing.returncode == 3, errors
    assert "rest confirmed" in errors


def test_what_was_measured_is_reported_at_the_end_and_on_the_way(rtc: Run) -> None:
    held, stowed = (
        "HOLD LEFT-ARM FOR 2 SEC REPORT FORCES AND EVERY 0.5 SEC",
        "STOW LEFT-ARM REPORT POSE AND JOINTS AND WHEN DISTANCE EXCEEDS 1 CM AFTER LAST",
    )
    assert rtc("do", "MOVE LEFT-ARM TO RACK-2-FRONT").returncode == 0
    done = rtc("do", "--parallel", held, stowed, "HOLD RIGHT-ARM FOR 0.1 SEC", "--json")
    first, second, brief = last_json(done)["results"]

    assert done.returncode == 0, done.stdout + done.stderr
    assert 3 <= len(first["reports"]) <= 4  # of two seconds, in the time of the arms
    assert all(set(one) == {"at_s", "arm", "wrench"} for one in first["reports"])
    assert set(first["measured"]) == {"arm", "wrench", "peak_force_n", "peak_torque_nm"}
    assert (len(second["measured"]["tcp_pose"]), len(second["measured"]["joints"])) == (7, 6)
    assert [(one["when"].partition(": ")[0], len(one["joints"])) for one in second["reports"]] == [
        ("DISTANCE EXCEEDS 10 MM", 6)
    ]
    assert {row["command"]: row["reports"] for row in last_json(rtc("log", "-n", "3", "--json"))["commands"]} == {
        first["command"]: len(first["reports"]),
        second["command"]: 1,
        brief["command"]: 0,
    }
    assert "DISTANCE EXCEEDS 10 MM: " in rtc("trace", second["command"]).stdout
    why = last_json(rtc("why", second["command"], "--json"))
    assert why["outcome"]["measured"] == second["measured"]
    trace = last_json(rtc("trace", first["command"], "--json"))
    assert next(note["expected_s"] for note in trace["notes"] if note["phase"] == "executing") == 2.0
    assert len(trace["notes"]) == len(last_json(rtc("trace", brief["command"], "--json"))["notes"])  # R57
    assert any(f"waits for {first['command']}" in line for line in why["chain"])


def test_after_last_of_a_client_without_one_before_is_refused(rtc: Run) -> None:
    done = rtc("do", "STOW LEFT-ARM AFTER LAST")

    assert done.returncode == 2
    assert "this client has given no command before this one" in done.stdout


CARRY = """script: my-carry
case: 2
uses: [hand, object, target]
steps: [{do: hold, stop: hold, label: "carry {object} to {target}", args: {duration_s: 1.0}}]
decision_tree: [{verb: CARRY, script: my-carry}]
command_object_table: [{verb: CARRY, kind: module, values: {}}]
"""


def test_a_script_is_checked_loaded_listed_and_taken_away(rtc: Run, run_dir: Path, tmp_path: Path) -> None:
    mine = tmp_path / "carry.yaml"
    mine.write_text(CARRY.replace("{target}", "{goal}"))
    wrong = rtc("load", str(mine), "INTO", "elaborator", "--check")
    assert (wrong.returncode, "line 4: " in wrong.stderr, "no placeholder goal" in wrong.stderr) == (2, True, True)
    mine.write_text(CARRY)
    checked = last_json(rtc("load", str(mine), "INTO", "elaborator", "--check", "--json"))
    assert "scripts: my-carry is new" in checked["changes"]
    assert str(run_dir) in checked["against"]
    assert last_json(rtc("load", "--list", "--json"))["programs"]["elaborator"]["changes"] == []

    assert rtc("load", str(mine), "INTO", "elaborator").returncode == 0
    assert last_json(rtc("load", "--list", "--json"))["programs"]["elaborator"]["changes"] == checked["changes"]
    assert "carry the object to the target" in rtc("outcomes", "my-carry").stdout

    reset = rtc("load", "--reset", "elaborator")
    assert "scripts: my-carry is removed" in reset.stdout
    assert rtc("outcomes", "my-carry").returncode == 2
    assert rtc("outcomes", "my-carry", "--file", str(mine)).returncode == 0

    history = last_json(rtc("programs", "--json"))["programs"]["elaborator"]["history"]
    assert [one["file"] for one in history[:2]] == ["default", "carry.yaml"]
    assert "scripts: my-carry is new" in history[1]["changes"]
    assert rtc("programs", "--back", history[1]["digest"][:8]).returncode == 0
    assert rtc("outcomes", "my-carry").returncode == 0
    assert rtc("programs", "--back", history[0]["digest"]).returncode == 0
    assert rtc("outcomes", "my-carry").returncode == 2
    assert rtc("programs", "--back", "0000").returncode == 2


def test_a_whole_verb_is_loaded_by_one_file_or_not_at_all(rtc: Run, tmp_path: Path) -> None:
    wipe = Path(__file__).parents[2] / "workers" / "wipe.yaml"
    broken = tmp_path / "wipe.yaml"
    broken.write_text(wipe.read_text().replace("stop: move_clear", "stop: no_such_class"))
    before = {kind: one["in_use"] for kind, one in last_json(rtc("programs", "--json"))["programs"].items()}
    assert rtc("load", str(broken), "--check").returncode == 2
    assert rtc("load", str(broken)).returncode != 0
    after = {kind: one["in_use"] for kind, one in last_json(rtc("programs", "--json"))["programs"].items()}
    assert after == before
    assert "is not a verb" in rtc("do", "WIPE RIGHT-ARM BY 8 MM").stdout

    assert rtc("load", str(wipe)).returncode == 0
    assert "trim 1 (wipe-gently), replace_rest" in rtc("outcomes", "WIPE").stdout
    done = rtc("do", "WIPE RIGHT-ARM BY 8 MM")
    assert "is not a verb" not in done.stdout
    assert done.returncode == 2  # exact arms refuse what must give way, before anything moves ...
    assert "sweep 8 mm to each side" in done.stdout  # ... by a step of the script that was loaded
    assert rtc("do", "STOW RIGHT-ARM").returncode == 0
    for kind in ("elaborator", "analyzer", "binder", "parser"):
        assert rtc("programs", "--back", before[kind]).returncode == 0


def test_a_directory_is_not_a_program(rtc: Run, tmp_path: Path) -> None:
    done = rtc("load", str(tmp_path), "INTO", "elaborator")
    assert (done.returncode, "is a directory" in done.stderr) == (2, True)
