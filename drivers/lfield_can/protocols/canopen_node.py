"""SDO with one node through `canopen`, whose calls block: each node has a thread for them.

Answers are bounded in time and size; every write is read back, since canopen's client does not look at which
object an answer to a write is about, and takes a late one for its own.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable
from canopen.sdo.exceptions import SdoAbortedError

from lfield.driver import DeviceError
from lfield_can.bus.frames import Frame
from lfield_can.protocols.cia402_tables import OBJECTS, SDO_ANSWER, SDO_REQUEST, name_of

T = TypeVar("T")

#: Tries of one request, and seconds to wait for each answer.
TRIES, ANSWER = 3, 0.3
#: More bytes than this are no answer to anything that is asked here.
LONGEST = 64
#: First byte of a request that ends a transfer; it has no answer.
ABORT = 0x80
#: The request for object 0x1000.
PING = bytes.fromhex("4000100000000000")
#: Abort codes that say that there is no such object, or that it cannot be written.
ABSENT = frozenset({0x06020000, 0x06090011, 0x060A0023, 0x06010002, 0x06010000, 0x08000024})


class SdoRefused(DeviceError):
    """The node refused a request; `absent` when it has no such object."""

    def __init__(self, device: str, reason: str, code: int) -> None:
        super().__init__(device, reason)
        self.absent = code in ABSENT


class _Network(canopen.Network):
    """canopen's view of our bus: what it sends is ours to send, what came in is handed to it."""

    def __init__(self, post: Callable[[Frame], None]) -> None:
        super().__init__()
        self._post = post
        self.requests = 0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.requests += data[0] != ABORT
        self._post(Frame(can_id, bytes(data)))


class CanopenNode:
    """One node: its objects by (index, subindex), read and written one after the other."""

    def __init__(self, name: str, node: int, post: Callable[[Frame], None]) -> None:
        self._name, self._id = name, node
        self._network = _Network(post)
        self._dictionary = standard_dictionary()
        self._node = self._made()
        self._worker = ThreadPoolExecutor(1, f"sdo-{node}")
        self._answers = 0
        #: Called with every object that was written, and its bytes.
        self.on_written: Callable[[int, int, bytes], None] = lambda index, subindex, data: None

    def _made(self) -> canopen.RemoteNode:
        node = canopen.RemoteNode(self._id, self._dictionary)
        node.sdo.RESPONSE_TIMEOUT = ANSWER
        self._network[self._id] = node
        return node

    def load(self, path: str) -> None:
        """Take the objects from an EDS file. Raises DeviceError."""
        self._dictionary = read_eds(self._name, path, self._id)
        self._node = self._made()

    def ping(self) -> None:
        """Ask for the device type and do not wait for the answer."""
        self._network.send_message(SDO_REQUEST + self._id, PING)

    def on_answer(self, data: bytes) -> None:
        """A frame of the node's SDO server."""
        self._answers += 1
        if len(data) == 8:
            self._network.notify(SDO_ANSWER + self._id, bytearray(data), 0.0)

    async def read(self, index: int, subindex: int = 0) -> int:
        """The value of an object. Raises DeviceError."""
        variable = self._variable(index, subindex)
        data = await self.read_raw(index, subindex)
        try:
            value = variable.decode_raw(data[: len(variable) // 8])
        except Exception:  # of the wrong length; struct.error and others
            value = None
        if not isinstance(value, int):
            raise DeviceError(self._name, f"{self._label(index, subindex)} came as {data.hex() or 'nothing'}")
        return value

    async def read_raw(self, index: int, subindex: int) -> bytes:
        """The bytes of an object. Raises DeviceError."""
        return await self._run(lambda: self._upload(index, subindex), index, subindex)

    async def write(self, index: int, subindex: int, value: int) -> None:
        """Write an object and read it back. Raises DeviceError."""
        await self.write_raw(index, subindex, self._encoded(index, subindex, value))
        back = await self.read(index, subindex)
        if back != value:
            label = self._label(index, subindex)
            raise DeviceError(self._name, f"{label} was set to {value} and is {back}")

    async def write_raw(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an object. Raises DeviceError."""
        await self._run(lambda: self._node.sdo.download(index, subindex, data), index, subindex)
        self.on_written(index, subindex, data)

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether the object dictionary has the object."""
        return self._find(index, subindex) is not None

    @property
    def doubled(self) -> bool:
        """Whether more answers came than were asked for: two nodes have this id."""
        return self._answers > self._network.requests

    def close(self) -> None:
        """The worker ends after what it is at."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _upload(self, index: int, subindex: int) -> bytes:
        """As the client's `upload`, with a bound: a server may send segments for ever."""
        stream = self._node.sdo.open(index, subindex, buffering=0)
        data = b""
        while len(data) < LONGEST and (part := stream.read(7)):
            data += part
        return data

    async def _run(self, call: Callable[[], T], index: int, subindex: int) -> T:
        loop, tries = asyncio.get_running_loop(), TRIES
        while True:
            tries -= 1
            try:
                return await loop.run_in_executor(self._worker, call)
            except SdoAbortedError as error:
                raise SdoRefused(
                    self._name, f"{self._label(index, subindex)} refused: {error}", error.code
                ) from None
            except Exception as error:  # no answer, or one that canopen stumbles over
                if tries:
                    continue
                label = self._label(index, subindex)
                raise DeviceError(self._name, f"{label}: {error}", kind="DeviceTimeoutException") from None

    def _encoded(self, index: int, subindex: int, value: int) -> bytes:
        variable = self._variable(index, subindex)
        try:
            return bytes(variable.encode_raw(value))
        except Exception:  # struct.error, since the value does not fit
            raise DeviceError(self._name, f"{self._label(index, subindex)} cannot hold {value}") from None

    def _variable(self, index: int, subindex: int) -> ODVariable:
        variable = self._find(index, subindex)
        if variable is None:
            raise SdoRefused(self._name, f"its EDS file has no {self._label(index, subindex)}", 0x06020000)
        return variable

    def _find(self, index: int, subindex: int) -> ODVariable | None:
        found = self._dictionary.get_variable(index, subindex)
        return found if isinstance(found, ODVariable) and len(found) <= 32 else None

    def _label(self, index: int, subindex: int) -> str:
        return f"{name_of(index, subindex)} 0x{index:04X}:{subindex}"


def standard_dictionary() -> canopen.ObjectDictionary:
    """The objects of `OBJECTS`, for drives without an EDS file."""
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]  # canopen types a part of itself
    for (index, subindex), (name, data_type) in OBJECTS.items():
        variable = ODVariable(name, index, subindex)
        variable.data_type = data_type
        if not any(i == index and s for i, s in OBJECTS):
            dictionary.add_object(variable)
            continue
        if index not in dictionary:
            dictionary.add_object(ODRecord(f"0x{index:04X}", index))
        record = dictionary[index]
        assert isinstance(record, ODRecord | ODArray)
        record.add_member(variable)
    return dictionary


def read_eds(name: str, path: str, node: int) -> canopen.ObjectDictionary:
    """The object dictionary of an EDS file. Raises DeviceError."""
    try:
        return canopen.import_od(path, node)
    except Exception as error:  # whatever a parser of foreign text raises
        words = str(error).splitlines()[:1] or [type(error).__name__]
        raise DeviceError(name, f"{path} is not an EDS file that can be read: {words[0]}") from None
