"""The console in a real browser, on a running cluster: sentences, halts, a lost link, a second page, a foreign origin.

One cluster, one gateway and one browser serve all tests. Skipped where no Chromium is installed.
"""

from __future__ import annotations

import functools
import http.server
import io
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from PIL import Image

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.model.cells.cell import Cell
from rtc.spatial import geometry
from tests.apps.console.browser import LIMIT_S, Browser, Page, browser, installed

pytestmark = [
    pytest.mark.slow,
    pytest.mark.untimed,
    pytest.mark.timeout(180),  # so they come first: on one page, in one process, from which others take the last tests
    pytest.mark.skipif(not installed(), reason="no browser: install chromium to test the page of the console"),
]
READY = "window.rtcConsole?.view.drawn > 0 && Object.values(rtcConsole.state.links).every(Boolean)"
ENDED = "[...rtcConsole.state.rows.values()].some((row) => row.text === {text!r} && row.outcome?.kind === {kind!r})"
HAND = "rtcConsole.state.scene.bodies.findIndex((body) => body.name === 'RIGHT-ARM/palm')"
PLACE = f"Array.from(rtcConsole.view.sets.shown.slice(7 * ({HAND}), 7 * ({HAND}) + 3))"
MOVES = "rtcConsole.state.moving.includes('RIGHT-ARM')"
SLOW = "MOVE RIGHT-ARM TO BAY-2-FRONT"
LAST_HALT = "rtcConsole.halts.at(-1)"


class Gateway:
    """`rtc console` as a process that may be killed and started again on its port."""

    def __init__(self, run_dir: Path) -> None:
        self._run_dir = run_dir
        self.port = 0
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-P", "-m", "rtc.apps.cli.entry", "console", "--run-dir", str(self._run_dir)]
        self.process = subprocess.Popen([*command, "--port", str(self.port)], stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.link = self.process.stdout.readline().strip()
        found = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/#.+", self.link)
        assert found, self.link
        self.port = int(found[1])

    def end(self, how: signal.Signals = signal.SIGTERM) -> None:
        self.process.send_signal(how)
        self.process.wait(30)


@pytest.fixture(scope="module")
def run_dir() -> Iterator[Path]:
    with own_cluster(mcm="kinematic") as path:
        yield path


@pytest.fixture(scope="module")
def gateway(run_dir: Path) -> Iterator[Gateway]:
    started = Gateway(run_dir)
    yield started
    started.end()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def page(chromium: Browser, gateway: Gateway) -> Iterator[Page]:
    opened = chromium.page(gateway.link)
    opened.wait(READY)
    yield opened
    opened.close()


@pytest.fixture
def at_home(page: Page) -> None:
    """Nothing is typed, and no link is lost."""
    page.wait(READY)
    page.ask("rtcConsole.write('')")


def leave_line(page: Page) -> None:
    page.press("Escape")
    assert page.ask("!rtcConsole.typing(document.activeElement)")


def load_anew(page: Page) -> None:
    page.ask("window.isOld = true; location.reload()")
    page.wait(f"!window.isOld && {READY}")


def slow_move(page: Page) -> str:
    """A motion of several seconds from where the arm is."""
    up = page.ask("rtcConsole.state.rows.size") % 2
    return f"MOVE RIGHT-ARM BY {4 if up else -4} CM ALONG Z MAINTAIN SPEED 0.5 CM/S"


def by_enter(page: Page) -> None:
    page.type(slow_move(page))
    page.press("Enter")


def by_enter_with_an_open_list(page: Page) -> None:
    page.type(slow_move(page) + " ")
    page.wait("document.querySelector('.cm-tooltip-autocomplete li') !== null")
    page.press("Enter")


def by_the_button(page: Page) -> None:
    page.type(slow_move(page))
    page.click("#do")


def as_tested(page: Page) -> None:
    sentence = slow_move(page)
    page.type(sentence)
    page.press("Enter", modifiers=8)
    page.wait(f"document.querySelector('#tested.fine code')?.textContent === {sentence!r}")
    page.click("#tested button.primary")


def by_a_repeated_sentence_of_a_page_loaded_anew(page: Page) -> None:
    page.ask(f"sessionStorage.setItem('sentences', JSON.stringify([{slow_move(page)!r}]))")
    load_anew(page)
    assert page.ask("document.activeElement === document.body")
    page.press("/")
    page.press("ArrowUp")
    page.press("Enter")


WAYS = [by_enter, by_enter_with_an_open_list, by_the_button, as_tested, by_a_repeated_sentence_of_a_page_loaded_anew]


def test_the_scene_is_drawn_and_the_token_has_left_the_address(page: Page):
    picture = Image.open(io.BytesIO(page.screenshot("#canvas"))).convert("RGB")
    colours = picture.getcolors(maxcolors=1 << 20)
    assert colours is not None
    assert len(colours) > 50
    assert page.ask("location.hash") == ""
    assert page.ask("document.cookie") == ""  # no script can read the token
    assert page.problems == []


@pytest.mark.usefixtures("at_home")
def test_a_wrong_word_is_underlined_with_its_reason_below(page: Page):
    page.type("GRAPS MACS-NEW")
    page.wait("document.querySelector('#hint.wrong')?.textContent.includes('GRASP')")
    assert page.wait("document.querySelector('.cm-lintRange-error')?.textContent") == "GRAPS"


@pytest.mark.usefixtures("at_home")
def test_tab_completes_a_name_of_the_cell(page: Page):
    page.type("STOW LEFT-A")
    page.wait("document.querySelector('.cm-tooltip-autocomplete li')?.textContent === 'LEFT-ARM'")
    page.press("Tab")
    page.wait("document.querySelector('.cm-content').textContent.trim() === 'STOW LEFT-ARM'")


@pytest.mark.usefixtures("at_home")
def test_a_sentence_is_tested_on_paper_then_done_and_seen_to_move(page: Page):
    before = page.ask(PLACE)
    page.type("STOW RIGHT-ARM")
    page.press("Enter", modifiers=8)
    page.wait("rtcConsole.state.prediction?.text === 'TEST STOW RIGHT-ARM'")
    assert page.ask(PLACE) == before
    page.wait("rtcConsole.view.sets.prediction !== null")
    page.click("#tested button.primary")
    page.wait(ENDED.format(text="STOW RIGHT-ARM", kind="succeeded"))
    page.wait(f"Math.hypot(...({PLACE}).map((n, i) => n - {before}[i])) > 0.05")
    page.wait("rtcConsole.state.prediction === null")  # the facts that it relied on have changed


@pytest.mark.usefixtures("at_home")
def test_an_advice_is_tested_when_it_is_pressed_and_then_done(page: Page):
    page.type("LIFT MACS-NEW BY 5 CM")
    page.press("Enter")
    page.wait("document.querySelector('#tested.advice button')?.textContent.startsWith('GRASP MACS-NEW')")
    page.click("#tested.advice button")
    page.wait("rtcConsole.state.prediction?.text === 'TEST GRASP MACS-NEW'")
    assert not page.ask(ENDED.format(text="GRASP MACS-NEW", kind="succeeded"))  # on paper alone
    page.click("#tested button.primary")
    page.wait(ENDED.format(text="GRASP MACS-NEW", kind="succeeded"))


@pytest.mark.usefixtures("at_home")
def test_sentences_of_one_advice_are_tested_one_after_the_other_and_done_so(page: Page):
    """The second one is feasible only in the world after the first."""
    page.ask("rtcConsole.tryOut(['RELEASE MACS-NEW', 'RETRACT RIGHT-ARM BY 5 CM']) && 0")
    page.wait("document.querySelector('#tested code')?.textContent === 'RELEASE MACS-NEW; RETRACT RIGHT-ARM BY 5 CM'")
    page.click("#tested button.primary")
    page.wait(ENDED.format(text="RETRACT RIGHT-ARM BY 5 CM", kind="succeeded"))
    assert page.ask(ENDED.format(text="RELEASE MACS-NEW", kind="succeeded"))


@pytest.mark.usefixtures("at_home")
def test_the_advice_for_a_sentence_goes_with_the_next_one(page: Page):
    page.ask("rtcConsole.submit('PLACE MACS-OLD ON RACK-2') && 0")
    page.wait("document.querySelector('#tested:not([hidden]).advice button') !== null")
    page.ask("rtcConsole.submit('STOW RIGHT-ARM') && 0")
    page.wait("document.querySelector('#tested').hidden")


@pytest.mark.usefixtures("at_home")
def test_space_halts_a_motion_while_the_page_is_busy(page: Page):
    page.ask(f"rtcConsole.submit({SLOW!r})")
    page.wait(MOVES)
    leave_line(page)
    page.ask("setTimeout(() => { const end = performance.now() + 200; while (performance.now() < end); }, 0) && 0")
    page.press(" ")
    page.wait(f"{LAST_HALT}?.result.moving.includes('RIGHT-ARM') && {LAST_HALT}.result.confirmed")
    assert page.ask(f"{LAST_HALT}.result.latency_s") > 0.0  # `test_floods` judges how long it is
    page.wait("document.querySelector('#halt-report.good') !== null")
    page.wait(ENDED.format(text=SLOW, kind="halted"))


@pytest.mark.usefixtures("at_home")
@pytest.mark.parametrize("submit", WAYS)
def test_space_after_a_submission_is_halt(page: Page, submit: Callable[[Page], None]):
    submit(page)
    page.wait(f"{MOVES} || document.querySelector('#hint.wrong')?.textContent.includes('refused')")
    assert page.ask(MOVES), page.ask("[document.querySelector('#hint').textContent, rtcConsole.state.line]")
    count = page.ask("rtcConsole.halts.length")
    assert page.ask("document.querySelector('#halt kbd').textContent") == "Space"
    page.press(" ")
    page.wait(f"rtcConsole.halts.length === {count} + 1 && {LAST_HALT}.result.confirmed")
    page.wait(f"!{MOVES} && [...rtcConsole.state.rows.values()].every((row) => row.outcome)")
    last = "[...rtcConsole.state.rows.values()].findLast((row) => row.text.startsWith('MOVE'))"
    assert page.ask(f"{last}.outcome.kind") == "halted"


@pytest.mark.usefixtures("at_home")
def test_space_in_the_empty_line_is_halt_and_one_escape_leaves_a_list(page: Page):
    count = page.ask("rtcConsole.halts.length")
    page.press(" ")
    page.wait(f"rtcConsole.halts.length === {count} + 1")
    assert page.ask("document.querySelector('.cm-content').textContent.trim()") != " "
    assert page.ask("rtcConsole.state.line") == ""
    page.type("STOW ")
    page.wait("document.querySelector('.cm-tooltip-autocomplete') !== null")
    page.wait("document.querySelector('#halt kbd').textContent === 'Esc Space'")
    leave_line(page)
    page.wait("document.querySelector('#halt kbd').textContent === 'Space'")
    page.press(" ")
    page.wait(f"rtcConsole.halts.length === {count} + 2")
    assert page.ask("rtcConsole.state.line") == "STOW "


@pytest.mark.usefixtures("at_home")
@pytest.mark.parametrize("field", ["#legend input", ".cameras input", ".world input", "#theme"])
def test_space_is_halt_wherever_nothing_is_typed(page: Page, field: str):
    page.ask("rtcConsole.choose('world')" if field.startswith(".world") else "rtcConsole.choose('cameras')")
    page.ask(f"document.querySelector({field!r}).focus()")
    count, was = page.ask("rtcConsole.halts.length"), page.ask(f"document.querySelector({field!r}).checked ?? 0")
    page.press(" ")
    page.wait(f"rtcConsole.halts.length === {count} + 1")
    assert page.ask(f"document.querySelector({field!r}).checked ?? 0") == was
    page.ask("rtcConsole.choose('commands')")


@pytest.mark.usefixtures("at_home")
def test_the_result_of_a_halt_is_gone_when_a_motion_starts(page: Page):
    page.ask("rtcConsole.halt()")
    page.wait("document.querySelector('#halt-report.good') !== null")
    page.wait("document.querySelector('#halt-report').textContent.includes(' ago')")
    by_enter(page)
    page.wait(MOVES)
    assert page.ask("document.querySelector('#halt-report.good')?.className ?? 'gone'") == "gone"
    page.press("/")
    page.type("HALT RIGHT-ARM")
    page.press("Enter")
    page.wait("document.querySelector('#halt-report.good b')?.textContent === 'REST CONFIRMED: RIGHT-ARM'")


@pytest.mark.usefixtures("at_home")
def test_the_button_halts_and_its_command_explains_itself(page: Page):
    page.ask(f"rtcConsole.submit({SLOW!r})")
    page.wait(MOVES)
    count = page.ask("rtcConsole.halts.length")
    page.click("#halt")
    page.wait(f"rtcConsole.halts.length > {count}")
    page.wait(f"{LAST_HALT}?.result.moving.includes('RIGHT-ARM') && {LAST_HALT}.result.confirmed")
    page.wait("document.querySelector('.card.open .why')?.textContent.includes('given by the operator')")


@pytest.mark.usefixtures("at_home")
def test_space_in_the_line_is_a_blank(page: Page):
    count = page.ask("rtcConsole.halts.length")
    page.type("STOW")
    page.press(" ")
    assert page.ask("rtcConsole.halts.length") == count


REFUSED = "MOVE LEFT-ARM TO RACK-1-FRONT"


@pytest.mark.usefixtures("at_home")
def test_a_refused_sentence_comes_back_with_its_reason_and_without_the_focus(page: Page):
    page.type(REFUSED)
    page.press("Enter")
    page.wait("document.querySelector('#hint.wrong')?.textContent.includes('refused')")
    assert page.ask("rtcConsole.state.line") == REFUSED
    assert page.ask("document.querySelector('#hint').textContent.includes(' — ')")  # with what clears it
    count = page.ask("rtcConsole.halts.length")
    page.press(" ")
    page.wait(f"rtcConsole.halts.length === {count} + 1")
    page.wait("document.querySelectorAll('.card.open .why li').length > 2")
    lines = page.ask("[...document.querySelectorAll('.card.open .why li')].map((line) => line.textContent)")
    advice = next(n for n, line in enumerate(lines) if line.startswith("to clear it"))
    assert advice < next(n for n, line in enumerate(lines) if "was given by" in line)


@pytest.mark.usefixtures("at_home")
def test_a_test_of_another_client_is_not_shown(page: Page, run_dir: Path):
    text = "TEST MOVE LEFT-ARM BY 1 CM ALONG Z"
    with Client(run_dir) as client:
        client.run(text)
    page.wait(ENDED.format(text=text, kind="succeeded"))
    assert page.ask("rtcConsole.state.prediction?.text") != text
    assert text.removeprefix("TEST ") not in page.ask("document.querySelector('#tested').textContent")


@pytest.mark.usefixtures("at_home")
def test_before_the_first_measurement_there_is_no_age(page: Page):
    found = """import('/static/store.js').then(({state, measuredAge, seconds}) => {
        const was = state.measuredAt; state.measuredAt = 0;
        const words = seconds(measuredAge()); state.measuredAt = was; return words; })"""
    assert page.ask(found) == "–"


@pytest.mark.usefixtures("at_home")
def test_before_the_first_picture_there_is_no_image(page: Page):
    load_anew(page)
    assert page.ask("[...document.querySelectorAll('.cameras img')].every((image) => image.hidden)")
    page.ask("rtcConsole.choose('cameras')")
    page.wait("[...document.querySelectorAll('.cameras img')].every((image) => image.naturalWidth > 0)", 90.0)
    page.ask("rtcConsole.choose('commands')")


@pytest.mark.usefixtures("at_home")
@pytest.mark.parametrize("width", [700, 1280])
def test_no_tab_is_cut(page: Page, width: int):
    page.resize(width, 700)
    last = "Math.max(...[...document.querySelectorAll('#tabs button')].map((tab) => tab.getBoundingClientRect().right))"
    page.wait(f"innerWidth === {width}")
    assert page.ask(f"{last} <= document.querySelector('#tabs').getBoundingClientRect().right")
    page.resize(1280, 720)


@pytest.mark.usefixtures("at_home")
def test_a_given_arm_that_was_taken_back_is_no_fault(page: Page):
    page.ask("rtcConsole.submit('GIVE LEFT-ARM TO OPERATOR')")
    page.wait("document.querySelector('.request') !== null")
    page.ask("rtcConsole.submit('DONE')")
    page.wait(ENDED.format(text="GIVE LEFT-ARM TO OPERATOR", kind="succeeded"))
    bar = "[...document.querySelectorAll('.bar')].find((bar) => bar.title.includes('GIVE LEFT-ARM'))"
    page.wait(f"{bar}?.querySelector('.end').textContent === '✓'")
    assert page.ask(f"{bar}.querySelectorAll('.off, .warning').length") == 0
    assert page.ask("!document.querySelector('#panels').textContent.match(/C-[0-9]+[.][0-9]/)")


@pytest.mark.usefixtures("at_home")
def test_no_element_covers_the_button(page: Page):
    page.type("GRASP ")
    page.wait("document.querySelector('.cm-tooltip-autocomplete') !== null")
    covered = (
        "(() => { const r = document.querySelector('#halt').getBoundingClientRect(); return document.elementFromPoint("
    )
    assert page.ask(f"{covered}r.x + r.width / 2, r.y + r.height / 2).closest('#halt') !== null; }})()")


@pytest.mark.usefixtures("at_home")
def test_a_second_page_shows_the_same_commands_and_bodies(page: Page, chromium: Browser, gateway: Gateway):
    second = chromium.page(f"http://127.0.0.1:{gateway.port}/")  # its cookie admits it
    second.wait(READY)
    rows = "[...rtcConsole.state.rows.values()].map((row) => [row.command, row.phase]).sort().join()"
    assert second.wait(rows) == page.ask(rows)
    second.close()


def hand(run_dir: Path) -> list[float]:
    """The true place of the right hand (m)."""
    with Client(run_dir) as client:
        return client.truth().tcp["RIGHT-ARM"][:3]


GRASP = "GRASP MACS-NEW HANDLE-A WITH RIGHT-ARM VIA OPERATOR-INTERVENTION"


def grasp_pose(client: Client) -> geometry.Array:
    """Where the tcp is at HANDLE-A, in the true world."""
    points = Cell.load("swapout").object("MACS-NEW").grasp_points
    frame = next(one.frame.pose for one in points if one.name == "HANDLE-A")
    return geometry.compose(client.truth().poses["MACS-NEW"], frame)


def asked_to(page: Page, words: str) -> None:
    page.wait(f"document.querySelector('.request header b')?.textContent.includes({words!r}) && rtcConsole.grip()")


def steer(page: Page, goal: geometry.Floats, near_m: float) -> None:
    """Hold until the drawn tcp is this near to the goal and does not turn any more, then let go."""
    page.ask(f"rtcConsole.hold('RIGHT-ARM', ({STEER})({list(map(float, goal))})) && 0")
    off = f"({STEER})({list(map(float, goal))})().twist"
    page.wait(f"{off}.slice(0, 3).every((part) => Math.abs(part) < {3 * near_m}) && "
              f"{off}.slice(3).every((part) => Math.abs(part) < 0.04)")  # fmt: skip
    page.ask("rtcConsole.release()")
    page.wait("document.querySelector('.request .who').textContent === 'at rest'")


@pytest.fixture
def given(page: Page, run_dir: Path) -> Iterator[None]:
    """The right arm is the operator's."""
    page.ask("rtcConsole.submit('GIVE RIGHT-ARM TO OPERATOR')")
    page.wait("document.querySelector('.request') !== null && rtcConsole.grip() !== null")
    yield
    page.ask("rtcConsole.release()")
    page.ask("rtcConsole.submit('DONE')")
    page.wait("document.querySelector('.request') === null")


@pytest.mark.usefixtures("at_home", "given")
def test_an_arm_moves_while_a_button_is_held_and_rests_when_it_is_let_go(page: Page, run_dir: Path):
    before = hand(run_dir)
    button = page.middle(".request .axis:nth-child(3) .hold:last-child")  # z +
    page.mouse("mouseMoved", button)
    page.mouse("mousePressed", button)
    page.wait("rtcConsole.sent.count > 20 && rtcConsole.answers['RIGHT-ARM'].refused === ''")
    assert page.ask("rtcConsole.holding()") == "RIGHT-ARM"
    page.mouse("mouseReleased", button)
    page.wait("document.querySelector('.request .who').textContent === 'at rest'")
    after = hand(run_dir)
    assert after[2] > before[2] + 0.001
    assert math.dist(after[:2], before[:2]) < 0.002
    assert math.dist(hand(run_dir), after) < 1e-4


#: A gamepad of the standard mapping: `rtcPad.buttons[n].value`, `rtcPad.axes[n]`.
PAD = """(() => {
  const buttons = Array.from({length: 17}, () => ({value: 0}));
  window.rtcPad = {connected: true, mapping: 'standard', axes: [0, 0, 0, 0], buttons};
  navigator.getGamepads = () => [window.rtcPad];
  window.dispatchEvent(new Event('gamepadconnected'));
})()"""


@pytest.mark.usefixtures("at_home", "given")
def test_a_gamepad_moves_the_arm_only_while_its_deadman_is_held(page: Page, run_dir: Path):
    before = hand(run_dir)
    page.ask(f"{PAD}; rtcPad.buttons[7].value = 1")  # up, without the deadman
    page.ask("requestAnimationFrame(() => requestAnimationFrame(() => { rtcPad.seen = true; })) && 0")
    page.wait("rtcPad.seen")
    assert page.ask("rtcConsole.holding()") == ""
    page.ask("rtcPad.buttons[5].value = 1")
    page.wait("rtcConsole.holding() === 'RIGHT-ARM'")
    page.wait(f"rtcConsole.sent.count > {page.ask('rtcConsole.sent.count') + 20}")
    page.ask("rtcPad.buttons[5].value = 0")
    page.wait("document.querySelector('.request .who').textContent === 'at rest' && rtcConsole.holding() === ''")
    after = hand(run_dir)
    assert after[2] > before[2] + 0.001
    assert math.dist(after[:2], before[:2]) < 0.002


@pytest.mark.usefixtures("at_home", "given")
def test_the_hand_follows_the_gizmo(page: Page, run_dir: Path):
    before = hand(run_dir)
    x, y = page.wait("rtcConsole.grip().at()")
    page.mouse("mouseMoved", (x + 1, y))
    page.mouse("mouseMoved", (x, y))
    page.wait("rtcConsole.grip().picked() === 'XYZ'")
    page.mouse("mousePressed", (x, y))  # the middle of the gizmo: along the picture
    page.mouse("mouseMoved", (x, y - 25))
    page.mouse("mouseMoved", (x, y - 50))
    page.wait("rtcConsole.holding() === 'RIGHT-ARM' && rtcConsole.answers['RIGHT-ARM'].refused === ''")
    held_until_s = time.monotonic() + LIMIT_S
    while math.dist(hand(run_dir), before) <= 0.001:  # without a GPU the gizmo follows the mouse late
        assert time.monotonic() < held_until_s
    page.mouse("mouseReleased", (x, y - 50))
    page.wait("document.querySelector('.request .who').textContent === 'at rest'")


@pytest.mark.usefixtures("at_home", "given")
def test_a_page_that_goes_lets_go(page: Page, chromium: Browser, gateway: Gateway, run_dir: Path):
    second = chromium.page(f"http://127.0.0.1:{gateway.port}/")
    second.wait(f"{READY} && document.querySelector('.request') !== null")
    second.ask("rtcConsole.hold('RIGHT-ARM', () => ({twist: [0, 0, 0.02, 0, 0, 0], frame: 'world'}))")
    page.wait("document.querySelector('.request .who').textContent.startsWith('moved by')")
    second.close()
    page.wait("document.querySelector('.request .who').textContent === 'at rest'")
    there = hand(run_dir)
    assert math.dist(hand(run_dir), there) < 1e-4


#: A person who sees the picture: each message leads from where the tcp is drawn to the goal [x y z qx qy qz qw].
STEER = """(goal) => () => {
  const tcp = rtcConsole.state.scene.arms.find((arm) => arm.name === 'RIGHT-ARM').tcp;
  const k = 7 * rtcConsole.state.scene.bodies.findIndex((body) => body.name === tcp);
  const now = rtcConsole.view.sets.shown.slice(k, k + 7), [x, y, z, w] = goal.slice(3), [a, b, c, d] = now.slice(3);
  const turn = [d * x - w * a + b * z - c * y, d * y - w * b + c * x - a * z, d * z - w * c + a * y - b * x];
  const sign = Math.sign(w * d + x * a + y * b + z * c) || 1;
  return {twist: [...[0, 1, 2].map((n) => 3 * (goal[n] - now[n])), ...turn.map((one) => 5 * sign * one)]};
}"""


@pytest.mark.usefixtures("at_home")
def test_the_operator_grasps_what_is_displaced_and_a_word_alone_is_not_believed(
    page: Page, run_dir: Path, tmp_path: Path
):
    with Client(run_dir) as client:
        client.run("MOVE RIGHT-ARM TO RACK-1-FRONT")
        client.displace("MACS-NEW", [0.0, 0.006, 0.0104, 0.0, 0.0, 0.0])
        page.ask(f"rtcConsole.submit({GRASP!r})")
        asked_to(page, "neighborhood")
        page.wait("document.querySelector('.request .seen img').naturalWidth > 100")  # its picture
        file = tmp_path / "request.png"
        command = [sys.executable, "-P", "-m", "rtc.apps.cli.entry", "operator", "--picture", str(file)]
        shown = subprocess.run([*command, "--run-dir", str(run_dir)], capture_output=True, text=True, check=True).stdout
        assert "neighborhood of MACS-NEW" in shown
        assert Image.open(file).size == (640, 480)
        page.click(".request .answer .primary")
        page.wait("document.querySelector('.request .verdict').textContent.includes('near enough')")
        goal = grasp_pose(client)
        steer(page, geometry.translate(goal, -0.12 * geometry.rotate(goal, (0.0, 0.0, 1.0))), 0.02)
        page.click(".request .answer .primary")
        asked_to(page, "grasp point")
        width_m = page.ask("rtcConsole.state.arms['RIGHT-ARM'].hand_width_m")
        page.ask("rtcConsole.hold('RIGHT-ARM', () => ({hand: 'close'})) && 0")  # by mistake
        page.wait("document.querySelector('.request .note[role=status]').textContent.includes('not part of')")
        page.ask("rtcConsole.release()")
        assert page.ask("rtcConsole.state.arms['RIGHT-ARM'].hand_width_m") == pytest.approx(width_m, abs=1e-4)
        steer(page, goal, 0.001)
        page.click(".request .answer .primary")
        asked_to(page, "close the hand")
        close = page.middle(".request .tools .hold:nth-child(2)")
        page.mouse("mouseMoved", close)
        page.mouse("mousePressed", close)
        page.wait("rtcConsole.state.arms['RIGHT-ARM'].hand_width_m < 0.04")
        page.wait(f"rtcConsole.sent.count > {page.ask('rtcConsole.sent.count') + 40}")
        page.mouse("mouseReleased", close)
        page.wait("document.querySelector('.request .who').textContent === 'at rest'")
        page.click(".request .answer .primary")
        page.wait(ENDED.format(text=GRASP, kind="succeeded"))
        assert client.truth().held["RIGHT-ARM"] == ["MACS-NEW"]
        [believed] = client.world.view(keys=["MACS-NEW.frame"]).facts
        assert math.dist(believed.value[:3], client.truth().poses["MACS-NEW"][:3]) < 0.002


@pytest.mark.usefixtures("at_home")
def test_a_page_of_another_origin_can_do_nothing(chromium: Browser, gateway: Gateway, tmp_path: Path):
    (tmp_path / "index.html").write_text("<title>another</title>")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        alien = chromium.page(f"http://127.0.0.1:{other.server_port}/")
        alien.wait("document.title === 'another'")
        here = f"127.0.0.1:{gateway.port}"
        opens = f"new Promise((done) => {{ const s = new WebSocket('ws://{here}/halt'); "
        assert alien.ask(f"{opens}s.onopen = () => done('open'); s.onclose = () => done('closed'); }})") == "closed"
        sends = f"fetch('http://{here}/sentence', {{method: 'POST', credentials: 'include', body: '{{}}'}})"
        assert alien.ask(f"{sends}.then(() => 'answer', () => 'refused')") == "refused"
        alien.close()
        other.shutdown()


@pytest.mark.usefixtures("at_home")
def test_a_lost_link_is_shown_at_once_and_no_picture_stays(page: Page, gateway: Gateway):
    os.kill(gateway.process.pid, signal.SIGSTOP)
    try:
        page.wait("!document.querySelector('#banner').hidden && !document.querySelector('#unknown').hidden", 6.0)
    finally:
        os.kill(gateway.process.pid, signal.SIGCONT)
    page.wait("document.querySelector('#banner').hidden && document.querySelector('#unknown').hidden")


@pytest.mark.usefixtures("at_home")
def test_a_killed_gateway_is_forgotten_and_its_successor_knows_the_commands(
    page: Page, gateway: Gateway, run_dir: Path
):
    long = "HOLD RIGHT-ARM FOR 60 SEC"
    with Client(run_dir) as client:
        handle = client.submit(long)
        client.halt("RIGHT-ARM")
        handle.wait()
    life = page.ask("rtcConsole.state.life")
    gateway.end(signal.SIGKILL)
    page.wait("!document.querySelector('#banner').hidden")
    with Client(run_dir) as client:
        client.run("STOW LEFT-ARM")  # while no page sees it
    gateway.start()
    page.wait(f"rtcConsole.state.life !== {life!r} && {READY}")
    page.wait(ENDED.format(text="STOW LEFT-ARM", kind="succeeded"))
    page.wait(ENDED.format(text=long, kind="halted"))
    assert page.problems == []
