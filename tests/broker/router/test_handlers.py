"""Every message that a peer may send to the broker has a handler."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, get_args

import pytest

from broker.router import client_messages, subsystem_messages, supervisor_messages, worker_messages
from rtc.protocol import messages as m

# The supervisor's module takes these by their sender, before it looks into its table.
BY_SENDER = {m.UnreadableMessages, m.GatewayReport}


@pytest.mark.parametrize(
    ("union", "handled"),
    [
        (m.ClientToBroker, client_messages.HANDLERS),
        (m.WorkerToBroker, worker_messages.HANDLERS),
        (m.SubsystemToBroker, subsystem_messages.HANDLERS),
        (m.SupervisorToBroker, {*supervisor_messages.HANDLERS, *BY_SENDER}),
    ],
    ids=["client", "worker", "subsystem", "supervisor"],
)
def test_every_message_of_a_union_has_a_handler(union: Any, handled: Collection[type]) -> None:
    assert set(get_args(union)) == set(handled)
