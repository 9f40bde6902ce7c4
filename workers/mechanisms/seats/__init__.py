"""Seats: an object goes straight into one and out of it, is felt there, and stays there when it is let go of."""

from __future__ import annotations

from workers.mechanisms.mechanism import Mechanism
from workers.mechanisms.seats import assess, elaborate, predict

MECHANISM = Mechanism(
    name="seats",
    figures=elaborate.figures,
    needs={
        "object_seated": elaborate.object_seated,
        "seat_free": elaborate.seat_free,
        elaborate.IN_TARGET: elaborate.object_in_target,
    },
    anchors={"seat": elaborate.seat},
    done=elaborate.taken_out,
    noted=elaborate.taken_along,
    stated={"seat": elaborate.stated_seat},
    follows={"frame": assess.placed},
    contradictions=(assess.contradictions,),
    touch_s=predict.touch_s,
)
