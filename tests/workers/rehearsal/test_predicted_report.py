"""Predicted end reports against those of the MCM's executor with exact arms."""

from __future__ import annotations

import pytest

from rtc.protocol.primitive import HandMotion, JointTrajectory
from tests.workers.conftest import Bench, Kinematic
from workers.planning.world_query import WorldQuery
from workers.rehearsal.predicted_report import end_report

SENTENCES = (
    "GRASP RIGHT-END-EFF MACS-NEW HANDLE-A",
    "LIFT MACS-NEW BY 5 CM WITH RIGHT-ARM",
    "STOW LEFT-ARM",
)
SETTLES_S = 0.5  # a touch is felt once the arm presses on its object


@pytest.mark.physics
def test_predictions_are_what_exact_arms_report():
    """Durations within 5 %, apart from the settling of hands and touches; the same reasons and ends."""
    arms = Kinematic()
    bench, pairs = Bench(arms), []
    perform = arms.perform

    def beside(made, bound):
        predicted = end_report(WorldQuery(bench.model, bench.world, bench.now_s), bound, 0.0)
        measured = perform(made, bound)
        pairs.append((made, predicted, measured))
        return measured

    arms.perform = beside  # type: ignore[method-assign]
    for sentence in SENTENCES:
        assert bench.do(sentence).succeeded, sentence
    of_arms = [pair for pair in pairs if isinstance(pair[0].trajectory, JointTrajectory | HandMotion)]
    assert len(of_arms) > 8
    for made, predicted, measured in of_arms:
        slack_s = 0.02 if isinstance(made.trajectory, HandMotion) else 0.005
        touches = SETTLES_S if measured.reason == "contact" else 0.0
        assert predicted.reason == measured.reason
        assert predicted.duration_s == pytest.approx(measured.duration_s, rel=0.05, abs=slack_s + touches)
        assert predicted.tcp_pose[:3] == pytest.approx(measured.tcp_pose[:3], abs=0.005)
        assert predicted.hand_width_m == pytest.approx(measured.hand_width_m, abs=0.001)
