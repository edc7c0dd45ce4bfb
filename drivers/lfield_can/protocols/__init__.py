"""Protocols of axes: one class each behind one interface. A new one is a new file and a line here."""

from __future__ import annotations

from collections.abc import Mapping

from lfield_can.protocols.axis_protocol import AxisProtocol, AxisState, ProtocolContext
from lfield_can.protocols.cia402 import Cia402
from lfield_can.protocols.odrive import Odrive

__all__ = ["PROTOCOLS", "AxisProtocol", "AxisState", "ProtocolContext"]

#: By the name in bindings; the choices of the option `protocol` in axis.yaml.
PROTOCOLS: Mapping[str, type[AxisProtocol]] = {"cia402": Cia402, "odrive": Odrive}
