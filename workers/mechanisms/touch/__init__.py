"""Touch: a finger that meets an object tells where it is."""

from __future__ import annotations

from workers.mechanisms.mechanism import Mechanism
from workers.mechanisms.touch import assess, predict
from workers.tasks.flat_grip import between_fingers

MECHANISM = Mechanism(
    name="touch",
    effects={
        "felt": assess.found_by(assess.touched),
        "tilted": assess.found_by(assess.tilted),
        "pinched": assess.found_by(between_fingers),
        "passed": assess.found_by(assess.beyond),
        "landed": assess.found_by(assess.beside),
    },
    touch_s=predict.touch_s,
)
