"""All messages between processes: read this package first. Other packages import the messages from here.

The modules in the order to read them, that of a command's path: `client`, `progress`, `status`, `worker`, `payloads`
(what jobs carry), `step`, `subsystem`, `world`, `saved`, `supervisor`, `simulator`, `recorded`. `shared` has what
several of them use. A module ends with the unions of its messages, one per socket and direction.

Every message is a frozen struct. On the wire it is a MessagePack map whose key "type" holds the name of the class; only
`rtc.protocol.wire` encodes. Unknown keys are ignored and missing keys take their defaults, so that different versions
can communicate (R42). Orders to move and inputs of workers are strict (`rtc.protocol.strict`).

Times that end in `_at_s` are CLOCK_MONOTONIC seconds of the machine they were taken on, comparable between the
processes of one host. `_s` is a duration. Poses are [x y z qx qy qz qw] (m, unit quaternion), in world axes unless a
`frame` states another. A wrench is [Fx Fy Fz Tx Ty Tz] (N, N.m) that the environment exerts on the hand, in tool axes
at the tcp. Names are upper case.
"""

from rtc.protocol.messages.client import *
from rtc.protocol.messages.payloads import *
from rtc.protocol.messages.progress import *
from rtc.protocol.messages.recorded import *
from rtc.protocol.messages.saved import *
from rtc.protocol.messages.shared import *
from rtc.protocol.messages.simulator import *
from rtc.protocol.messages.status import *
from rtc.protocol.messages.step import *
from rtc.protocol.messages.subsystem import *
from rtc.protocol.messages.supervisor import *
from rtc.protocol.messages.worker import *
from rtc.protocol.messages.world import *
