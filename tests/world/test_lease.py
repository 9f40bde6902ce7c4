"""Leases: only the broker's, only for what they name."""

from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from rtc.world.lease import check, sign

KEY = bytes(range(32))
LEASE = sign(KEY, "C-1/4", ["MACS-OLD", "LEFT-ARM"])


def test_a_lease_of_this_cluster_holds():
    assert check(KEY, LEASE)


@given(st.lists(st.text(max_size=5), max_size=5))
def test_the_order_of_locations_and_repetitions_mean_nothing(places):
    assert sign(KEY, "j", places) == sign(KEY, "j", [*reversed(places), *places])


def test_a_changed_job_location_signature_or_key_does_not_hold():
    changed = [
        {"job": "C-1/5"},
        {"locations": ["LEFT-ARM", "MACS-OLD", "RIGHT-ARM"]},
        {"locations": ["LEFT-ARM"]},
        {"signature": b""},
        {"signature": bytes(32)},
    ]
    assert [check(KEY, msgspec.structs.replace(LEASE, **change)) for change in changed] == [False] * 5
    assert not check(bytes(32), LEASE)
