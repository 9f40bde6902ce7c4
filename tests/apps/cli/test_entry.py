"""Ctrl-C at any moment after Python itself has started: one line, exit status 130, no traceback, nothing left."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import zmq

ROOT = Path(__file__).parents[3]
#: `rtc`, announced on stderr as soon as its first function can be called
RTC = """
import os, signal, sys
from rtc.apps.cli import entry, interrupts
signal.signal(signal.SIGINT, interrupts.leave)
os.write(2, b"!")
entry.main()
"""


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.parametrize("words", [["up", "--mcm", "kinematic"], ["demo"]])
@pytest.mark.parametrize("after_s", [0.03, 0.1, 0.3])
def test_interrupted_early(words: list[str], after_s: float, tmp_path: Path) -> None:
    environment = {**os.environ, "RTC_RUN_DIR": str(tmp_path)}
    command = [sys.executable, "-P", "-c", RTC, *words]
    rtc = subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=tmp_path,
    )
    assert rtc.stderr is not None
    assert rtc.stderr.read(1) == b"!"
    select.select([], [], [], after_s)  # any moment is good: each finds the command somewhere else
    rtc.send_signal(signal.SIGINT)
    _, errors = rtc.communicate(timeout=60)
    lines = errors.decode().splitlines()

    assert not any("Traceback" in line for line in lines), errors
    assert lines[-1] in ("rtc: interrupted", "rtc: stopped before the cluster was ready")
    assert rtc.returncode in (130, 1)


def test_nothing_slow_is_imported_before_ctrl_c_is_handled() -> None:
    """Before that, Ctrl-C meets Python's own traceback."""
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import rtc.apps.cli.entry; print(*sys.modules)"
    bare = subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True)
    assert not {"typing", "re", "pathlib", "msgspec", "typer"} & set(bare.stdout.split())


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.parametrize(
    ("words", "none_of"),
    [
        (["--version"], {"typer", "rich", "numpy", "pinocchio", "lark", "msgspec", "zmq"}),
        (["status"], {"numpy", "pinocchio", "lark", "pybullet", "prompt_toolkit"}),
    ],
    ids=["version", "status"],
)
def test_what_a_command_loads(words: list[str], none_of: set[str], tmp_path: Path) -> None:
    listed = (
        "import atexit, sys; atexit.register(lambda: print(*sys.modules))\nfrom rtc.apps.cli import entry; entry.main()"
    )
    environment = {**os.environ, "RTC_RUN_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", f"{listed}; entry.main()", *words], capture_output=True, text=True, env=environment
    )
    loaded = done.stdout.splitlines()[-1].split()
    assert "sys" in loaded, done.stderr
    assert not none_of & set(loaded)


#: what a halt loads besides the standard library; the last three belong to the first ones
OF_A_HALT = {"rtc", "zmq", "msgspec", "typing_extensions", "cython_runtime", "_cython"}


@pytest.mark.slow
@pytest.mark.untimed
def test_what_a_halt_loads(tmp_path: Path) -> None:
    """With a listener that answers nothing: all that it loads, for its order, its wait and its result."""
    listed = "import sys; bare = {*sys.modules}\nfrom rtc.apps.cli import entry\ntry: entry.main()\n"
    listed += "finally: print(*({*sys.modules} - bare))"
    command = [sys.executable, "-P", "-c", listed, "halt", "--timeout", "0.01", "--run-dir", str(tmp_path)]
    with zmq.Context() as context, context.socket(zmq.ROUTER) as broker:
        broker.bind(f"ipc://{tmp_path}/halt.sock")
        done = subprocess.run(command, capture_output=True, text=True)
        assert broker.poll(10_000)
    packages = {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()} - sys.stdlib_module_names
    assert {"rtc", "zmq", "msgspec"} <= packages, done.stderr
    assert {"_cython" if name.startswith("_cython") else name for name in packages} <= OF_A_HALT
