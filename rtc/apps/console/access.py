"""How pages are admitted and with which role they act; what their requests and sockets contain."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.websockets import WebSocket, WebSocketDisconnect

from rtc.protocol import messages as m
from rtc.protocol.advice import by_person
from rtc.protocol.outcomes import Refusal, RefusalReason
from rtc.protocol.roles import MAY, Role, a_role

MAX_BODY = 64 << 10  # bytes of a request
NOT_READ = 1007  # close code of a socket


class Access(msgspec.Struct, frozen=True):
    """How pages are admitted, and with which role they act."""

    port: int
    token: str
    role: Role

    @property
    def cookie(self) -> str:
        """Its name has the port, because cookies of a host belong to all its ports."""
        return f"rtc-console-{self.port}"

    def refuses(self, endpoint: str, message: type[m.Message]) -> Refusal | None:
        """Why this role may not send such a message; the table is that of `rtc.protocol.roles`."""
        if message in MAY[endpoint].get(self.role, ()):
            return None
        words = f"this console has the role of {a_role(self.role)}, which may not do that"
        clears = "open a console with another role: rtc console --role operator, or --with KEY"
        return Refusal(reason=RefusalReason.NOT_ALLOWED, message=words, clears=by_person(clears))


async def body(request: Request) -> dict[str, Any]:
    """The JSON object of a request; empty if it is none, or too long."""
    data = b""
    async for part in request.stream():
        data += part
        if len(data) > MAX_BODY:
            return {}
    try:
        return msgspec.json.decode(data, type=dict[str, Any])
    except msgspec.MsgspecError:
        return {}


async def objects(page: WebSocket) -> AsyncIterator[dict[str, Any]]:
    """The JSON objects that a page sends, until it has gone. A socket with anything else is closed."""
    while True:
        try:
            asked = msgspec.json.decode(await page.receive_text(), type=dict[str, Any])
        except (WebSocketDisconnect, RuntimeError):
            return
        except (msgspec.MsgspecError, KeyError):
            await page.close(NOT_READ, "only JSON objects are read here")
            return
        yield asked
