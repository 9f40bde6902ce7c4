"""An installed rtc has its rooms in a folder of its own: its processes find them there, before others of the names."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

LOOK = "import broker; print(broker.__file__)"
PROGRAM = f"""
import subprocess, sys
from rtc.runtime import environment
environment.ROOMS = sys.argv[1]
environment.use_rooms()
{LOOK}
sys.stdout.flush()
subprocess.run([sys.executable, "-P", "-c", {LOOK!r}], check=True)
"""


def printed(*arguments: str) -> list[str]:
    ran = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()


def test_the_rooms_come_before_other_packages_of_their_names_here_and_in_child_processes(tmp_path: Path) -> None:
    (tmp_path / "broker.py").write_text("")
    assert printed("-c", PROGRAM, str(tmp_path)) == 2 * [str(tmp_path / "broker.py")]


def test_in_a_checkout_nothing_changes(tmp_path: Path) -> None:
    import broker

    assert printed("-c", PROGRAM, str(tmp_path / "none")) == 2 * [broker.__file__]


def test_a_program_of_a_room_is_run_by_its_name() -> None:
    assert any("python -m rtc workers" in line for line in printed("-m", "rtc", "workers", "--help"))
