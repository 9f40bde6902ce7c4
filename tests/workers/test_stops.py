"""After every stop the sentences that its outcome advises move the arm, in physics; see tests.campaigns.stops."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.protocol.outcomes import StopReason
from tests.campaigns import stops

pytestmark = pytest.mark.physics

NOT_OF_AN_ARM_IN_MOTION = {
    *(StopReason.GOAL, StopReason.REFUSED, StopReason.BLOCKED, StopReason.SUBSYSTEM_LOST),
    *(StopReason.FOUND, StopReason.NOT_SEEN),
}
REASONS = [reason for reason in StopReason if reason not in NOT_OF_AN_ARM_IN_MOTION]
LINE = "MOVE {} BY 8 CM ALONG {} MAINTAIN SPEED 5 CM/S"


def stopped(cause: str, reason: str, *, laden: bool) -> stops.Run:
    """A line of the right arm, at the front of the rack or with a module above it."""
    arm = "RIGHT-ARM"
    sentence = LINE.format(arm, "UP" if laden else "X")
    drawn = stops.Drawn("lifted" if laden else "before", arm, sentence, cause, reason, after_s=0.4, seed=4)
    run = stops.stop_and_leave(0, drawn)
    assert run is not None, "nothing has stopped it"
    return run


@pytest.mark.parametrize("leans_laden", [True, False], ids=["leaning, laden", "in the air, empty"])
@pytest.mark.parametrize("reason", REASONS)
def test_after_each_stop_reason_the_advised_sentence_moves_the_arm(reason: StopReason, leans_laden: bool) -> None:
    run = stopped("trip while leaning" if leans_laden else "trip", reason.value, laden=leans_laden)
    assert run.stop == reason
    assert run.laden is leans_laden
    assert run.lead_rad < 0.001
    assert run.moved, run.story


@pytest.mark.parametrize("laden", [True, False])
@pytest.mark.parametrize("cause", ["box", "halt while leaning", "kill while leaning"])
def test_an_arm_leaves_what_has_stopped_it(cause: str, laden: bool) -> None:
    run = stopped(cause, "", laden=laden)
    assert run.laden is laden
    assert run.moved, run.story


def test_an_arm_leaves_a_box_that_is_behind_its_fingers() -> None:
    """Run 17 of seed 92: back along the tool the box held the arm."""
    drawn = stops.Drawn("lifted", "RIGHT-ARM", "STOW RIGHT-ARM", "box", "", after_s=3.447637622295033, seed=1437004542)
    run = stops.stop_and_leave(0, drawn)
    assert run is not None
    assert run.moved, run.story


@pytest.mark.parametrize(("n", "ended"), [(0, 2), (1, 2), (2, 0), (83, 0)])
def test_runs_of_the_campaign(n: int, ended: int) -> None:
    """`ended`: how many sentences the run draws that nothing stops; here they are not given."""
    random = np.random.default_rng([stops.SEED, n])
    drawn = [stops.draw(random) for _ in range(ended + 1)][-1]
    run = stops.stop_and_leave(n, drawn)
    assert run is not None, "nothing has stopped it"
    assert run.moved, run.story
