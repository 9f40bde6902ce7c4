"""`make demo` and `make test` set up first: this takes minutes, and says all the time what it is doing."""

from __future__ import annotations

import os
import subprocess
import threading
from contextlib import suppress
from pathlib import Path
from queue import Empty, Queue

import pytest

ROOT = Path(__file__).parents[1]
LIMIT_S = 30.0
#: stands for the Python of the environment: it writes what pip writes, and goes on when the test has seen it. It reads
#: again if it met the end of the writer before
PIP = """#!/bin/sh
case "$*" in *"pip install"*) ;; *) exit 0 ;; esac
for n in 1 2 3 4 5 6 7 8 9 10 11 12; do echo "Collecting package-$n"; done
until read go < {pipe}; do :; done
echo "Building wheels for collected packages: telerobot-rtc"
echo "Building wheel for telerobot-rtc"
until read go < {pipe}; do :; done
echo "Installing collected packages: package-1"
until read go < {pipe}; do :; done
exit {status}
"""


class SetUp:
    """A set-up that has begun, with the pipe on which its pip waits."""

    def __init__(self, folder: Path, status: int) -> None:
        python, self._pipe = folder / "bin" / "python", folder / "pipe"
        python.parent.mkdir(parents=True)
        os.mkfifo(self._pipe)
        python.write_text(PIP.format(pipe=self._pipe, status=status))
        python.chmod(0o755)
        command = ["make", "-s", "-C", str(ROOT), f"VENV={folder}", f"{folder}/.ready"]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        self._make = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment)
        self._lines: Queue[str] = Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._make.stdout is not None
        for line in self._make.stdout:
            self._lines.put(line.decode())

    def says(self, words: str) -> bool:
        """Whether a line of the set-up has these words, which it has to write while its pip waits."""
        with suppress(Empty):
            while not ((line := self._lines.get(timeout=LIMIT_S)).startswith("set-up: ") and words in line):
                pass
            return True
        return False

    def go_on(self) -> None:
        self._pipe.write_text("go\n")

    def ends(self) -> int:
        return self._make.wait(LIMIT_S)

    def kill(self) -> None:
        self._make.kill()
        with suppress(OSError):  # its pip has ended
            os.close(os.open(self._pipe, os.O_WRONLY | os.O_NONBLOCK))


@pytest.mark.parametrize("status", [0, 1])
def test_each_part_of_the_set_up_is_announced_while_it_runs(status: int, tmp_path: Path) -> None:
    made = SetUp(tmp_path, status)
    try:
        assert made.says("minutes")
        for words in ("10 packages", "rtc itself is built", "installed"):
            assert made.says(words)
            made.go_on()
        assert (made.ends() == 0) is (status == 0)
        assert (tmp_path / ".ready").exists() is (status == 0)
    finally:
        made.kill()


@pytest.mark.parametrize("target", ["demo", "test", "console"])
def test_the_first_commands_set_up_by_themselves(target: str, tmp_path: Path) -> None:
    command = ["make", "-n", "-C", str(ROOT), f"VENV={tmp_path / 'venv'}", target]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=LIMIT_S)
    assert "set-up: " in done.stdout
