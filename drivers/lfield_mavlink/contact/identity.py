"""Verifies that the vehicle is still the one that was opened; no command is sent before that.

After each reconnection the unique id of the board (AUTOPILOT_VERSION: uid2, uid) is requested and compared. A
board without one (uid 0) is compared by autopilot, type and firmware versions.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from lfield.driver import DeviceError
from lfield_mavlink import log_messages
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.sender_separation import Board

#: Seconds between two attempts to identify the vehicle.
RETRY_INTERVAL = 1.0
#: Commands and messages that only query or synchronise clocks: allowed for any vehicle.
QUERY_COMMANDS = frozenset({dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAV_CMD_SET_MESSAGE_INTERVAL})
_COMMANDS = (dialect.MAVLINK_MSG_ID_COMMAND_LONG, dialect.MAVLINK_MSG_ID_COMMAND_INT)
_HARMLESS = frozenset(
    {
        dialect.MAVLINK_MSG_ID_TIMESYNC,
        dialect.MAVLINK_MSG_ID_PING,
        dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
        dialect.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
        dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
        dialect.MAVLINK_MSG_ID_MISSION_ACK,
    }
)
#: The remedy for another vehicle.
_REMEDY = "nothing is commanded; bring the right vehicle back, or restart the host"


class IdentifiedVehicle(Protocol):
    """The interface of the vehicle to its identification. `is_quiet`: no requests may be sent now."""

    is_quiet: bool

    def note(self, text: str) -> None:
        """Writes a sentence into the log."""

    def error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        """The exception for a reason."""

    def heard(self) -> None:
        """Records that the vehicle has sent a message."""

    def check_identity(self) -> None:
        """Raises DeviceError when the autopilot or type does not match the binding."""


class Identity:
    """Compares the board at opening with the present one.

    `request_version` requests AUTOPILOT_VERSION; `kind` returns the MAV_AUTOPILOT and MAV_TYPE of the last
    heartbeat.
    """

    def __init__(
        self,
        vehicle: IdentifiedVehicle,
        request_version: Callable[[], Awaitable[Any | None]],
        kind: Callable[[], tuple[int, int]],
    ) -> None:
        self._vehicle, self._request_version, self._kind = vehicle, request_version, kind
        self._board: Board | None = None
        self._first_kind = (-1, -1)
        self._is_known = False
        self._reason = ""
        self._was_logged = False
        self._verification_lock = asyncio.Lock()
        self._suspected = asyncio.Event()
        #: The reason why the vehicle is another one, '' if it is not.
        self.other_vehicle = ""

    @property
    def is_certain(self) -> bool:
        """Whether the vehicle is the one that was opened, or was never identified."""
        return not self._reason

    async def learn(self) -> None:
        """Stores the identity of the opened vehicle."""
        version = await self._request_version()
        self._board, self._first_kind = (
            (None if version is None else Board.from_message(version)),
            self._kind(),
        )
        self._is_known, self._reason = True, ""

    def suspect(self, reason: str) -> None:
        """Requires verification: the link was lost, or the vehicle's address has changed."""
        if self._is_known:
            self._reason = self._reason or reason
            self._suspected.set()

    def on_version(self, version: Any | None) -> None:
        """Handles AUTOPILOT_VERSION: requires verification if it is from another vehicle."""
        if self._is_known and version is not None and self._difference(Board.from_message(version)):
            self.suspect("it reported another unique id")

    def may_send(self, message: Any) -> bool:
        """Whether a message may be sent now; queries always may."""
        kind = message.get_msgId()
        if self.is_certain or kind in _HARMLESS:
            return True
        return kind in _COMMANDS and message.command in QUERY_COMMANDS

    async def gate(self, command: int) -> None:
        """Verifies the vehicle before a command. Raises DeviceError."""
        if command not in QUERY_COMMANDS:
            await self.verify()

    async def verify(self) -> None:
        """Compares the present vehicle with the opened one. Raises DeviceError when it differs or does not
        answer.
        """
        async with self._verification_lock:
            if self.is_certain:
                return
            reason, version = self._reason, await self._request_version()
            board = None if version is None else Board.from_message(version)
            self.other_vehicle = self._difference(board)
            if self.other_vehicle:
                raise self._vehicle.error(self.other_vehicle)
            if board is None and self._board is not None:
                raise self._vehicle.error(
                    f"its unique id is not confirmed since {reason}, so nothing is commanded", timeout=True
                )
            # The vehicle has answered: end the silence that was caused by another vehicle.
            self._vehicle.heard()
            self._reason = ""
            self._suspected.clear()
            self._vehicle.note(
                log_messages.SAME_VEHICLE.line(reason=reason, comparison=self._compared(board))
            )

    async def run(self) -> None:
        """Verifies whenever required, until cancelled."""
        while True:
            await self._suspected.wait()
            if self._vehicle.is_quiet:
                await asyncio.sleep(RETRY_INTERVAL)
                continue
            try:
                await self.verify()
            except DeviceError as error:
                if self.other_vehicle and not self._was_logged:
                    self._vehicle.note(log_messages.OTHER_VEHICLE.line(reason=error.reason))
                self._was_logged = bool(self.other_vehicle)
                await asyncio.sleep(RETRY_INTERVAL)
            else:
                self._was_logged = False

    @property
    def is_another_kind(self) -> bool:
        """Whether the heartbeats have another autopilot or type than at opening."""
        return self._is_known and self._kind() != self._first_kind

    def _difference(self, board: Board | None) -> str:
        """The reason why the vehicle is another one; '' if it is not, or if that is unknown."""
        try:
            self._vehicle.check_identity()
        except DeviceError as error:
            return error.reason
        if self.is_another_kind:
            present, opened = self._kind(), self._first_kind
            return (
                f"another vehicle answers: MAV_AUTOPILOT {present[0]}, MAV_TYPE {present[1]} instead of "
                f"{opened[0]}, {opened[1]}; {_REMEDY}"
            )
        if board is None or self._board is None or board == self._board:
            return ""
        if board.uid != self._board.uid:
            present_uid, opened_uid = (
                candidate.uid or "one without a unique id" for candidate in (board, self._board)
            )
            return (
                f"another vehicle answers: its board is {present_uid}, but {opened_uid} was opened; {_REMEDY}"
            )
        if board.uid:
            return ""  # the same board with another firmware
        return f"another vehicle answers: it has another firmware, and no unique id (uid 0); {_REMEDY}"

    def _compared(self, board: Board | None) -> str:
        if board is None:
            return "it does not send AUTOPILOT_VERSION; its autopilot and type are unchanged"
        if not board.uid:
            return "it has no unique id (uid 0); its autopilot, type and firmware are unchanged"
        return f"unique id {board.uid}"
