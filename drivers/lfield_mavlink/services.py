"""What the services of a vehicle share: who they talk to, its plans, its parameters, its files."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from lfield_mavlink.dialect import dialect
from lfield_mavlink.file_transfer import FileTransfer
from lfield_mavlink.parameter_values import Encoding, encoding_of
from lfield_mavlink.parameters import Parameters
from lfield_mavlink.peer import Peer
from lfield_mavlink.plan_transfer import PlanTransfer
from lfield_mavlink.streams import Streams

#: Seconds to wait for AUTOPILOT_VERSION, and how often it is asked for.
PATIENCE, QUESTIONS = 0.5, 3


class Services(Streams):
    """Protocols beside flight: none of them moves the vehicle."""

    def _set_up(self) -> None:
        super()._set_up()
        self._peer = Peer(self.system, self._send, self._on, self.error, self._check_link)
        self._parameters = Parameters(self._peer, self._parameter_encoding)
        self._files = FileTransfer(self._peer)
        self._capabilities: int | None = None
        self._on(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, self._on_version)

    @cached_property
    def _plans(self) -> PlanTransfer:
        """Made at its first use: only then is it known which autopilot this is."""
        return PlanTransfer(self._peer, home_first=not self.profile.px4)

    async def _parameter_encoding(self) -> Encoding:
        """By what the autopilot says it can do; the autopilot itself where it does not answer."""
        version = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        for _ in range(QUESTIONS):
            if self._capabilities is not None:
                break
            await self._exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, version)
            await self._seen(lambda: self._capabilities is not None, PATIENCE)
        return encoding_of(self.state.autopilot, self._capabilities or 0)

    def _on_version(self, message: Any) -> None:
        self._capabilities = message.capabilities
