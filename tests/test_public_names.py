"""Public names of the package `rtc`: they can be imported from it, and importing it alone loads nothing else."""

from __future__ import annotations

import subprocess
import sys

import rtc


def test_public_names_can_be_imported() -> None:
    assert [name for name in rtc.__all__ if getattr(rtc, name).__name__ != name] == []


def test_importing_the_package_loads_neither_the_client_nor_zmq() -> None:
    code = "import sys, rtc; print([m for m in sys.modules if m.startswith(('rtc.', 'zmq', 'msgspec'))])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert shown.stdout.strip() == "[]"


def test_admission_of_halts_loads_neither_sockets_nor_the_client() -> None:
    forbidden = "{'zmq', 'rtc.client.client', 'rtc.client.halt'}"
    code = f"import sys, rtc.runtime.halt_admission; print(sorted({forbidden} & set(sys.modules)))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert shown.stdout.strip() == "[]"
