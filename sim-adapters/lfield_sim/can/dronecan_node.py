"""A DroneCAN node with batteries, ESCs and servos, and a fixed or a dynamic node id. Time is given.

Transfers and messages are encoded by the package `dronecan`, so they do not depend on another codec of this
project.
"""

from __future__ import annotations

import hashlib
import random
from collections.abc import Iterator, Sequence
from typing import Any

import dronecan
from dronecan.transport import Frame, Transfer, TransferError, TransferManager

from lfield_sim.can.can_bus import CanFrame, FaultLookup
from lfield_sim.can.dronecan_functions import NodeFunction
from lfield_sim.state_log import Facts

#: Seconds between two statuses, and the magic number of a restart.
STATUS_PERIOD, RESTART = 1.0, 0xACCE551B1E
#: Seconds between two requests for a node id, and until a part of the unique id follows.
REQUEST_TIMES, FOLLOWUP_TIMES = (0.6, 1.0), (0.0, 0.4)
#: Bytes of the unique id in the parts of a request.
PARTS = (slice(0, 6), slice(6, 12), slice(12, 16))
_SERVICE = 0x80

uavcan: Any = dronecan.uavcan


class DroneCanNode:
    """The device (see `bus_world.BusDevice`). With `is_dynamic` it requests a node id."""

    def __init__(
        self,
        node: int,
        flaw: FaultLookup,
        functions: Sequence[NodeFunction],
        unique_id: bytes,
        *,
        is_dynamic: bool,
    ) -> None:
        self._configured_node, self._flaw, self._functions = node, flaw, functions
        self._node = 0
        self._uptime = self._until_status = self._until_request = 0.0
        self._outgoing: list[CanFrame] = []
        self._unique_id = unique_id or hashlib.sha256(b"lfield %d" % node).digest()[:16]
        self._is_dynamic = is_dynamic
        self._random = random.Random(self._unique_id)
        self._reset()

    @property
    def id(self) -> str:
        """The node id of its specification."""
        return str(self._configured_node)

    def power_up(self) -> list[CanFrame]:
        """Restarts."""
        self._reset()
        return []

    def power_down(self) -> None:
        """Stops the functions of the node."""
        for function in self._functions:
            function.power_down()

    def facts(self) -> Facts:
        """The log entries of the node and its functions."""
        facts: Facts = {"node": self._node}
        for function in self._functions:
            facts = {**facts, **function.facts()}
        return facts

    def on_frame(self, frame: CanFrame) -> list[CanFrame]:
        """Receives a frame; returns the answers."""
        if frame.error or frame.remote or frame.fd or not frame.extended or not frame.data:
            return []
        if not self._is_for_us(frame.identifier):
            return []
        frames = self._transfers.receive_frame(Frame(frame.identifier, frame.data))
        if not frames:
            return []
        transfer = Transfer()
        try:
            transfer.from_frames(frames)
        except (TransferError, ValueError, IndexError):
            return []
        return list(self._answers(transfer))

    def step(self, dt: float) -> list[CanFrame]:
        """Advances time; returns the frames that the node sends."""
        self._uptime += dt
        payloads = [payload for each in self._functions for payload in each.step(dt, self._flaw)]
        for payload in payloads:
            if self._node and not self._flaw("lost_tpdo"):
                self._outgoing += self._broadcast(payload)
        self._until_status -= dt
        if self._node and self._until_status <= 0.0:
            self._until_status += STATUS_PERIOD
            if not self._flaw("lost_heartbeat"):
                self._outgoing += self._broadcast(self._status())
        if not self._node:
            self._until_request -= dt
            if self._until_request <= 0.0:
                self._outgoing.append(self._request())
        sent = self._outgoing
        self._outgoing = []
        return sent

    def _reset(self) -> None:
        self._node = 0 if self._is_dynamic else self._configured_node
        self._transfers = TransferManager()
        self._numbers: dict[object, int] = {}
        self._outgoing = []
        self._uptime = self._until_status = 0.0
        self._stage, self._until_request = 0, self._random.uniform(*REQUEST_TIMES)
        for function in self._functions:
            function.power_up()

    def _is_for_us(self, identifier: int) -> bool:
        """Whether a frame is a message that the node uses, or a service of this node."""
        if identifier & _SERVICE:
            return bool(self._node) and identifier >> 8 & 0x7F == self._node
        if not identifier & 0x7F:
            return not self._node
        message = identifier >> 8 & 0xFFFF
        return message == 1 or any(message in function.commands for function in self._functions)

    # -- received frames ----------------------------------------------------------------------------------

    def _answers(self, transfer: Any) -> Iterator[CanFrame]:
        payload = transfer.payload
        name = dronecan.get_dronecan_data_type(payload).full_name
        if transfer.service_not_message:
            if transfer.request_not_response:
                yield from self._response(name, transfer)
        elif name == "uavcan.protocol.dynamic_node_id.Allocation":
            if not self._node:
                self._on_allocation(transfer)
        else:
            for function in self._functions:
                function.on_command(transfer.data_type_id, payload)

    def _response(self, name: str, request: Any) -> Iterator[CanFrame]:
        if name == "uavcan.protocol.GetNodeInfo":
            answer = uavcan.protocol.GetNodeInfo.Response()
            answer.status = self._status()
            answer.hardware_version.unique_id = list(self._unique_id)
            answer.software_version.major = 1
            answer.name = f"lfield.fake.{self._functions[0].name}"
        elif name == "uavcan.protocol.RestartNode":
            answer = uavcan.protocol.RestartNode.Response()
            answer.ok = request.payload.magic_number == RESTART
            if answer.ok:
                self._reset()
        else:
            return
        yield from self._frames(
            answer,
            transfer_id=request.transfer_id,
            dest_node_id=request.source_node_id,
            service_not_message=True,
            request_not_response=False,
        )

    def _on_allocation(self, transfer: Any) -> None:
        """Handles an allocation: waits for another node; after an answer, sends the next part or has its
        id.
        """
        self._until_request = self._random.uniform(*REQUEST_TIMES)
        allocated = bytes(transfer.payload.unique_id)
        if transfer.source_node_id == 0 or not self._unique_id.startswith(allocated):
            self._stage = 0
        elif len(allocated) == len(self._unique_id) and transfer.payload.node_id:
            self._node, self._stage = int(transfer.payload.node_id), 0
        elif len(allocated) in (6, 12):
            self._stage = len(allocated) // 6
            self._until_request = self._random.uniform(*FOLLOWUP_TIMES)

    # -- sent frames --------------------------------------------------------------------------------------

    def _request(self) -> CanFrame:
        """The next part of the request for a node id, which is anonymous."""
        part = list(self._unique_id[PARTS[self._stage]])
        payload = uavcan.protocol.dynamic_node_id.Allocation()
        payload.first_part_of_unique_id = self._stage == 0
        payload.unique_id = part
        self._stage, self._until_request = 0, self._random.uniform(*REQUEST_TIMES)
        (frame,) = self._frames(
            payload, transfer_id=self._number("request"), discriminator=self._random.randrange(1 << 14)
        )
        return frame

    def _status(self) -> Any:
        status = uavcan.protocol.NodeStatus()
        status.uptime_sec = int(self._uptime)
        status.health = 2 if self._flaw("overheat") or self._flaw("overcurrent") else 0
        return status

    def _broadcast(self, payload: Any) -> list[CanFrame]:
        number = self._number(dronecan.get_dronecan_data_type(payload).full_name)
        return list(self._frames(payload, transfer_id=number))

    def _frames(self, payload: Any, **fields: Any) -> Iterator[CanFrame]:
        transfer = Transfer(payload=payload, source_node_id=self._node, transfer_priority=16, **fields)
        for frame in transfer.to_frames():
            yield CanFrame(frame.message_id, bytes(frame.bytes), extended=True)

    def _number(self, key: object) -> int:
        number = self._numbers[key] = (self._numbers.get(key, -1) + 1) % 32
        return number
