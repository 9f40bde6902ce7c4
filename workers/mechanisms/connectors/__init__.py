"""Connectors: a plug in the hand goes into its socket until the latch clicks, is proved by a tug, and is pulled out.

An object of a cell is a plug if it names its connector (`plug`), and a seat is a socket if it has a `mating`.
"""

from __future__ import annotations

from workers.mechanisms.connectors import assess, elaborate, predict
from workers.mechanisms.mechanism import Mechanism

MECHANISM = Mechanism(
    name="connectors",
    figures=elaborate.figures,
    needs={"plug_fits": elaborate.plug_fits, "in_socket": elaborate.in_socket},
    checks=(elaborate.refuse_latched, elaborate.refuse_other_way_in, elaborate.refuse_too_weak),
    done=elaborate.mated_already,
    stated={"mating": elaborate.stated_mating},
    effects={"clicked": assess.clicked, "latched": assess.latched, "demated": assess.demated},
    violated={"clicked": assess.not_clicked, "demated": assess.not_out},
    interrupted=dict.fromkeys(("clicked", "latched", "demated"), assess.interrupted),
    texts={"mated": assess.in_words},
    follows={"mating": assess.stated, "frame": assess.placed},
    impossible=assess.impossible,
    feels={"clicked": predict.through_the_latch},
)
