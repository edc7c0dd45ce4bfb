"""What an autopilot says of itself for good: AUTOPILOT_VERSION.

https://mavlink.io/en/messages/common.html#AUTOPILOT_VERSION: its capabilities tell how it sends integers, and
uid2 (where that is nothing: uid) is the number of its board.
"""

from __future__ import annotations

from typing import Any

from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.parameter_values import Encoding

#: Seconds that the message may come after its acknowledgement, and how often it is asked for.
PATIENCE, ATTEMPTS = 0.2, 3


def encoding_of(autopilot: int, capabilities: int) -> Encoding:
    """By AUTOPILOT_VERSION.capabilities; where that does not tell, PX4 is byte-wise and the rest casts."""
    if capabilities & dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE:
        return Encoding.BYTEWISE
    if capabilities & dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST:
        return Encoding.CAST
    return Encoding.BYTEWISE if autopilot == dialect.MAV_AUTOPILOT_PX4 else Encoding.CAST


class Version:
    """The version of a vehicle, asked of the vehicle when somebody wants to know."""

    def __init__(self, vehicle: Contact) -> None:
        self._vehicle = vehicle
        self._told: Any = None
        vehicle.on(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, self._on_version)

    async def encoding(self) -> Encoding:
        """By what the autopilot says it can do; by which autopilot it is where it does not say."""
        told = await self._ask()
        return encoding_of(self._vehicle.state.autopilot, told.capabilities if told else 0)

    async def serial(self) -> str:
        """`uid 3f21...`, the number of its board in hexadecimal; '' when it tells none."""
        told = await self._ask()
        if told is None:
            return ""
        if long := bytes(told.uid2).rstrip(b"\0"):
            return f"uid {long.hex()}"
        return f"uid {told.uid:x}" if told.uid else ""

    async def renew(self) -> Any | None:
        """The message, asked for anew; None when it does not come."""
        self._told = None
        return await self._ask()

    async def _ask(self) -> Any | None:
        """The message, asked for until it is known; None when it does not come."""
        vehicle, version = self._vehicle, float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        for _ in range(ATTEMPTS if self._told is None else 0):
            answer = await vehicle.exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, version)
            if await vehicle.seen(lambda: self._told is not None, PATIENCE):
                break
            if answer.result != dialect.MAV_RESULT_ACCEPTED:
                break
        return self._told

    def _on_version(self, message: Any) -> None:
        self._told = message
