"""Public names of the package `rtc`: they can be imported from it, and importing it alone loads nothing else."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from pathlib import Path

from setuptools.config.pyprojecttoml import read_configuration  # type: ignore[import-untyped]

import rtc

ROOT = Path(__file__).parents[1]


def test_public_names_can_be_imported() -> None:
    assert [name for name in rtc.__all__ if getattr(rtc, name).__name__.rpartition(".")[2] != name] == []


def test_the_package_is_built_with_the_version_of_the_attribute() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # setuptools calls its table a beta
        built = read_configuration(ROOT / "pyproject.toml")["project"]["version"]
    assert built == rtc.__version__


def test_images_have_the_version_of_the_package() -> None:
    files = [
        path for path in (ROOT / "deploy").rglob("*") if path.name == "Dockerfile" or path.suffix in (".md", ".yaml")
    ]
    images = {found for path in files for found in re.findall(r"telerobot-rtc:([\w.]+)", path.read_text())}
    assert images == {rtc.__version__.partition(".dev")[0]}


def test_importing_the_package_loads_neither_the_client_nor_zmq() -> None:
    code = "import sys, rtc; print([m for m in sys.modules if m.startswith(('rtc.', 'zmq', 'msgspec'))])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert shown.stdout.strip() == "[]"


def test_admission_of_halts_loads_neither_sockets_nor_the_client() -> None:
    forbidden = "{'zmq', 'rtc.client.client', 'rtc.client.halt'}"
    code = f"import sys, rtc.runtime.halt_admission; print(sorted({forbidden} & set(sys.modules)))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert shown.stdout.strip() == "[]"
