"""Items of REPORT that a package adds."""

from __future__ import annotations

import msgspec
import pytest

from rtc.plugins import registry
from rtc.protocol import messages as m
from rtc.protocol import primitive as p
from rtc.subsystems.base import report_items
from tests.plugins.toy_packages import Install
from tests.subsystems.motion.conftest import cell, make, rig  # noqa: F401
from tests.workers.conftest import bench  # noqa: F401

OPENING = "def measure(arm):\n    return {'opening_m': arm.width_m}\n"
BROKEN = "def measure(arm):\n    raise ZeroDivisionError('no sensor')\n"


def test_an_installed_item_is_measured_with_the_standard_ones(install: Install, rig) -> None:  # noqa: F811
    install(registry.REPORT_ITEMS, "OPENING", "measure", OPENING)
    assert report_items.known() == [*report_items.STANDARD, "OPENING"]

    rig.accept(rig.swing(reporting=p.Reporting(items=["JOINTS", "OPENING"], every_s=0.1)))
    end = rig.until_end()
    readings = [message.reading for message in [*rig.sent, end] if isinstance(message, m.ProgressReport | m.EndReport)]
    assert len(readings) >= 10
    assert {reading.others["OPENING"]["opening_m"] for reading in readings} == {0.08}
    assert (end.reading.joints, end.reading.tcp_pose, end.reading.wrench) == (end.joints, None, None)
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(end), type=m.EndReport) == end


def test_an_item_that_fails_stops_no_arm(install: Install, rig) -> None:  # noqa: F811
    install(registry.REPORT_ITEMS, "OPENING", "measure", BROKEN)
    rig.accept(rig.swing(reporting=p.Reporting(items=["OPENING"])))
    end = rig.until_end()
    assert (end.reason.value, end.reading.others["OPENING"]) == ("goal", "not measured: ZeroDivisionError: no sensor")


def test_an_item_that_the_subsystem_lacks_is_refused(rig) -> None:  # noqa: F811
    end = rig.accept(rig.swing(reporting=p.Reporting(items=["TEMPERATURE"])))
    assert (end.reason.value, "TEMPERATURE" in end.message) == ("refused", True)


@pytest.mark.parametrize("known", [False, True])
def test_a_sentence_with_an_item(install: Install, bench, known: bool) -> None:  # noqa: F811
    if known:
        install(registry.REPORT_ITEMS, "OPENING", "measure", OPENING)
    product = bench.elaborate("STOW RIGHT-ARM REPORT OPENING AND POSE")
    if known:
        assert product.context.report.items == ["OPENING", "POSE"]
    else:
        assert (product.reason.value, product.where) == ("name", "REPORT")
