"""A router alone, and one with a subsystem and a parser at work."""

from __future__ import annotations

import pytest

from rtc.protocol import messages as m
from tests.broker.router.bench import MCM, PARSER, Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def working(bench: Bench) -> Bench:
    """With a subsystem, a parser, and a sentence that the parser has."""
    bench.send("subsystems", b"MCM", MCM)
    bench.send("workers", b"parser@0", PARSER)
    bench.send("front", b"ann", m.CommandText(request="1", text="STOW LEFT-ARM"))
    assert list(bench.router.core.registry.workers["parser@0"].assigned) == ["C-1/1"]
    return bench
