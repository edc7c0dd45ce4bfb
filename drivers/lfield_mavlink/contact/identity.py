"""Whether the vehicle that is heard is the one that was opened: nothing is commanded before that is known.

After each reconnection the unique id of its board (AUTOPILOT_VERSION: uid2, uid) is asked for anew and
compared. A board that tells none (uid 0) is compared by its autopilot, type and firmware versions.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from lfield.driver import DeviceError
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.strands import Board

#: Seconds between two attempts to learn who is there.
AGAIN = 1.0
#: Commands that only ask, and messages that only ask or keep time: they may go to anybody.
ASKING = frozenset({dialect.MAV_CMD_REQUEST_MESSAGE, dialect.MAV_CMD_SET_MESSAGE_INTERVAL})
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
#: What is to be done about another vehicle.
_REMEDY = "nothing is commanded; bring the right vehicle back, or restart the host"


class Peer(Protocol):
    """What is asked of the vehicle. `quiet` is set while nothing may be asked of it."""

    quiet: bool

    def note(self, text: str) -> None:
        """A sentence for the log."""

    def error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        """The exception for a reason."""

    def heard(self) -> None:
        """It has said something."""

    def check_identity(self) -> None:
        """Raise DeviceError when its autopilot or type is not the binding's."""


class Identity:
    """The board that was met at opening, against the one that is there now.

    `ask` asks for its version, `kind` is the MAV_AUTOPILOT and the MAV_TYPE of its heartbeats.
    """

    def __init__(
        self, vehicle: Peer, ask: Callable[[], Awaitable[Any | None]], kind: Callable[[], tuple[int, int]]
    ) -> None:
        self._vehicle, self._ask, self._kind = vehicle, ask, kind
        self._board: Board | None = None
        self._first_kind = (-1, -1)
        self._known = False
        self._reason = ""
        self._said = False
        self._checking = asyncio.Lock()
        self._suspected = asyncio.Event()
        #: Why another vehicle is there, '' when it is not.
        self.stranger = ""

    @property
    def is_certain(self) -> bool:
        """Whether it is known to be the vehicle that was opened, or nothing was known of that yet."""
        return not self._reason

    async def learn(self) -> None:
        """It is opened: remember who it is."""
        told = await self._ask()
        self._board, self._first_kind = (None if told is None else Board.of(told)), self._kind()
        self._known, self._reason = True, ""

    def suspect(self, reason: str) -> None:
        """It may be another one from now on: the link was lost, or it comes from elsewhere."""
        if self._known:
            self._reason = self._reason or reason
            self._suspected.set()

    def look(self, told: Any | None) -> None:
        """Its AUTOPILOT_VERSION has been asked for: suspect it when that is another's."""
        if self._known and told is not None and self._difference(Board.of(told)):
            self.suspect("it told another unique id")

    def may_send(self, message: Any) -> bool:
        """Whether a message may go out now: what only asks always may."""
        kind = message.get_msgId()
        if self.is_certain or kind in _HARMLESS:
            return True
        return kind in _COMMANDS and message.command in ASKING

    async def gate(self, command: int) -> None:
        """Before a command: make certain who is there. Raises DeviceError."""
        if command not in ASKING:
            await self.verify()

    async def verify(self) -> None:
        """Compare who is there with who was. Raises DeviceError when that is another, or does not answer."""
        async with self._checking:
            if self.is_certain:
                return
            reason, told = self._reason, await self._ask()
            board = None if told is None else Board.of(told)
            self.stranger = self._difference(board)
            if self.stranger:
                raise self._vehicle.error(self.stranger)
            if board is None and self._board is not None:
                raise self._vehicle.error(
                    f"it has not told its unique id since {reason}, so nothing is commanded", timeout=True
                )
            # It has answered: the silence while another vehicle was there is over.
            self._vehicle.heard()
            self._reason = ""
            self._suspected.clear()
            self._vehicle.note(f"the same vehicle as before, after {reason}: {self._compared(board)}")

    async def keep(self) -> None:
        """Verify whenever it is suspected, until cancelled."""
        while True:
            await self._suspected.wait()
            if self._vehicle.quiet:
                await asyncio.sleep(AGAIN)
                continue
            try:
                await self.verify()
            except DeviceError as error:
                if self.stranger and not self._said:
                    self._vehicle.note(error.reason)
                self._said = bool(self.stranger)
                await asyncio.sleep(AGAIN)
            else:
                self._said = False

    @property
    def is_another_kind(self) -> bool:
        """Whether its heartbeats have another autopilot or type than when it was opened."""
        return self._known and self._kind() != self._first_kind

    def _difference(self, board: Board | None) -> str:
        """Why it is another vehicle; '' when that is not so, or nobody knows."""
        try:
            self._vehicle.check_identity()
        except DeviceError as error:
            return error.reason
        if self.is_another_kind:
            now, then = self._kind(), self._first_kind
            return (
                f"another vehicle answers: MAV_AUTOPILOT {now[0]}, MAV_TYPE {now[1]} instead of {then[0]}, "
                f"{then[1]}; {_REMEDY}"
            )
        if board is None or self._board is None or board == self._board:
            return ""
        if board.uid != self._board.uid:
            new, old = (each.uid or "one without a unique id" for each in (board, self._board))
            return f"another vehicle answers: its board is {new}, and {old} was opened; {_REMEDY}"
        if board.uid:
            return ""  # the same board with another firmware
        return (
            "another vehicle answers: it has another firmware, and neither tells a unique id (uid 0); "
            f"{_REMEDY}"
        )

    def _compared(self, board: Board | None) -> str:
        if board is None:
            return "it tells no AUTOPILOT_VERSION; its autopilot and type are what they were"
        if not board.uid:
            return "it tells no unique id (uid 0); its autopilot, type and firmware are what they were"
        return f"unique id {board.uid}"
