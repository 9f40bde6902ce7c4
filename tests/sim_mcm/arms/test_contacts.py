"""The contacts and the latch of a socket: they rub both ways, and the latch resists the way in until it clicks."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.model.cells.cell import Cell
from rtc.spatial import geometry
from sim_mcm.arms.contacts import STIFF_N_M, Contacts, out_m

SEAT = Cell.load("connectors").seat("SOCKET-1")
MATING = SEAT.mating
assert MATING is not None


def test_a_plug_feels_the_latch_on_its_way_in_and_less_after_the_click() -> None:
    contacts = Contacts(MATING)
    felt = {round(1e3 * m, 1): contacts.push_n("PLUG-1", m) for m in np.arange(0.030, -0.0001, -0.0001)}
    assert felt[30.0] == felt[25.0] == 0.0
    assert felt[round(1e3 * MATING.click_m, 1)] == max(felt.values()) == pytest.approx(MATING.most_n, rel=0.01)
    assert felt[0.0] == pytest.approx(MATING.rub_n, rel=0.02)


def test_contacts_hold_a_plug_at_rest_and_rub_on_its_way_out() -> None:
    contacts = Contacts(MATING)
    contacts.push_n("PLUG-1", 0.0)
    assert contacts.push_n("PLUG-1", 0.0) == 0.0
    assert contacts.push_n("PLUG-1", 1e-5) == pytest.approx(-1e-5 * STIFF_N_M + MATING.latches_n(1e-5))
    assert contacts.push_n("PLUG-1", 0.002) == pytest.approx(MATING.latches_n(0.002) - MATING.rubs_n(0.002))


def test_a_plug_beside_a_socket_is_not_in_it() -> None:
    place, out = SEAT.frame.pose, np.array(SEAT.way_out)
    assert out_m(place, out, geometry.translate(place, [-0.01, 0.0, 0.0])) == pytest.approx(0.01)
    assert out_m(place, out, geometry.translate(place, [-0.01, 0.02, 0.0])) is None
