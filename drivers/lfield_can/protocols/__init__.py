"""Protocols of axes: one class each behind one small interface. A new one is a new file and a line here."""

from __future__ import annotations

from collections.abc import Mapping

from lfield_can.protocols.axis_protocol import AxisProtocol, AxisState, Wiring
from lfield_can.protocols.cia402 import Cia402
from lfield_can.protocols.odrive import Odrive

__all__ = ["PROTOCOLS", "AxisProtocol", "AxisState", "Wiring"]

#: By the name that bindings give; the choices of the option `protocol` in axis.yaml.
PROTOCOLS: Mapping[str, type[AxisProtocol]] = {"cia402": Cia402, "odrive": Odrive}
