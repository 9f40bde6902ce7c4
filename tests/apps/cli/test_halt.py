"""What a halt prints: what moved, what did not, and why rest may take a while all the same."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import zmq
from rich.console import Console

from rtc.apps.cli.halt import print_halt
from rtc.apps.cli.halt_at_once import plain
from rtc.apps.cli.halt_words import not_reached
from rtc.client.halt import HaltResult, SubsystemHalt
from rtc.protocol import messages as m
from rtc.protocol.messages import CommandRecord, CommandRow, Phase
from rtc.protocol.outcomes import Outcome, OutcomeKind
from rtc.protocol.wire import frames, reader


def printed(latency_s: float, rest_s: float, moving: list[str]) -> str:
    text = io.StringIO()
    mcm = SubsystemHalt(
        name="MCM", latency_s=latency_s, moving=moving, performers=["LEFT-ARM"], at_rest=True, rest_s=rest_s
    )
    result = HaltResult(
        halt="h", scope="ALL", latency_s=latency_s, confirmed=True, sent_to=["halt", "estop"], subsystems=[mcm]
    )
    print_halt(result, Console(file=text, soft_wrap=True, color_system=None))
    return text.getvalue().rstrip()


@pytest.mark.parametrize(
    ("rest_s", "moving", "line"),
    [
        (0.010, ["LEFT-ARM"], "HALT ALL: LEFT-ARM decelerating after 2.00 ms; rest confirmed after 10 ms"),
        (0.003, [], "HALT ALL: no joint was moving; the order arrived after 2.00 ms; rest confirmed after 3 ms"),
        (
            1.146,
            [],
            "HALT ALL: no joint was moving (but a hand still pressed, or a touch still gave way); "
            "the order arrived after 2.00 ms; rest confirmed after 1146 ms",
        ),
    ],
)
def test_a_halt_in_words(rest_s: float, moving: list[str], line: str) -> None:
    assert printed(0.002, rest_s, moving) == line


def test_rest_of_a_camera_that_takes_no_picture_is_confirmed() -> None:
    """Its subsystem sends no first deceleration: the words were REST NOT CONFIRMED, with exit status 0."""
    text = io.StringIO()
    eyes = SubsystemHalt(name="S&P", performers=["CAMERA-1"], at_rest=True, rest_s=0.001)
    result = HaltResult(
        halt="h", scope="CAMERA-1", latency_s=None, confirmed=True, sent_to=["halt", "estop"], subsystems=[eyes]
    )
    print_halt(result, Console(file=text, soft_wrap=True, color_system=None))
    assert "NOT CONFIRMED" not in text.getvalue()  # wording: the state
    assert "rest confirmed" in text.getvalue()


def test_a_halt_of_an_ended_command_states_how_it_ended_and_what_moves() -> None:
    about = {"text": "X", "source": "operator", "request": "1", "accepted_at_s": 0.0}
    ended = Outcome(kind=OutcomeKind.SUCCEEDED)
    record = CommandRecord(command="C-9", phase=Phase.ENDED, outcome=ended, ended_at_s=1.0, **about)
    moving = CommandRow(command="C-11", phase=Phase.EXECUTING, resources=["MACS-NEW", "RIGHT-ARM"])
    waiting = CommandRow(command="C-12", phase=Phase.HELD)

    assert (
        not_reached(record, [moving, waiting])
        == "C-9 has ended: succeeded; in motion: C-11 (MACS-NEW, RIGHT-ARM): rtc halt C-11"
    )
    held = CommandRecord(command="C-12", phase=Phase.HELD, **about)
    assert not_reached(held, [waiting]) == "C-12 is held and moves nothing; no command is in motion"


def test_plain_halts_take_the_short_way_and_others_the_long_one() -> None:
    assert plain(["right-arm", "--timeout", "3", "--json", "--run-dir=/x"]) == ("right-arm", 3.0, True, "/x")
    assert plain(["--run-dir", "/x"]) == ("ALL", 2.0, False, "/x")
    for words in (["-h"], ["--help"], ["--with", "k"], ["--run-dir", ""], ["--run-dir"]):
        assert plain(words) is None


@pytest.mark.parametrize("timeout", [["--timeout"], ["--timeout", "x"], ["--timeout", "nan"]])
def test_no_halt_is_refused_for_a_word(timeout: list[str]) -> None:
    for words in (["--bogus"], ["A", "B"], ["RIGHT", "ARM"], [" "], ["-all"], ["ÄRM"], ["X" * 300]):
        assert plain([*words, "--run-dir=/x", *timeout]) == (" ".join(words), 2.0, False, "/x")
    assert plain(["--timeout", "0", "--run-dir", "/x"]) == ("ALL", 0.01, False, "/x")


#: the command line, and the modules that it has loaded, on stderr
LISTED = """
import sys
from rtc.apps.cli import entry
try:
    entry.main()
finally:
    print(*sys.modules, file=sys.stderr)
"""


@pytest.mark.slow
@pytest.mark.untimed
@pytest.mark.parametrize(
    ("words", "scope", "at_rest"),
    [(["RIGHT-ARM"], "RIGHT-ARM", True), (["RIGHT-ARM"], "RIGHT-ARM", False), (["RIGHT", "ARM"], "ALL", True)],
)
def test_a_halt_from_a_terminal_loads_nothing_slow(tmp_path: Path, words: list[str], scope: str, at_rest: bool) -> None:
    with zmq.Context() as context, context.socket(zmq.ROUTER) as broker, context.socket(zmq.ROUTER) as arms:
        for socket, name in ((broker, "halt"), (arms, "estop")):
            socket.bind(f"ipc://{tmp_path}/{name}.sock")
        orders: list[m.HaltOrder] = []
        serving = threading.Thread(target=_serve, args=([broker, arms], orders, at_rest))
        serving.start()
        line = [sys.executable, "-P", "-c", LISTED, "halt", *words, "--run-dir", str(tmp_path)]
        done = subprocess.run(line, capture_output=True, text=True, timeout=60, env={**os.environ, "COLUMNS": "80"})
        serving.join()
    assert done.returncode == (0 if at_rest else 3), done.stderr
    assert ("rest confirmed" in done.stdout) == at_rest
    assert [order.scope for order in orders] == [scope, scope]
    assert not {"typer", "rich", "numpy", "pinocchio", "lark"} & set(done.stderr.split())


def _serve(sockets: list[zmq.Socket[bytes]], orders: list[m.HaltOrder], at_rest: bool) -> None:
    """Answer one order at each socket, as a subsystem does."""
    for socket in sockets:
        assert socket.poll(30_000)
        peer, *parts = socket.recv_multipart()
        order = reader(m.ToHalt)(parts)
        orders.append(order)
        at_s = order.called_at_s + 0.001
        started = m.HaltStarted(
            halt=order.halt, subsystem="MCM", received_at_s=at_s, decelerating_at_s=at_s, moving=["RIGHT-ARM"]
        )
        rest = m.HaltAtRest(halt=order.halt, subsystem="MCM", at_s=at_s, at_rest=at_rest, performers=["RIGHT-ARM"])
        for answer in (started, rest):
            socket.send_multipart([peer, *frames(answer)])
