"""What can go wrong on a bus of servos."""

from __future__ import annotations

from lfield_sim.faults import Fault, share

#: The angle of an obstacle that is not there.
NOTHING = 1000.0

FAULTS = (
    Fault("dead", False, "does not answer, and does nothing it is told"),
    share("lose", "share of its replies that get lost"),
    share("corrupt", "share of its replies with a wrong byte"),
    Fault("delay", 0.0, "seconds that its replies come late", 0.0, 60.0),
    Fault("other", False, "answers with the id of another"),
    Fault("nonsense", False, "answers with random bytes"),
    Fault("overload", False, "more load than it can hold: it stalls and shuts down"),
    Fault("stuck", False, "a broken gear: the shaft stays while the motor turns freely"),
    Fault("obstacle", NOTHING, "rad from its middle where something solid is; 1000: none", -10.0, NOTHING),
    Fault("hot", False, "gets hotter, 10 degrees a second"),
    Fault("sag", 0.0, "volts that its supply lacks", 0.0, 100.0),
    Fault("encoder", False, "its encoder fails"),
    share("noise", "share of replies with random bytes before them"),
    Fault("unplug", False, "the adapter is pulled out; false plugs it in again"),
)
#: Degrees per second of the fault `hot`.
HEATER = 10.0
