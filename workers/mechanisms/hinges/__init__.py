"""Hinges: a held door turns about its hinge, as far as a sentence says; it is known but for its angle."""

from __future__ import annotations

from workers.mechanisms.hinges import advice, assess, elaborate, predict
from workers.mechanisms.mechanism import Mechanism

MECHANISM = Mechanism(
    name="hinges",
    figures=elaborate.figures,
    needs={"object_hinged": elaborate.object_hinged},
    anchors={"hinge": elaborate.hinge},
    checks=(elaborate.refuse_other_motion, elaborate.refuse_turn_of_hand, elaborate.refuse_beyond_stops),
    stated={"angle": elaborate.stated_angle},
    strains=elaborate.strains,
    left=assess.left,
    has_reached=assess.has_turned,
    spread_in_place=assess.rolled,
    derived=assess.angles,
    follows={"frame": assess.refuse_off_hinge},
    attributes=assess.attributes,
    impossible=assess.impossible,
    reached_s=predict.turned_s,
    way=advice.way,
    about=advice.about,
)
