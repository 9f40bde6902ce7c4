"""A tool changer as a package, in physics: a hand is changed, faults are found and cleared, no kill makes a fact false.

The package (tests/plugins/tool_changer) is written from docs/own-mechanism.md; that an arm's hand is a fact is of rtc.
"""

from __future__ import annotations

import os
import shutil
import signal
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rtc.apps.demos.own_cluster import own_cluster
from rtc.client.client import Client
from rtc.protocol.messages import Phase, ProgressNote, Validity
from rtc.protocol.outcomes import Outcome, OutcomeKind, StopReason
from rtc.runtime.process_table import processes
from rtc.spatial import geometry
from tests.plugins.tool_changer.cells import FIGURES, with_hands

pytestmark = [pytest.mark.slow, pytest.mark.untimed]

SOURCE = Path(__file__).parents[1] / "plugins" / "tool_changer"
ARM, HAND, OTHER = "RIGHT-ARM", "HAND-A", "HAND-B"
LIMIT_S = 120.0
CELL = with_hands()
NEAR_M = 0.004  # as near as the catch of a rack holds a hand


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The package in a folder, on the path as an installation would leave it, and the cell beside it."""
    folder = tmp_path_factory.mktemp("tool_changer")
    for name in ("tool_changer.py", "tool_changer.yaml"):
        shutil.copy(SOURCE / name, folder)
    (folder / "cell.yaml").write_bytes(CELL.encode())
    points = tomllib.loads((SOURCE / "pyproject.toml").read_text())["project"]["entry-points"]
    info = folder / "tool_changer-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tool-changer\nVersion: 1.0\n")
    rows = [f"[{group}]\n" + "".join(f"{n} = {p}\n" for n, p in of.items()) for group, of in points.items()]
    (info / "entry_points.txt").write_text("".join(rows))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
        yield folder


@contextmanager
def cluster(package: Path, mcm: str = "bullet", speed: str = "max") -> Iterator[Client]:
    with own_cluster(cell=str(package / "cell.yaml"), mcm=mcm, speed=speed) as run_dir, Client(run_dir) as rtc:
        rtc.load_sections(package / "tool_changer.yaml")
        yield rtc


def end(rtc: Client, sentence: str) -> Outcome:
    return rtc.run(sentence, timeout_s=LIMIT_S).outcome


def succeeds(rtc: Client, *sentences: str) -> None:
    for sentence in sentences:
        outcome = end(rtc, sentence)
        assert outcome.kind is OutcomeKind.SUCCEEDED, (sentence, outcome.message)


def fact(rtc: Client, key: str) -> tuple[object, Validity]:
    (found,) = rtc.world.view(keys=[key]).facts
    return found.value, found.validity


def true_hand(rtc: Client) -> str:
    """What the right arm has in its coupler: each hand opens wider than the jaws, and all are open in these tests."""
    truth, most_m = rtc.truth(), CELL.arm(ARM).gripper.max_opening_m
    if sum(truth.fingers[ARM]) <= most_m:
        return ""
    return min(FIGURES, key=lambda name: geometry.distance(truth.poses[name], truth.tcp[ARM]))


def in_rack(rtc: Client, hand: str) -> bool:
    return geometry.distance(rtc.truth().poses[hand], CELL.object_pose(hand)) < NEAR_M


@pytest.mark.parametrize(("mcm", "seed"), [("bullet", ""), ("bullet", "1"), ("bullet", "2"), ("kinematic", "")])
def test_a_hand_is_laid_down_and_another_one_taken(
    package: Path, monkeypatch: pytest.MonkeyPatch, mcm: str, seed: str
) -> None:
    monkeypatch.setenv("RTC_PHYSICS_SEED", seed)
    with cluster(package, mcm) as rtc:
        succeeds(rtc, f"COUPLE {HAND}", "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A", "RELEASE MACS-NEW")
        assert fact(rtc, f"{ARM}.hand") == (HAND, Validity.VALID)
        assert end(rtc, f"COUPLE {OTHER}").kind is OutcomeKind.REFUSED

        foretold = rtc.run(f"TEST UNCOUPLE {HAND} ON {HAND}-RACK", timeout_s=LIMIT_S).outcome.rehearsal
        succeeds(rtc, f"UNCOUPLE {HAND} ON {HAND}-RACK")

        assert foretold is not None
        changes = {change.key: change.value for change in foretold.changes}
        for key in (f"{ARM}.hand", f"{HAND}.seat"):
            assert (changes[key], Validity.VALID) == fact(rtc, key)
        assert in_rack(rtc, HAND)
        succeeds(rtc, f"COUPLE {OTHER}", "MOVE RIGHT-ARM TO CLEAR-POINT-1")
        assert fact(rtc, f"{ARM}.hand") == (OTHER, Validity.VALID)
        assert true_hand(rtc) == OTHER
        assert in_rack(rtc, HAND)
        place = CELL.place("CLEAR-POINT-1").poses[ARM].pose
        assert geometry.distance(rtc.truth().tcp[ARM], place) < NEAR_M  # the tcp is that of the other hand


@pytest.fixture(scope="module")
def rtc(package: Path) -> Iterator[Client]:
    with cluster(package) as found:
        yield found


@pytest.mark.parametrize(
    ("offset", "why"),
    [
        ((0.0, 0.0, 0.15), "the rack is empty"),
        ((0.0, 0.0, 0.008), "the jaws take it, and the coupler does not reach it"),
    ],
)
def test_a_hand_that_is_not_where_it_should_be_is_not_taken_and_the_advice_leads_on(
    rtc: Client, offset: tuple[float, float, float], why: str
) -> None:
    rtc.displace(HAND, [*offset, 0.0, 0.0, 0.0])

    failed = end(rtc, f"COUPLE {HAND}")

    assert (failed.kind, failed.stop) == (OutcomeKind.FAILED, StopReason.NO_CONTACT), why
    assert fact(rtc, f"{ARM}.hand") == ("", Validity.VALID)
    assert fact(rtc, f"{HAND}.frame")[1] is not Validity.VALID
    assert end(rtc, f"COUPLE {HAND}").kind is OutcomeKind.REFUSED  # it may be anywhere
    assert failed.refusal is not None
    advice = failed.refusal.clears[0]
    assert advice.again
    for sentence in advice.sentences:
        if sentence.startswith("SET"):  # a person looks before, and puts it into its rack
            lies = rtc.truth().poses[HAND]
            back = [a - b for a, b in zip(CELL.object_pose(HAND)[:3].tolist(), lies[:3], strict=True)]
            rtc.displace(HAND, [*back, 0.0, 0.0, 0.0])
        succeeds(rtc, sentence)
    succeeds(rtc, f"COUPLE {HAND}", f"UNCOUPLE {HAND} ON {HAND}-RACK")
    assert in_rack(rtc, HAND)


def test_a_hand_in_the_coupler_is_stated_nowhere_else(rtc: Client) -> None:
    succeeds(rtc, f"COUPLE {HAND}")

    for sentence in (f"SET {HAND} SEAT {HAND}-RACK", "SET WORLD FACTS INITIAL"):
        assert end(rtc, sentence).kind is OutcomeKind.REFUSED
    assert HAND in end(rtc, f"SHOW {ARM}").message  # wording: the answer names the hand
    assert ARM in end(rtc, f"SHOW {HAND}").message  # wording: the answer names the arm

    succeeds(rtc, f"UNCOUPLE {HAND} ON {HAND}-RACK")


@pytest.mark.parametrize("phase", [Phase.EXECUTING, Phase.ANALYZING])
@pytest.mark.parametrize("whom", ["MCM", "workers"])
def test_a_kill_while_the_coupler_works_leaves_no_false_fact(package: Path, phase: Phase, whom: str) -> None:
    """In real time, so that the coupler works for as long as a kill takes."""
    killed: list[int] = []

    def kill(note: ProgressNote) -> None:
        if note.phase is not phase or "lock" not in note.step or killed:
            return
        rows = processes(rtc.run_dir)
        names = ["MCM"] if whom == "MCM" else [name for name in rows if name.startswith(("binder", "analyzer"))]
        for name in names:
            killed.append(rows[name].pid)
            os.kill(rows[name].pid, signal.SIGKILL)

    with cluster(package, speed="1") as rtc:
        outcome = rtc.run(f"COUPLE {HAND}", kill, LIMIT_S).outcome

        assert killed
        if whom == "workers":
            assert outcome.kind is OutcomeKind.SUCCEEDED
        value, validity = fact(rtc, f"{ARM}.hand")
        assert validity is not Validity.VALID or value == true_hand(rtc)
        seat, trust = fact(rtc, f"{HAND}.seat")
        assert trust is not Validity.VALID or (seat == f"{HAND}-RACK") is (true_hand(rtc) != HAND)
        succeeds(rtc, "HOLD RIGHT-ARM FOR 0.1 SEC")  # its report states what the coupler reads
        assert fact(rtc, f"{ARM}.hand") == (true_hand(rtc), Validity.VALID)
        if true_hand(rtc):
            succeeds(rtc, f"UNCOUPLE {HAND} ON {HAND}-RACK")
        else:
            succeeds(rtc, f"OPEN {ARM}", f"SET {HAND} SEAT {HAND}-RACK", f"COUPLE {HAND}")
