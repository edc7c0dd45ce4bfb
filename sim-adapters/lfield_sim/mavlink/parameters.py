"""Parameters on the wire: read, set, listed."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from lfield_sim.autopilot import Autopilot
from lfield_sim.mavlink.place import Place
from lfield_sim.mavlink.service import Service


class Parameters(Service):
    """The parameter protocol. An unknown name gets no answer, from ArduPilot and from PX4."""

    def __init__(self, autopilot: Autopilot, place: Place) -> None:
        super().__init__(autopilot, place)
        self.handles = {
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_request_read,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_request_list,
            dialect.MAVLINK_MSG_ID_PARAM_SET: self._on_set,
        }

    def _on_request_read(self, message: Any) -> list[Any]:
        names = sorted(self.autopilot.parameters)
        if message.param_index >= 0:
            name = names[message.param_index] if message.param_index < len(names) else ""
        else:
            name = message.param_id
        return [self._value(name)] if name in self.autopilot.parameters else []

    def _on_request_list(self, _: Any) -> list[Any]:
        return [self._value(name) for name in sorted(self.autopilot.parameters)]

    def _on_set(self, message: Any) -> list[Any]:
        name = message.param_id
        if name not in self.autopilot.parameters or not math.isfinite(message.param_value):
            return []
        self.autopilot.parameters[name] = message.param_value
        self.autopilot.apply_parameters()
        return [self._value(name)]

    def _value(self, name: str) -> Any:
        names = sorted(self.autopilot.parameters)
        value = self.autopilot.parameters[name]
        kind = dialect.MAV_PARAM_TYPE_REAL32
        return dialect.MAVLink_param_value_message(name.encode(), value, kind, len(names), names.index(name))
