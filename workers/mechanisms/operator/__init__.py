"""The operator: asked for what the program does not achieve, and what the intervention has changed."""

from __future__ import annotations

from rtc.protocol.messages import OperateStep, SharedStep
from rtc.protocol.primitive import TeleopMotion
from workers.mechanisms.mechanism import Mechanism
from workers.mechanisms.operator import assess, bind, elaborate, predict

MECHANISM = Mechanism(
    name="operator",
    instead=elaborate.by_operator,
    actions={OperateStep: bind.bind_operated, SharedStep: bind.bind_shared},
    effects={"handed": assess.handed, "pointed": assess.pointed},
    reports={TeleopMotion: predict.of_operated},
)
