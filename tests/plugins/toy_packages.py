"""Toy packages with entry points, as pip would have installed them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rtc.plugins import registry

Install = Callable[[str, str, str, str], None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """`install(group, name, object, code)`: a package of one module with this code, and an entry point of the group."""
    monkeypatch.syspath_prepend(str(tmp_path))
    modules = []

    def write(group: str, name: str, target: str, code: str) -> None:
        module = f"toy_{len(modules)}_{abs(hash(code)) % 10**8}"
        modules.append(module)
        (tmp_path / f"{module}.py").write_text(code)
        info = tmp_path / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{group}]\n{name} = {module}:{target}\n")
        registry.look_again()

    yield write
    registry.look_again()
    for module in modules:
        sys.modules.pop(module, None)
