"""A grip: a hand opens, or closes on an object at a grasp point, holds it, and lets it go."""

from __future__ import annotations

from rtc.protocol.messages import GripStep
from rtc.protocol.primitive import HandMotion
from workers.mechanisms.grip import assess, bind, elaborate, predict
from workers.mechanisms.mechanism import Mechanism

MECHANISM = Mechanism(
    name="grip",
    figures=elaborate.figures,
    needs={
        "hand_empty": elaborate.hand_empty,
        "object_free": elaborate.object_free,
        "object_held": elaborate.object_held,
        "width_known": elaborate.width_known,
    },
    anchors={"grasp_point": elaborate.grasp_point},
    done=elaborate.let_go_of,
    foreseen={"verified": elaborate.verified},
    actions={GripStep: bind.bind_hand},
    procedures={"open_hand": bind.open_hand},
    effects={
        "taken": assess.taken,
        "let_go": assess.let_go,
        "let_drift": assess.let_drift,
        "still_held": assess.still_held,
        "verified": assess.verified,
    },
    interrupted=dict.fromkeys(("taken", "pinched"), assess.interrupted),  # the hand was closing on the object
    follows={"frame": assess.stated_in_hand},
    reports={HandMotion: predict.of_hand},
)
