"""The operator: asked for what the program does not achieve, and what the intervention has changed."""

from __future__ import annotations

from rtc.protocol.primitive import TeleopMotion
from workers.mechanisms.mechanism import Mechanism
from workers.mechanisms.operator import assess, bind, elaborate, predict

MECHANISM = Mechanism(
    name="operator",
    instead=elaborate.by_operator,
    actions={"operated": bind.bind_operated},
    effects={"handed": assess.handed, "pointed": assess.pointed},
    reports={TeleopMotion: predict.of_operated},
)
