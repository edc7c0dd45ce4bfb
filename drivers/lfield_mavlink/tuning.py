"""The parameters of a vehicle, for the parts that need them."""

from __future__ import annotations

from typing import Any

from lfield_mavlink.contact import Contact
from lfield_mavlink.dialect import dialect
from lfield_mavlink.parameter_values import Encoding, encoding_of
from lfield_mavlink.parameters import Parameters
from lfield_mavlink.peer import Peer

#: Seconds for AUTOPILOT_VERSION to come after the request for it was accepted, and how often it is asked for.
PATIENCE, QUESTIONS = 0.5, 3


class Tuning(Contact):
    """`_parameters`, which reads and writes them; `_peer`, the vehicle as services see it."""

    def _set_up(self) -> None:
        super()._set_up()
        self._peer = Peer(self.system, self._send, self._on, self.error, self._check_link)
        self._parameters = Parameters(self._peer, self._parameter_encoding)
        self._capabilities: int | None = None
        self._on(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION, self._on_version)

    async def _parameter_encoding(self) -> Encoding:
        """By what the autopilot says it can do; by which autopilot it is where it does not say."""
        version = float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        for _ in range(QUESTIONS):
            answer = await self._exchange.command(dialect.MAV_CMD_REQUEST_MESSAGE, version)
            if await self._seen(lambda: self._capabilities is not None, PATIENCE):
                break
            if answer.result != dialect.MAV_RESULT_ACCEPTED:
                break
        return encoding_of(self.state.autopilot, self._capabilities or 0)

    def _on_version(self, message: Any) -> None:
        self._capabilities = message.capabilities
