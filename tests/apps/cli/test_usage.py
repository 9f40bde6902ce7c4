"""A wrong input is refused in one sentence, at once, with exit status 2; a broken cluster with what is known."""

from __future__ import annotations

import fcntl
import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from rtc import __version__
from rtc.apps.cli import inject
from rtc.apps.cli.main import COMMANDS, main
from rtc.apps.cli.programs import _loaded
from rtc.client import core
from rtc.protocol.messages import ProgramLoaded, WorkerKind
from rtc.runtime.process_table import in_words
from rtc.runtime.settings import LOCK, Settings, shell_command


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("do ''", "no sentence; give one in quotes"),
        ("do 'STOW LEFT-ARM' ' '", "no sentence; give one in quotes"),
        ("demo grasp --speed abc", "--speed is a number above 0, or max; not abc"),
        ("demo grasp --speed 0", "--speed is a number above 0, or max; not 0"),
        ("demo graps", "did you mean grasp?"),
        ("do --advice 1 C-1 C-2", "--advice takes the number of one command at most"),
        ("do --advice 1 --file plan.txt", "--advice takes the number of one command at most"),
        ("do --advice 1 --parallel", "leave out --parallel"),
        ("demo grasp --part insertion", "--test and --part are for the demo swapout, not for grasp"),
        ("up --speed inf", "--speed is a number above 0, or max; not inf"),
        ("up --speed nan", "--speed is a number above 0, or max; not nan"),
        ("up --speed=-1", "--speed is a number above 0, or max; not -1"),
        ("up --mcm steam", "--mcm is bullet or kinematic, not steam"),
        ("keys revoke nix --run-dir DIR", "there is no key 'nix'"),
        ("status --with DIR/nix", "there is no key file"),
        ("world watch --every inf", "less than or equal to"),
        ("world watch --every nan", "less than or equal to"),
        ("trace x7", "'x7' is not the number of a command, such as C-7 or 7"),
        ("why C-7x", "'C-7x' is not the number of a command"),
        ("names plaices", "there is no kind plaices; there are arms, "),
        ("inject displace MACS-NEW", "state --by, --turn or both"),
        ("inject displace MACS-NEW --by 1,2", "--by is 3 numbers with commas between them; not 1,2"),
        ("inject displace MACS-NEW --by nan,0,0", "--by is 3 numbers"),
        ("inject sensor RIGHT-ARM", "state either --offset or --freeze"),
        ("inject sensor RIGHT-ARM --freeze --offset 1,2,3", "state either --offset or --freeze"),
        ("inject sensor RIGHT-ARM --offset 1,2,3,4", "--offset is 6 numbers"),
        ("inject slow never", "the duration is a duration"),
        ("inject undo --with DIR/x.key", "No such option"),
        (f"look --watch --every {'9' * 400}s", "--every is a duration"),
    ],
)
def test_a_wrong_word_is_2_in_a_sentence(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert status_of(shlex.split(words.replace("DIR", str(tmp_path))), monkeypatch) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_check_of_a_program_needs_no_cluster(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("{}")
    words = ["load", str(mine), "INTO", "elaborator", "--check", "--run-dir", str(tmp_path / "nix")]
    assert status_of(words, monkeypatch) == 0
    assert "the default programs (no cluster runs)" in " ".join(capsys.readouterr().out.split())


def test_a_status_that_no_broker_gives_the_supervisor_gives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(core, "RESTART_S", 0.1, raising=False)
    Settings(run_dir=str(tmp_path)).save()
    rows = [{"name": "broker", "pid": 7, "state": "starting", "restarts": 3, "since_s": 0.0, "node": None, "notes": []}]
    report = {"pid": 1, "cluster": "abc", "started_at": 0.0, "processes": rows}
    (tmp_path / "supervisor.json").write_text(json.dumps(report))
    with open(tmp_path / LOCK, "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert status_of(["status", "--json", "--run-dir", str(tmp_path)], monkeypatch) == 4
        captured = capsys.readouterr()
    known = json.loads(captured.out)

    assert (known["cluster"], known["processes"]) == ("abc", rows)
    assert "the broker does not answer" in known["error"]
    assert "the broker does not answer" in " ".join(captured.err.split())


def test_version_and_help_as_people_try_them(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert status_of(["--version"], monkeypatch) == 0
    assert capsys.readouterr().out.startswith(f"rtc {__version__} ")
    shown = []
    for words in (["--help"], ["help"], ["halt", "--help"], ["help", "halt"]):
        assert status_of(words, monkeypatch) == 0
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1]
    assert "rest is confirmed" in shown[2]
    assert shown[2] == shown[3]


@pytest.mark.slow
@pytest.mark.untimed
def test_bash_completes_commands_and_options() -> None:
    script = """
    eval "$(rtc --show-completion bash)"
    COMP_WORDS=(rtc sta); COMP_CWORD=1; _rtc_completion rtc; echo "${COMPREPLY[@]}"
    COMP_WORDS=(rtc log --prev); COMP_CWORD=2; _rtc_completion rtc; echo "${COMPREPLY[@]}"
    COMP_WORDS=(rtc names pl); COMP_CWORD=2; _rtc_completion rtc; echo "${COMPREPLY[@]}"
    COMP_WORDS=(rtc dictionary GR); COMP_CWORD=2; _rtc_completion rtc; echo "${COMPREPLY[@]}"
    """
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    done = subprocess.run(["bash", "-c", script], env={"PATH": path}, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["status", "--previous", "places", "GRASP"], done.stderr


FAULTS = [f"inject {command.name or command.callback.__name__}" for command in inject.app.registered_commands]
GROUPS = ("world", "keys", "inject", "cell")


@pytest.mark.parametrize(
    "command", [*(name for name in COMMANDS if name not in GROUPS), *FAULTS, "cell check", "cell new"]
)
def test_help_of_each_command_has_an_example(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert status_of([*command.split(), "-h"], monkeypatch) == 0
    assert f"rtc {command}" in capsys.readouterr().out.partition("Example")[2]


def test_advice_names_the_run_directory_unless_it_is_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RTC_RUN_DIR", "/tmp/mine")
    assert shell_command("rtc down", Path("/tmp/mine")) == "rtc down"
    assert shell_command("rtc down", Path("/tmp/other one")) == "rtc down --run-dir '/tmp/other one'"


def test_a_reset_is_not_reported_as_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    _loaded(ProgramLoaded(request="r", kind=WorkerKind.BINDER, digest="1f0f", changes=[]), "", json=False)
    assert capsys.readouterr().out.startswith("binder: back to the default program (1f0f)")


def test_the_end_of_a_process_is_in_words() -> None:
    assert in_words(-9) == "was killed by SIGKILL"
    assert in_words(-35) == "was killed by signal 35"
    assert in_words(1) == "ended with status 1"


def status_of(words: list[str], monkeypatch: pytest.MonkeyPatch) -> object:
    """Of `rtc` with these words, in this process."""
    monkeypatch.setattr(sys, "argv", ["rtc", *words])
    for name in ("stdin", "stdout", "stderr"):  # put back afterwards: `main` attaches its own
        monkeypatch.setattr(sys, name, getattr(sys, name))
    with pytest.raises(SystemExit) as left:
        main()
    return left.value.code
