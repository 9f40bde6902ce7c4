"""Two arms: both move one object that they hold, or one hands it to the other."""

from __future__ import annotations

from workers.mechanisms.mechanism import Mechanism
from workers.mechanisms.two_arms import elaborate

MECHANISM = Mechanism(
    name="two_arms",
    figures=elaborate.figures,
    arms=elaborate.arms,
    partners=elaborate.partners,
    points=elaborate.free_points,
    needs={"other_handle": elaborate.other_handle, "partner_empty": elaborate.partner_empty},
    anchors={"meeting": elaborate.meeting},
    checks=(elaborate.refuse_moving_alone,),
    foreseen={"taken": elaborate.taken, "let_go": elaborate.let_go},
)
