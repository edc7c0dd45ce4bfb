"""The conformance kit of CAN devices: axes of any protocol, and devices by DBC file.

An axis turns by less than 0.5 rad from where it stands; at the end it is disabled. A device by
DBC file is sent nothing but its own safe state.
"""

from __future__ import annotations

from lfield.driver.kit import Kit
from lfield_can.kit.axis import AXIS
from lfield_can.kit.signals import SIGNALS

KIT = Kit([*AXIS.checks, *SIGNALS.checks])
