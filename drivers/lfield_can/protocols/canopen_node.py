"""The objects of one CANopen node by SDO, one transfer at a time.

`SdoClient` decides; here its frames are sent and its waits are timed. Object dictionaries, EDS files and
value encoding are from `canopen`.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable
from canopen.sdo.exceptions import SdoAbortedError

from lfield.driver import DeviceError, read_within
from lfield_can.bus.frames import Frame
from lfield_can.eds import parse_eds
from lfield_can.protocols.cia402_tables import OBJECTS, SDO_REQUEST, name_of
from lfield_can.protocols.id_conflict import GAP, MARK, IdConflictProbe
from lfield_can.protocols.sdo import (
    ABORT,
    GENERAL_ERROR,
    Done,
    Effect,
    Failed,
    Key,
    Refused,
    Result,
    SdoClient,
    Send,
    abort,
)
from lfield_can.text_files import log_warnings

#: The request for object 0x1000.
PING = bytes.fromhex("4000100000000000")
#: The marker of a round of an id check.
_MARK = abort(MARK, GENERAL_ERROR)
#: The largest EDS file, in bytes.
MAX_BYTES = 16 << 20

Note = Callable[[str], None]


class SdoRefused(DeviceError):
    """The node refused a request."""


class CanopenNode:
    """One node: its objects by (index, subindex), accessed one after the other."""

    def __init__(self, name: str, node: int, post: Callable[[Frame], None]) -> None:
        self._name, self._id, self._post = name, node, post
        self._dictionary = standard_dictionary()
        self._client, self._transfer_lock = SdoClient(), asyncio.Lock()
        self._result: asyncio.Future[Result] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._id_probe: IdConflictProbe | None = None
        #: Whether the node does not answer requests for missing objects.
        self._ignores_missing = False
        #: Called with every written object and its bytes.
        self.on_written: Callable[[int, int, bytes], None] = lambda index, subindex, data: None

    def set_write_handler(self, on_written: Callable[[int, int, bytes], None]) -> None:
        """Sets the function that is called with every written object and its bytes."""
        self.on_written = on_written

    def load(self, path: str, note: Note) -> None:
        """Loads the objects of an EDS file; `note` gets its ignored parts. Raises DeviceError."""
        self._dictionary = read_eds(self._name, path, self._id, note)

    def ping(self) -> None:
        """Requests the device type without waiting.

        The device type never changes, so an answer to this request may count as the answer to a later one.
        """
        self._send(PING)

    def on_answer(self, data: bytes) -> None:
        """Handles a frame of the node's SDO server."""
        if self._id_probe is not None and (key := _key_of(data)) is not None:
            self._id_probe.on_answer(key)
        self._apply(self._client.on_response(data))

    def on_bus_request(self, data: bytes) -> None:
        """Handles a frame to the node's SDO server: of another client, or of this computer."""
        if self._id_probe is None or (key := _key_of(data)) is None:
            return
        if data == _MARK:
            self._id_probe.on_marker_echo()
        elif data[0] != ABORT:
            self._id_probe.on_bus_request(key)

    async def read(self, index: int, subindex: int = 0) -> int:
        """The value of an object. Raises DeviceError."""
        variable = self._variable(index, subindex)
        data = await self.read_raw(index, subindex)
        try:
            value = variable.decode_raw(data[: len(variable) // 8])
        except Exception:  # wrong length; struct.error and others
            value = None
        if not isinstance(value, int):
            raise DeviceError(self._name, f"{self._label(index, subindex)} came as {data.hex() or 'nothing'}")
        return value

    async def read_raw(self, index: int, subindex: int) -> bytes:
        """The bytes of an object. Raises DeviceError."""
        return await self._transfer(lambda: self._client.upload((index, subindex)), index, subindex)

    async def write(self, index: int, subindex: int, value: int) -> None:
        """Writes an object and reads it back. Raises DeviceError.

        An answer does not prove that the node stores the value: it may clip or round a limit, which protects
        people.
        """
        await self.write_raw(index, subindex, self._encoded(index, subindex, value))
        stored = await self.read(index, subindex)
        if stored != value:
            label = self._label(index, subindex)
            raise DeviceError(self._name, f"{label} was set to {value} but is {stored}")

    async def write_raw(self, index: int, subindex: int, data: bytes) -> None:
        """Writes the bytes of an object, 1 to 4. Raises DeviceError."""
        await self._transfer(lambda: self._client.download((index, subindex), data), index, subindex)
        self.on_written(index, subindex, data)

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether the object dictionary has the object."""
        return self._find(index, subindex) is not None

    async def has_id_conflict(self, *, briefly: bool = False) -> bool:
        """Whether two nodes answer to this id: a few requests, a fraction of a second.

        `briefly`: one request, if it is answered once; none to a node that has ignored all before.
        """
        if briefly and self._ignores_missing:
            return False
        self._id_probe = probe = IdConflictProbe(1) if briefly else IdConflictProbe()
        try:
            while (key := probe.next_key()) is not None:
                self._send(_MARK)
                with suppress(DeviceError):  # no such object, or the answer was lost
                    await self.read_raw(*key)
                await asyncio.sleep(GAP)
        finally:
            self._id_probe = None
        self._ignores_missing = probe.is_ignored and not briefly
        return probe.is_doubled

    def close(self) -> None:
        """Fails the pending transfer when the driver ends."""
        self._apply([*self._client.on_cancelled(), Failed("the driver has ended", silent=True)])

    # -- transfers --------------------------------------------------------------------------------------

    async def _transfer(self, start: Callable[[], Sequence[Effect]], index: int, subindex: int) -> bytes:
        """Queues and performs a transfer; returns its data. Raises DeviceError."""
        async with self._transfer_lock:
            result = self._result = asyncio.get_running_loop().create_future()
            try:
                self._apply(start())
                outcome = await result
            finally:
                self._apply(self._client.on_cancelled())
                self._stop_timer()
        label = self._label(index, subindex)
        match outcome:
            case Done(data):
                return data
            case Refused(code):
                # The texts of codes are canopen's.
                raise SdoRefused(self._name, f"{label} refused: {SdoAbortedError(code)}")
        kind = "DeviceTimeoutException" if outcome.silent else "DeviceException"
        raise DeviceError(self._name, f"{label}: {outcome.reason}", kind=kind)

    def _apply(self, effects: Sequence[Effect]) -> None:
        for effect in effects:
            if not isinstance(effect, Send):
                self._end(effect)
                continue
            if effect.within is not None:
                # Set before sending, since the answer may be immediate.
                self._set_timer(effect.within)
            self._send(effect.data)

    def _send(self, request: bytes) -> None:
        if self._id_probe is not None and request[0] != ABORT and (key := _key_of(request)) is not None:
            self._id_probe.on_request(key)
        self._post(Frame(SDO_REQUEST + self._id, request))

    def _end(self, result: Result) -> None:
        self._stop_timer()
        if self._result is not None and not self._result.done():
            self._result.set_result(result)

    def _set_timer(self, seconds: float) -> None:
        self._stop_timer()
        self._timer = asyncio.get_running_loop().call_later(seconds, self._on_timer)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _on_timer(self) -> None:
        self._timer = None
        self._apply(self._client.on_timeout())

    def _encoded(self, index: int, subindex: int, value: int) -> bytes:
        variable = self._variable(index, subindex)
        try:
            return bytes(variable.encode_raw(value))
        except Exception:  # struct.error: the value does not fit
            raise DeviceError(self._name, f"{self._label(index, subindex)} cannot hold {value}") from None

    def _variable(self, index: int, subindex: int) -> ODVariable:
        variable = self._find(index, subindex)
        if variable is None:
            raise SdoRefused(self._name, f"its EDS file has no {self._label(index, subindex)}")
        return variable

    def _find(self, index: int, subindex: int) -> ODVariable | None:
        variable = self._dictionary.get_variable(index, subindex)
        return variable if isinstance(variable, ODVariable) and len(variable) <= 32 else None

    def _label(self, index: int, subindex: int) -> str:
        return f"{name_of(index, subindex)} 0x{index:04X}:{subindex}"


def _key_of(frame: bytes) -> Key | None:
    """The object of a frame from either side, if the frame names one."""
    if len(frame) != 8:
        return None
    _, index, subindex = struct.unpack_from("<BHB", frame)
    return index, subindex


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


def read_eds(name: str, path: str, node: int, note: Note = lambda text: None) -> canopen.ObjectDictionary:
    """The object dictionary of an EDS file; `note` gets its ignored parts. Raises DeviceError."""
    try:
        if Path(path).suffix.lower() == ".epf":
            return canopen.import_od(path, node)
        dictionary, warnings = parse_eds(path, read_within(Path(path), MAX_BYTES))
    except Exception as error:  # OSError, EdsError, and exceptions of the EPF parser
        problem = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise DeviceError(name, f"{path} is not a readable EDS file: {problem.splitlines()[0]}") from None
    log_warnings(warnings, path, note)
    return dictionary
