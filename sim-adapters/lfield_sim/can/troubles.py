"""What can go wrong on the CAN fake, for the bus or for one device (`NAME@NODE=VALUE`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lfield_sim.faults import Fault, share

#: A fault as one device sees it: its name in, its value out.
Flaw = Callable[[str], Any]

FAULTS = (
    share("loss", "frames that a device sends or should hear are lost without a trace"),
    share("corrupt", "frames end in an error frame; the sender tries again until it is bus-off"),
    Fault("delay", 0.0, "seconds that a device's frames come late", 0.0, 10.0),
    Fault("bus_off", False, "off the bus, its motor goes on; for the whole bus: nothing gets through"),
    Fault("unplug", False, "the doors: clients are thrown out, until it is false again"),
    Fault("silence", False, "without power; when it returns it starts anew"),
    Fault("stuck", False, "the motor does not move"),
    Fault("overcurrent", False, "the power stage trips"),
    Fault("overheat", False, "130 degrees Celsius: the power stage trips"),
    Fault("follow_error", False, "the drive reports a following error (an ODrive: spinout)"),
    Fault("lost_heartbeat", False, "the heartbeat is not sent, the rest is"),
    Fault("lost_tpdo", False, "periodic telemetry is not sent (TPDOs, cyclic and status messages)"),
    share("nonsense", "answers to requests are random bytes"),
)
