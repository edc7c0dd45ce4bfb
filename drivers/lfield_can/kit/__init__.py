"""Conformance kit of CAN devices: axes of any protocol, devices by DBC file, and DroneCAN nodes.

An axis or a servo moves less than 0.5 rad from its position; an axis is disabled at the end. Only its own
safe state is sent to a device by DBC file.
"""

from __future__ import annotations

from lfield.driver.kit import Kit
from lfield_can.kit.axis_checks import AXIS
from lfield_can.kit.node_checks import NODES
from lfield_can.kit.signal_checks import SIGNALS

KIT = Kit([*AXIS.checks, *SIGNALS.checks, *NODES.checks])
