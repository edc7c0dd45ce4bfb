"""A computer as a node of a DroneCAN bus: its status, transfers to and from devices, dynamic node ids."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from lfield.driver import Clock, DeviceError
from lfield_can import log_messages
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.frames import Frame
from lfield_can.drone_can.allocation import Allocator
from lfield_can.drone_can.messages import (
    ALLOCATION,
    GET_NODE_INFO,
    NODE_STATUS,
    DataType,
    NodeInfo,
    encode,
    node_info,
    signatures,
)
from lfield_can.drone_can.transfers import Assembler, Transfer, TransferKind, frames_of
from lfield_can.timing import PeriodicTask

#: Seconds between two messages of our status (MAX_BROADCASTING_PERIOD_MS).
STATUS_PERIOD = 1.0


class NetworkNode(Protocol):
    """The interface of a device on the bus."""

    @property
    def node(self) -> int:
        """The node id of the device."""

    @property
    def master(self) -> int:
        """The node id that the binding of the device gives to this computer."""

    @property
    def unique_id(self) -> bytes:
        """The unique id in the binding of the device; b'' for a node with a fixed id."""

    def on_transfer(self, data_type: int, number: int, data: bytes) -> None:
        """Handles a message of the node, with the number of its transfer."""

    def on_node_info(self, info: NodeInfo) -> None:
        """Handles the answer of the node about its identity."""

    def error(self, reason: str) -> DeviceError:
        """An exception about the device."""


class DroneCanNetwork:
    """The DroneCAN side of one bus. Unused without devices."""

    def __init__(self, bus: Bus, clock: Clock, note: Callable[[str], None]) -> None:
        self._bus, self._clock, self._note = bus, clock, note
        self._members: dict[int, list[NetworkNode]] = {}
        self._assembler = Assembler(signatures())
        self._allocator: Allocator | None = None
        self._numbers: dict[TransferKind, int] = {}
        self._status = PeriodicTask(clock)
        self._start = clock.monotonic()
        self._is_quiet = False
        self.master = 0

    @property
    def problem_text(self) -> str:
        """The reason why no node may be received, as far as the bus knows."""
        return self._bus.problem_text

    @property
    def malformed(self) -> int:
        """Frames and transfers that were not valid."""
        return self._assembler.malformed

    def join(self, member: NetworkNode) -> None:
        """Adds a device, before the bus is opened. Raises DeviceError for conflicting ids."""
        others = [other for members in self._members.values() for other in members]
        if self.master not in (0, member.master):
            ids = f"{self.master} and {member.master}"
            raise member.error(f"bindings give this computer two node ids ('master'): {ids}")
        self.master = member.master
        for other in others:
            has_same_node, has_same_id = other.node == member.node, other.unique_id == member.unique_id
            if has_same_node != has_same_id and (has_same_node or member.unique_id):
                raise member.error(
                    f"node {member.node} and node {other.node} have one node id or one unique id; give each "
                    "node its own"
                )
        if member.node == self.master:
            raise member.error(f"node {member.node} is this computer ('master'); give it another id")
        self._members.setdefault(member.node, []).append(member)

    def start(self) -> None:
        """Starts the network when the bus is open."""
        if not self._members:
            return
        now = self._start = self._clock.monotonic()
        members = [member for members in self._members.values() for member in members]
        bound = {member.unique_id: member.node for member in members if member.unique_id}
        if bound:
            self._allocator = Allocator(bound, frozenset({self.master, *self._members}), now)
        self._status.start(STATUS_PERIOD, self._send_status)
        self._send_status()

    def close(self) -> None:
        """Stops the network when the driver ends."""
        self._status.stop()

    def set_quiet(self, is_quiet: bool) -> None:
        """Stops what this computer sends by itself (False: starts it again)."""
        self._is_quiet = is_quiet
        if not self._members:
            return
        if is_quiet:
            self._status.stop()
        else:
            self._status.resume()

    def broadcast(self, data_type: DataType, data: bytes, priority: int = 16) -> None:
        """Sends a message to all nodes; it may be dropped."""
        self._post(
            Transfer(data_type.kind, self.master, self._number(data_type.kind), data), data_type, priority
        )

    def ask_node_info(self, node: int) -> None:
        """Requests the identity of a node."""
        kind = TransferKind(GET_NODE_INFO.id, node, is_request=True)
        self._post(Transfer(kind, self.master, self._number(kind), b""), GET_NODE_INFO, 30)

    def on_frame(self, frame: Frame) -> None:
        """Handles a frame with a 29-bit id that no other device receives."""
        if not self._members:
            return
        transfer = self._assembler.on_frame(frame, self._clock.monotonic())
        if transfer is None:
            return
        kind = transfer.kind
        if transfer.source == 0:
            self._on_anonymous(transfer)
        elif kind.is_service:
            self._on_service(transfer)
        elif kind.type_id == ALLOCATION.id and self._allocator is not None:
            # Two allocators would give one id to two nodes.
            self._allocator = None
            self._note(log_messages.OTHER_ALLOCATOR.line(node=transfer.source))
        else:
            if self._allocator is not None:
                self._allocator.on_node(transfer.source)
            for member in self._members.get(transfer.source, ()):
                member.on_transfer(kind.type_id, transfer.number, transfer.data)

    def _on_service(self, transfer: Transfer) -> None:
        kind = transfer.kind
        if kind.destination != self.master or kind.type_id != GET_NODE_INFO.id:
            return
        if kind.is_request:
            answer = TransferKind(GET_NODE_INFO.id, transfer.source)
            data = self._status_data() + bytes(33) + b"\0" + b"lfield"
            self._post(Transfer(answer, self.master, transfer.number, data), GET_NODE_INFO, 30)
        elif (info := node_info(transfer)) is not None:
            for member in self._members.get(transfer.source, ()):
                member.on_node_info(info)

    def _on_anonymous(self, transfer: Transfer) -> None:
        if self._allocator is None or self._is_quiet or transfer.kind.type_id != ALLOCATION.id & 0x3:
            return
        answer = self._allocator.on_request(transfer.data, self._clock.monotonic())
        if answer is None:
            return
        self.broadcast(ALLOCATION, answer.data, 30)
        if answer.node:
            self._note(log_messages.NODE_ID_GIVEN.line(node=answer.node, unique_id=answer.data[1:].hex()))

    def _send_status(self) -> None:
        self.broadcast(NODE_STATUS, self._status_data(), 30)

    def _status_data(self) -> bytes:
        return encode(NODE_STATUS, {"uptime": self._clock.monotonic() - self._start})

    def _number(self, kind: TransferKind) -> int:
        number = self._numbers[kind] = (self._numbers.get(kind, -1) + 1) % 32
        return number

    def _post(self, transfer: Transfer, data_type: DataType, priority: int) -> None:
        for frame in frames_of(transfer, data_type.signature, priority):
            self._bus.post(frame)
