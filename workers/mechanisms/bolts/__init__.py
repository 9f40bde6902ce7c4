"""Bolts: a driver in the hand finds the head of a bolt, loosens and tightens it, and its turn is proved.

An object of a cell is a bolt if it has a `thread`, and a driver if it has a `spindle`.
"""

from __future__ import annotations

from rtc.protocol.messages import TurnStep
from rtc.protocol.primitive import SpindleMotion
from workers.mechanisms.bolts import assess, bind, elaborate, predict
from workers.mechanisms.mechanism import Mechanism

MECHANISM = Mechanism(
    name="bolts",
    figures=elaborate.figures,
    arms=elaborate.arms_with_driver,
    needs={"driver_held": elaborate.driver_held},
    anchors={"bolt": elaborate.bolt, "bolt_out": elaborate.bolt_out},
    checks=(elaborate.refuse_beyond_thread, elaborate.refuse_too_much_torque, elaborate.refuse_fastened),
    stated={"state": elaborate.stated_state},
    actions={TurnStep: bind.bind_spindle},
    effects={
        "turned": assess.turned,
        "tightened": assess.tightened,
        "free": assess.free,
        "head_felt": assess.head_felt,
    },
    violated={
        "turned": assess.wrong_turn,
        "tightened": assess.wrong_turn,
        "free": assess.nothing_wrong,
        "head_felt": assess.wrong_head,
    },
    after_failure={
        **dict.fromkeys(("turned", "tightened", "free"), assess.after_failure),
        "head_felt": assess.head_after_failure,
    },
    texts={"progress": assess.in_words},
    left=assess.left,
    spread=assess.on_its_bolt,
    follows={"state": assess.follows_from_state},
    attributes=assess.attributes,
    impossible=assess.impossible,
    touch_s=predict.touch_s,
    reports={SpindleMotion: predict.of_spindle},
)
