"""Sight: cameras look for bodies that have tags, and locate, verify or follow them."""

from __future__ import annotations

from rtc.programs.extension_names import CAMERA
from rtc.protocol.messages import LookStep
from rtc.protocol.outcomes import StopReason
from rtc.protocol.primitive import Look
from workers.mechanisms.mechanism import Mechanism
from workers.mechanisms.sight import advice, assess, bind, elaborate, predict

MECHANISM = Mechanism(
    name="sight",
    candidates={CAMERA: elaborate.candidates},
    performers={CAMERA: elaborate.cameras},
    actions={LookStep: bind.bind_look},
    effects={"sighted": assess.sighted, "unseen": assess.unseen},
    violated={"sighted": assess.wrong_sighting},
    after_failure={"sighted": assess.after_failure},
    found={"sighted": assess.found},
    texts={"message": assess.in_words, "speed": assess.speed_in_words},
    cures={StopReason.NOT_SEEN: advice.unseen},
    advice={"out_first": advice.out_first, "found_at": advice.found_at},
    reports={Look: predict.of_look},
)
