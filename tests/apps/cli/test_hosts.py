"""The table of hosts in `rtc status`: fewer joined than asked is visible, and a cluster of one machine has no table."""

from __future__ import annotations

from typing import Any

import pytest

from rtc.apps.cli.hosts import connections_of, request_in_words, show_hosts
from rtc.apps.cli.output import console
from rtc.protocol.messages import HostRow, MoreWorkersRow, Status


def row(**about: Any) -> HostRow:
    made = {"host": "10.0.0.7", "key": "w1", "role": "worker", "connections": 1, "last_message_ago_s": 0.2}
    return HostRow(**{**made, "state": "ready", **about})


HERE = row(host="this machine", key="", asked=4, joined=4)


def shown(*rows: HostRow, **about: Any) -> str:
    with console.capture() as captured:
        show_hosts(Status(hosts=[HERE, *rows], **about))
    return captured.get()


def test_a_cluster_on_one_machine_has_no_table() -> None:
    assert shown() == ""
    assert shown(row(role="operator", key="alice")) == ""


def test_fewer_joined_than_asked_is_stated_once_per_key() -> None:
    text = shown(row(asked=8, joined=4, missing=2), row(host="10.0.0.8", asked=8, joined=2, missing=2))
    assert text.count("2 of 8 missing") == 1
    assert "10.0.0.8" in text


def test_losses_refusals_and_round_trips_have_their_ages() -> None:
    about = {"refused": 3, "refusal": "the key is revoked", "refused_ago_s": 9.0, "lost": {"binder@18": 12.0}}
    text = shown(row(state="lost", round_trip_ms=0.81, round_trip_ago_s=30.0, **about))
    assert "lost binder@18 12 s ago" in text
    assert "refused 9 s ago: the key is revoked" in text
    assert "0.81 ms (30 s ago)" in text
    assert "unknown key" in shown(row(key="", role="", state="refused", **about))


def test_a_silent_gateway_is_stated() -> None:
    assert "gateway" in shown(gateway_silent_s=9.0)
    assert "gateway" not in shown(gateway_silent_s=0.4)


@pytest.mark.parametrize(
    ("about", "words"),
    [
        ({"running": True}, "; the command is running"),
        ({"failed": "ended with status 1", "output": "no partition"}, "ended with status 1: no partition"),
        ({"output": "batch job 7"}, ": batch job 7"),
        ({}, "2 joined"),
    ],
)
def test_a_request_for_more_workers_in_words(about: dict[str, Any], words: str) -> None:
    text = request_in_words(MoreWorkersRow(kind="binder", asked=4, joined=2, ago_s=12.0, **about))
    assert text.startswith("asked for 4 binders 12 s ago, 2 joined")
    assert text.endswith(words)


def test_the_connections_of_a_key_are_those_of_all_its_hosts() -> None:
    rows = [row(connections=2), row(host="10.0.0.8", connections=0, last_message_ago_s=9.0), row(key="w2")]
    assert connections_of(Status(hosts=rows), "w1") == (2, 0.2, ["10.0.0.7"])
    assert connections_of(Status(hosts=[row(key="")]), "") == (0, None, [])
