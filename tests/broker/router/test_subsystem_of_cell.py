"""A subsystem that the cell does not have is refused with the reason, which `rtc status` shows."""

from __future__ import annotations

from rtc.protocol import messages as m
from rtc.protocol.outcomes import RefusalReason
from rtc.protocol.versions import VERSION
from tests.broker.router.bench import MCM, Bench

LAMP = m.SubsystemHello(name="LAMP", pid=7, performers=["LAMP-1"], protocol=VERSION)


def test_a_subsystem_that_the_cell_does_not_have_is_refused() -> None:
    bench = Bench()
    (declined,) = bench.send("subsystems", b"LAMP", LAMP)
    assert declined.refusal.reason is RefusalReason.NOT_ALLOWED
    (reply,) = bench.send("front", b"observer", m.StatusQuery(request="q"))
    assert [(row.name, row.socket) for row in reply.status.refused] == [("LAMP", "subsystems")]
    assert bench.state.subsystems == {}


def test_one_of_the_cell_is_not() -> None:
    bench = Bench()
    bench.send("subsystems", b"MCM", MCM)
    assert list(bench.state.subsystems) == ["MCM"]
