"""The primitive T = (P, M, F, R): the only order to a subsystem (paper, section 4; R60-R67).

    P  trajectory      what to do: positions over time, a command of the hand, or a look of a camera
    M  control_law     how the servo follows it
    F  stop_functions  when to stop, and what to do then; complete, in fixed priority
    R  reporting       what to report beyond the standard end report

A primitive contains frames and numbers only, neither objects, verbs nor sentences (R15). All values are SI.
Joint order is that of the arm's URDF. `tcp` is the tool centre point; tool z points out of the palm, the
fingers close along tool y. A primitive checks itself when it is constructed, so the MCM never gets an incomplete one.

One module for each of the four, `limits` of their values, the `space` of a motion, and `primitive`. Other packages
import them from here.
"""

from rtc.protocol.primitive.control_law import *
from rtc.protocol.primitive.limits import *
from rtc.protocol.primitive.primitive import *
from rtc.protocol.primitive.reporting import *
from rtc.protocol.primitive.space import *
from rtc.protocol.primitive.stop_functions import *
from rtc.protocol.primitive.trajectory import *
