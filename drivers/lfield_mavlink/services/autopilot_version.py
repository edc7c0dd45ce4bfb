"""AUTOPILOT_VERSION of a vehicle.

https://mavlink.io/en/messages/common.html#AUTOPILOT_VERSION: its capabilities define how integers are sent,
and uid2 (else uid) is the id of its board.
"""

from __future__ import annotations

from typing import Any

from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.parameter_values import Encoding

#: Seconds for the message after its acknowledgement, and attempts.
PATIENCE, ATTEMPTS = 0.2, 3


def encoding_of(autopilot: int, capabilities: int) -> Encoding:
    """The encoding by AUTOPILOT_VERSION.capabilities; without them PX4 is byte-wise and others cast."""
    if capabilities & dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE:
        return Encoding.BYTEWISE
    if capabilities & dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST:
        return Encoding.CAST
    return Encoding.BYTEWISE if autopilot == dialect.MAV_AUTOPILOT_PX4 else Encoding.CAST


class AutopilotVersion:
    """The version of a vehicle, requested when it is needed."""

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle = vehicle
        self._message: Any = None
        vehicle.on(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, self._on_version)

    async def encoding(self) -> Encoding:
        """The encoding from the autopilot's capabilities, else by its type."""
        version = await self._request()
        return encoding_of(self._vehicle.state.autopilot, version.capabilities if version else 0)

    async def serial(self) -> str:
        """`uid 3f21...`, the id of its board in hexadecimal; '' without one."""
        version = await self._request()
        if version is None:
            return ""
        if uid2 := bytes(version.uid2).rstrip(b"\0"):
            return f"uid {uid2.hex()}"
        return f"uid {version.uid:x}" if version.uid else ""

    async def renew(self) -> Any | None:
        """Requests the message again; None when it does not arrive."""
        self._message = None
        return await self._request()

    async def _request(self) -> Any | None:
        """The message, requested unless known; None when it does not arrive."""
        vehicle, version = self._vehicle, float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        for _ in range(ATTEMPTS if self._message is None else 0):
            answer = await vehicle.exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, version)
            if await vehicle.wait_for(lambda: self._message is not None, PATIENCE):
                break
            if answer.result != dialect.MAV_RESULT_ACCEPTED:
                break
        return self._message

    def _on_version(self, message: Any) -> None:
        self._message = message
