"""The pages for users, typed line by line on a cluster: each command ends as its page says.

README and `own-arm.md` are typed in physics; nothing in the others needs it. What differs from other lines in its arm
alone is not typed; `tests.test_documentation` parses it.

A line succeeds, unless its comment says `refused` or `fails`. A line with `in a terminal of its own` runs until its
block ends, then gets Ctrl-C. A shown line of output, such as `C-1 SUCCEEDED  SENTENCE`, must have been printed.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

ROOT = Path(__file__).parents[2]
LIMIT_S = 120.0  # for one line
PREPARES = ("make ", ". .venv", "pip install", "python -m benchmarks")  # lines that other tests and targets execute
# Other arms in place of the Panda: their cells are those of `tests.apps.authoring.test_draft`.
LIKE_THE_PANDA = re.compile(r"rtc cell .*(kuka_iiwa|xarm|iiwa)")
RESULT = re.compile(r"^(C-\d+) (SUCCEEDED|FAILED|REFUSED|HALTED|ABORTED)  (\S.*?)(?:  \(|$)", re.MULTILINE)


class Typist:
    """Types the code blocks of one page in a directory of its own, with a run directory of its own."""

    def __init__(self, place: Path, options: str) -> None:
        self.place = place
        self.options = options  # of a cluster whose speed the page leaves open
        self.printed = ""
        self.definitions: list[str] = []  # NAME=VALUE lines, for the lines after them
        self.beside: list[tuple[str, subprocess.Popen[str]]] = []
        binaries = Path(sys.executable).parent
        environment = os.environ | {
            "RTC_RUN_DIR": str(place / "run"),
            "PATH": f"{binaries}{os.pathsep}{os.environ['PATH']}",
            "COLUMNS": "200",
            "XDG_DATA_HOME": str(place / "data"),
        }
        self.terminal: dict[str, Any] = {
            "cwd": place,
            "env": environment,
            "stdin": subprocess.DEVNULL,
            "stdout": subprocess.PIPE,
            "stderr": subprocess.STDOUT,
            "text": True,
        }

    def type_block(self, block: str) -> None:
        for line in block.splitlines():
            self.type_line(line.strip())
        self.end_those_beside()

    def type_line(self, line: str) -> None:
        command, _, comment = line.partition(" # ")
        command = command.strip()
        if not command or command.startswith(("#", *PREPARES)) or LIKE_THE_PANDA.match(command):
            return
        if re.match(r"[A-Z_]+=", command):
            self.definitions.append(command)
            return
        if re.fullmatch(r"rtc up\b.*", command) and "--speed" not in command:
            command += f" {self.options}"
        if " & sleep" in command:
            self.start(command.partition(" & ")[0], until="executing")
        elif "in a terminal of its own" in comment:
            self.start(command, until="\n")
        else:
            fails = re.search(r"\b(refused|fails)\b", comment) is not None
            status, printed = self.run(command)
            assert (status != 0) is fails, f"{line}\nexit status {status}\n{printed[-3000:]}"

    def run(self, command: str) -> tuple[int, str]:
        """Type one line and wait. Returns exit status and output."""
        done = subprocess.run(self._shell(command), timeout=LIMIT_S, check=False, **self.terminal)
        self.printed += done.stdout
        return done.returncode, done.stdout

    def start(self, command: str, until: str = "") -> None:
        """Type one line in another terminal. With `until`, wait for a line of output that contains it."""
        child = subprocess.Popen(self._shell(f"exec {command}"), **self.terminal)
        self.beside.append((command, child))
        assert child.stdout is not None
        while until:
            line = child.stdout.readline()
            assert line, f"{command} ended without {until}"
            self.printed += line
            if until in line:
                break

    def end_those_beside(self) -> None:
        for command, child in self.beside:
            if not command.startswith("rtc do"):
                child.send_signal(signal.SIGINT)
            printed, _ = child.communicate(timeout=LIMIT_S)
            self.printed += printed
            assert command.startswith("rtc do") or child.returncode in (0, 130), f"{command}\n{printed[-3000:]}"
        self.beside.clear()

    def leave(self) -> None:
        """End what a failed page left."""
        for _, child in self.beside:
            child.kill()
            child.wait()
        if (self.place / "run").exists():
            self.run("rtc down")

    def _shell(self, command: str) -> list[str]:
        return ["bash", "-c", "\n".join([*self.definitions, command])]


@pytest.fixture
def typist(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Typist]:
    typist = Typist(tmp_path, request.param)
    yield typist
    typist.leave()


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of the code blocks of a page, in order."""
    return re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def is_input(block: str) -> bool:
    return block.lstrip().startswith(("rtc ", "#", "DATA=", *PREPARES))


def test_pages_that_are_typed_have_blocks_of_commands_and_of_python():
    found = [(language, is_input(text)) for language, text in blocks(ROOT / "README.md")]
    assert ("", True) in found
    assert ("python", False) in found


# A halt must meet a motion of some seconds, so the first page is typed in real time.
@pytest.mark.timeout(400)
@pytest.mark.parametrize(
    ("page", "typist"),
    [
        ("README.md", "--speed 1"),
        ("docs/tutorial.md", "--speed max --mcm kinematic"),  # nothing needs more
        ("docs/own-arm.md", "--speed max"),
        ("docs/observing.md", "--speed max"),
    ],
    indirect=["typist"],
)
def test_a_page_typed_line_by_line_does_what_it_says(page: str, typist: Typist):
    shown: list[tuple[str, ...]] = []
    for language, text in blocks(ROOT / page):
        if language == "python":
            (typist.place / "block.py").write_text(text)
            status, printed = typist.run(f"{sys.executable} block.py")
            assert status == 0, f"{text}\n{printed[-3000:]}"
        elif not language and is_input(text):
            typist.type_block(text)
        else:
            shown += RESULT.findall(text)
    printed_results = RESULT.findall(typist.printed)
    assert [each for each in shown if each not in printed_results] == []
