"""The spring of a compliant step: where its centre is, and how stiff it is about each axis."""

from __future__ import annotations

import numpy as np
import pytest

from rtc.protocol.messages import BoundStep, Script
from rtc.protocol.outcomes import Refusal

HOLD = """
script: hold
case: 1
uses: [hand, duration_s]
steps:
  - {do: hold, stop: hold, label: wait, args: {duration_s: duration_s, FIGURES}}
"""


@pytest.mark.parametrize(("seat", "spins"), [("BAY-2", 2), ("RACK-1", 0)])
def test_an_inserted_module_complies_about_its_middle_and_most_about_the_way_in(bench, seat: str, spins: int) -> None:
    """The bay is open along the tool, the rack upwards, which is TOOL-X."""
    assert bench.do("GRASP RIGHT-END-EFF MACS-NEW HANDLE-A").succeeded
    assert bench.do("LIFT MACS-NEW BY 25 CM WITH RIGHT-ARM").succeeded
    if seat == "BAY-2":
        assert bench.do("MOVE RIGHT-ARM TO BAY-2-FRONT").succeeded
    script = bench.elaborate(f"INSERT MACS-NEW INTO {seat} WITH RIGHT-ARM")
    assert isinstance(script, Script), script
    bound = bench.bind(script, next(step for step in script.steps if step.to == "NEARLY"))
    assert isinstance(bound, BoundStep), bound
    law = bound.primitive.control_law

    assert law.compliance.centre == pytest.approx(law.load.com_m)
    assert np.linalg.norm(law.compliance.centre) > 0.1
    turning = law.compliance.stiffness[3:]
    assert int(np.argmin(turning)) == spins
    assert np.delete(turning, spins) == pytest.approx([3.0 * turning[spins]] * 2, rel=0.01)


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ("centre_share: 1", "compliant"),
        ("spin_m: 0.1", "compliant"),
        ("centre_share: 1, stiffness_n_m: 400", "object in the hand"),
        ("centre_share: 1.5, stiffness_n_m: 400", "share"),
        ("centre_share: -0.1, stiffness_n_m: 400", "share"),
        ("spin_m: 0.1, stiffness_n_m: 400, press_n: 5", "press_n"),
    ],
)
def test_a_figure_of_the_spring_without_an_effect_is_refused(bench, figures: str, words: str) -> None:
    bench.load("elaborator", HOLD.replace("FIGURES", figures))
    run = bench.do("HOLD RIGHT-ARM FOR 1 SEC")
    assert isinstance(run.refusal, Refusal)
    assert words in run.refusal.message  # wording: for the author of the script
    assert not run.primitives
