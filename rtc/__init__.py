"""Run-time control of a telerobot: protocol, client, programs, models and command line; the base of all processes.

    from rtc import Client

The names below are loaded at first use (PEP 562), because workers, broker and MCM import `rtc.*` and must start fast.
This package must not import broker, workers, sim_mcm or deploy.
"""

from __future__ import annotations

from importlib import import_module

__version__ = "0.2.0.dev0"

TYPE_CHECKING = False  # as in `typing`, whose import takes as long as Python itself: Ctrl-C would meet it in `rtc`
if TYPE_CHECKING:
    from typing import Any

    from rtc.client import aio
    from rtc.client.client import Client
    from rtc.client.halt import HaltResult
    from rtc.client.handle import CommandHandle
    from rtc.protocol.outcomes import (
        ClusterError,
        KeyTrouble,
        NoCluster,
        NotSucceeded,
        Outcome,
        OutcomeKind,
        ProgramError,
        Refusal,
        RefusalReason,
        RequestDeclined,
        RtcError,
        StopReason,
        TimedOut,
        WireError,
    )

__all__ = [
    "Client",
    "ClusterError",
    "CommandHandle",
    "HaltResult",
    "KeyTrouble",
    "NoCluster",
    "NotSucceeded",
    "Outcome",
    "OutcomeKind",
    "ProgramError",
    "Refusal",
    "RefusalReason",
    "RequestDeclined",
    "RtcError",
    "StopReason",
    "TimedOut",
    "WireError",
    "aio",
]
PLACES = {
    "Client": "rtc.client.client",
    "CommandHandle": "rtc.client.handle",
    "HaltResult": "rtc.client.halt",
    "aio": "rtc.client.aio",  # the module itself
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    place = import_module(PLACES.get(name, "rtc.protocol.outcomes"))
    value = place if name == "aio" else getattr(place, name)
    globals()[name] = value
    return value
