"""The pages' side of the gateway: routes and sockets. It checks roles, and turns requests into calls.

GET  /, /static/...     the page; holds nothing
POST /session           the token of the link, for a cookie
GET  /me, /scene        the role of pages; the bodies of the cell
POST /check, /sentence  while a sentence is typed; submit it
GET  /why, /picture     the chain of causes of a command; what a camera sees
POST /halt              on a connection that has served another request
WS   /poses             frames of poses; the page acknowledges each
WS   /story             commands, facts and status as JSON
WS   /operate           the stream of an operator

The socket /halt is in a process of its own (`halt_door`).
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import Awaitable, Coroutine
from pathlib import Path
from typing import Any

import msgspec
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from rtc.apps.console.access import Access, body, objects
from rtc.apps.console.access_check import AccessCheck, same
from rtc.apps.console.camera_pictures import CameraPictures
from rtc.apps.console.halt_lines import HaltLines
from rtc.apps.console.hub import Hub
from rtc.apps.console.operating import OperatorStream
from rtc.apps.console.pages import FrameSlot, Mailbox
from rtc.apps.console.reopened import ReopenedClient
from rtc.apps.console.sentences import check
from rtc.client.aio import CommandHandle
from rtc.drawing.scene import true_scene
from rtc.language.fastpath import halt_scope
from rtc.language.parse import Grammar
from rtc.protocol import messages as m
from rtc.protocol.outcomes import Refusal, RequestDeclined, RtcError
from rtc.protocol.roles import Role
from rtc.runtime.keys import Endpoints
from rtc.wording.commands import why

NOT_HERE = 4404  # close code of a socket
STATIC = Path(__file__).parent / "static"
TRUTH_S, TRUTH_LOOKS = 0.1, 30  # a picture waits for a true scene that is new
READ_AGAIN = 20  # commands before the start of the gateway that are shown
CHARACTERS = 4000  # of a sentence that is checked while it is typed


class Console:
    """Answers pages. `client`: that of all pages."""

    def __init__(
        self,
        hub: Hub,
        access: Access,
        halts: HaltLines,
        client: ReopenedClient,
        grammar: Grammar,
        pictures: CameraPictures | None,
        endpoints: Endpoints,
    ) -> None:
        self.hub, self._access, self._halts = hub, access, halts
        self._client, self._grammar, self._pictures, self._endpoints = client, grammar, pictures, endpoints
        self._operators = itertools.count(1)
        self._names = hub.names()

    def app(self) -> Starlette:
        admission = Middleware(
            AccessCheck, port=self._access.port, token=self._access.token, cookie=self._access.cookie
        )
        return Starlette(
            middleware=[admission],
            routes=[
                Route("/", self._page),
                Route("/session", self._session, methods=["POST"]),
                Route("/me", self._me),
                Route("/scene", self._scene),
                Route("/check", self._check, methods=["POST"]),
                Route("/sentence", self._sentence, methods=["POST"]),
                Route("/halt", self._halt, methods=["POST"]),
                Route("/why/{command}", self._chain),
                Route("/picture/{camera}", self._picture),
                WebSocketRoute("/poses", self._poses_socket),
                WebSocketRoute("/story", self._story_socket),
                WebSocketRoute("/operate", self._operate_socket),
                Mount("/static", StaticFiles(directory=STATIC)),
            ],
        )

    # --- pages and questions --------------------------------------------------------------------------

    async def _page(self, request: Request) -> Response:
        page = (STATIC / "index.html").read_text(encoding="utf-8")
        return HTMLResponse(page.replace("{{nonce}}", request.state.nonce))

    async def _session(self, request: Request) -> Response:
        given = await body(request)
        if not same(str(given.get("token", "")), self._access.token):
            return JSONResponse({"error": "this link is of another run; open the one of `rtc console`"}, 401)
        answer = Response(status_code=204)
        answer.set_cookie(self._access.cookie, self._access.token, httponly=True, samesite="strict", path="/")
        return answer

    async def _me(self, _: Request) -> Response:
        return JSONResponse({"role": self._access.role})

    async def _scene(self, _: Request) -> Response:
        return Response(self.hub.scene(), media_type="application/json")

    async def _check(self, request: Request) -> Response:
        given = await body(request)
        text = str(given.get("text", ""))[:CHARACTERS]
        at = given.get("at")
        place = min(max(0, at), len(text)) if type(at) is int else len(text)
        return JSONResponse(check(self._grammar, text, place, self._names))

    async def _chain(self, request: Request) -> Response:
        record = await _or_refusal(self._trace(request.path_params["command"]))
        return JSONResponse({"lines": why(record)} if isinstance(record, m.CommandRecord) else record)

    async def _trace(self, command: str) -> m.CommandRecord:
        return await (await self._client.take()).trace(command)

    async def read_records(self, live: bool) -> None:
        """Let the story take the records of live commands anew; otherwise those of the latest."""
        with contextlib.suppress(RtcError):
            last = (await (await self._client.take()).status()).commands_accepted
            latest = [f"C-{n}" for n in range(max(1, last - READ_AGAIN + 1), last + 1)]
            for command in list(self.hub.story.live) if live else latest:
                with contextlib.suppress(RequestDeclined):
                    self.hub.story.take_record(await self._trace(command))

    async def close(self) -> None:
        """In the event loop of the pages."""
        await self._client.close()

    async def _picture(self, request: Request) -> Response:
        camera = request.path_params["camera"]
        if camera not in {one.name for one in self.hub.cell.cameras}:
            return JSONResponse({"error": f"the cell has no camera {camera}"}, 404)
        for _ in range(TRUTH_LOOKS):  # a page that has just opened asks before the first truth has come
            if self._pictures is None or self.hub.has_truth():
                break
            await asyncio.sleep(TRUTH_S)
        truth = self.hub.truth
        if self._pictures is None or truth is None or not self.hub.has_truth():
            return JSONResponse({"error": "cameras are simulated, and no simulator reports a true scene"}, 503)
        try:
            drawn = await asyncio.to_thread(self._pictures.take, camera, true_scene(truth))
        except RtcError as error:
            return JSONResponse({"error": str(error)}, 503)
        return Response(drawn, media_type="image/jpeg")

    # --- orders ---------------------------------------------------------------------------------------

    async def _sentence(self, request: Request) -> Response:
        given = await body(request)
        text, tested, after = (str(given.get(key, "")) for key in ("text", "if_tested", "after_test"))
        if scope := halt_scope(text):
            return JSONResponse({"halt": await self._order_halt(scope)})
        if refused := self._access.refuses("front", m.CommandText):
            return JSONResponse(_refused(refused))

        answer = await _or_refusal(self._submit(text, tested, after))
        if not isinstance(answer, CommandHandle):
            return JSONResponse(answer)
        self.hub.take_of_page(answer.number)
        return JSONResponse({"command": answer.number})

    async def _submit(self, text: str, tested: str, after: str) -> CommandHandle:
        client = await self._client.take()
        return await client.submit(text, on_progress=self._take_report, if_tested=tested, after_test=after)

    def _take_report(self, note: m.ProgressNote) -> None:
        """A report of EVERY or WHEN, which the event stream lacks."""
        if note.seq == 0:
            self.hub.story.take(note)

    async def _halt(self, request: Request) -> Response:
        given = await body(request)
        return JSONResponse(await self._order_halt(str(given.get("scope", "ALL"))))

    async def _order_halt(self, scope: str) -> dict[str, Any]:
        if refused := self._access.refuses("halt", m.HaltOrder):
            return {"error": refused.message}
        return await self._halts.order(scope)

    # --- sockets --------------------------------------------------------------------------------------

    async def _poses_socket(self, socket: WebSocket) -> None:
        slot = FrameSlot()

        async def send() -> None:
            while True:
                await socket.send_bytes(await slot.take())

        async def receive() -> None:
            while True:
                text = await socket.receive_text()
                if text.startswith("clock"):
                    await socket.send_text(f"{text} {asyncio.get_running_loop().time()}")
                else:
                    slot.acknowledged()

        await socket.accept()
        self.hub.frames.add(slot)
        try:
            await _both(send(), receive())
        finally:
            self.hub.frames.discard(slot)

    async def _story_socket(self, socket: WebSocket) -> None:
        box = Mailbox(self.hub.anew)

        async def send() -> None:
            while True:
                await socket.send_text((await box.take()).decode())

        async def receive() -> None:
            async for asked in objects(socket):
                since = asked.get("since")
                box.put(*self.hub.story.since(since if isinstance(since, int) else 0))

        await socket.accept()
        box.put(*self.hub.anew())
        self.hub.boxes.add(box)
        try:
            await _both(send(), receive())
        finally:
            self.hub.boxes.discard(box)

    async def _operate_socket(self, socket: WebSocket) -> None:
        await socket.accept()
        if self._access.role is not Role.OPERATOR:
            return await socket.close(NOT_HERE, "arms are moved by hand only by an operator")
        name = f"console page {next(self._operators)}"
        stream = OperatorStream(self._endpoints, self.hub.cell, name, socket.send_json)
        try:
            async for asked in objects(socket):
                await stream.send(str(asked.pop("arm", "")), asked)
        except (WebSocketDisconnect, RuntimeError):  # the page has gone before its answer
            pass
        finally:
            await stream.close()


async def _both(*parts: Coroutine[Any, Any, None]) -> None:
    """Until one of them ends; a page that has gone is no error."""
    tasks = [asyncio.create_task(part) for part in parts]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _or_refusal(asked: Awaitable[Any]) -> Any:
    """What was asked for; otherwise the refusal or the error, as JSON types."""
    try:
        return await asked
    except RequestDeclined as declined:
        return _refused(declined.refusal)
    except (RtcError, ValueError) as error:
        return {"error": str(error)}


def _refused(refusal: Refusal) -> dict[str, Any]:
    return {"refusal": msgspec.to_builtins(refusal)}
