"""Who is admitted by the gateway: Host, Origin and token of each request; the headers of each answer."""

from __future__ import annotations

import pytest
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.responses import PlainTextResponse
from starlette.routing import Route, WebSocketRoute
from starlette.testclient import TestClient
from starlette.websockets import WebSocket, WebSocketDisconnect

from rtc.apps.console.access_check import NO_TOKEN, WRONG_ORIGIN, AccessCheck

BASE = "http://127.0.0.1:8400"
HERE = {"host": "127.0.0.1:8400"}
ALIEN = "http://127.0.0.1:9000"


async def answer(request):
    return PlainTextResponse(request.state.nonce)


async def echo(socket: WebSocket):
    await socket.accept()
    await socket.send_text("in")


@pytest.fixture
def page():
    app = Starlette(
        routes=[
            Route("/", answer),
            Route("/scene", answer),
            Route("/sentence", answer, methods=["POST"]),
            Route("/session", answer, methods=["POST"]),
            WebSocketRoute("/halt", echo),
        ],
        middleware=[Middleware(AccessCheck, port=8400, token="secret", cookie="c")],
    )
    return TestClient(app, base_url=BASE)


def with_token(page: TestClient) -> TestClient:
    page.cookies.set("c", "secret")
    return page


def test_the_page_itself_needs_no_token_and_holds_a_policy_with_its_nonce(page):
    shown = page.get("/")
    assert shown.status_code == 200
    policy = shown.headers["content-security-policy"]
    assert f"'nonce-{shown.text}'" in policy
    assert "unsafe" not in policy
    assert "script-src 'self';" in policy
    assert "frame-ancestors 'none'" in policy
    assert page.get("/").text != shown.text  # a new one each time


def test_everything_else_needs_the_token(page):
    assert page.get("/scene").status_code == 401
    page.cookies.set("c", "another")
    assert page.get("/scene").status_code == 401
    assert with_token(page).get("/scene").status_code == 200


@pytest.mark.parametrize("host", ["evil.example:8400", "127.0.0.1", "127.0.0.1:80", ""])
def test_a_name_that_is_not_in_the_list_is_refused_although_it_leads_here(page, host):
    assert with_token(page).get("/scene", headers={"host": host}).status_code == 403


@pytest.mark.parametrize("origin", [None, ALIEN, "null", "http://evil.example:8400"])
def test_an_order_of_another_origin_or_of_none_is_refused(page, origin):
    headers = {} if origin is None else {"origin": origin}
    assert with_token(page).post("/sentence", headers=headers).status_code == 403
    assert page.post("/session", headers=headers).status_code == 403


@pytest.mark.parametrize("origin", [BASE, "http://localhost:8400"])
def test_an_order_of_the_page_is_admitted(page, origin):
    assert with_token(page).post("/sentence", headers={"origin": origin}).status_code == 200


@pytest.mark.parametrize(
    ("headers", "token", "code"),
    [({"origin": ALIEN}, True, WRONG_ORIGIN), ({}, True, WRONG_ORIGIN), ({"origin": BASE}, False, NO_TOKEN)],
)
def test_a_socket_is_closed_before_it_is_open(page, headers, token, code):
    if token:
        with_token(page)
    with pytest.raises(WebSocketDisconnect) as closed, page.websocket_connect("/halt", headers=HERE | headers):
        pass
    assert closed.value.code == code


def test_a_socket_of_the_page_opens(page):
    with with_token(page).websocket_connect("/halt", headers=HERE | {"origin": BASE}) as socket:
        assert socket.receive_text() == "in"
