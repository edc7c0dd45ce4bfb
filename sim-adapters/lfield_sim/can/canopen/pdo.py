"""Process data objects: received and sent without requests (CiA 301, 7.2.2)."""

from __future__ import annotations

from lfield_sim.can.canopen.sdo import (
    NO_OBJECT,
    NOT_MAPPABLE,
    PDO_LENGTH,
    STATE,
    TYPES,
    Key,
    ObjectDictionary,
    SdoAbort,
)

INVALID = 1 << 31
#: Objects whose change triggers an event-driven PDO; others change all the time.
EVENTS = frozenset({(0x6041, 0), (0x6061, 0), (0x1001, 0)})
_COUNTS = (range(0x1600, 0x1604), range(0x1A00, 0x1A04))


class Pdo:
    """A PDO, defined by its communication and mapping records, which are read each time."""

    def __init__(self, objects: ObjectDictionary, number: int, *, sent: bool) -> None:
        self._objects = objects
        self._record = (0x1800 if sent else 0x1400) + number
        self._map = (0x1A00 if sent else 0x1600) + number

    @property
    def identifier(self) -> int | None:
        """The COB-ID, or None while it is not valid."""
        value = self._objects.get(self._record, 1)
        return None if value & INVALID else value & 0x7FF

    @property
    def kind(self) -> int:
        """Transmission type: 0 at the next SYNC after an event, 1..240 every nth SYNC, 254 and 255 events."""
        return self._objects.get(self._record, 2)

    def keys(self) -> list[tuple[Key, int]]:
        """The mapped objects, with lengths in bytes."""
        count = self._objects.get(self._map)
        values = [self._objects.get(self._map, n + 1) for n in range(count)]
        return [((value >> 16, value >> 8 & 0xFF), (value & 0xFF) // 8) for value in values]


class Rpdo(Pdo):
    """A PDO that the node receives."""

    def __init__(self, objects: ObjectDictionary, number: int) -> None:
        super().__init__(objects, number, sent=False)
        self._waiting: bytes | None = None

    def on_data(self, data: bytes) -> bool:
        """Receives data; False when it is shorter than the mapping."""
        if len(data) < sum(length for _, length in self.keys()):
            return False
        self._waiting = data
        if self.kind > 240:
            self.apply()
        return True

    def apply(self) -> None:
        """Sets the objects; synchronous PDOs wait for SYNC."""
        if self._waiting is None:
            return
        writes, offset = {}, 0
        for key, length in self.keys():
            writes[key] = self._waiting[offset : offset + length]
            offset += length
        self._waiting = None
        self._objects.write_all(writes)


class Tpdo(Pdo):
    """A PDO that the node sends."""

    def __init__(self, objects: ObjectDictionary, number: int) -> None:
        super().__init__(objects, number, sent=True)
        self._since = 0.0
        self._syncs = 0
        self._events = b""

    def data(self) -> bytes:
        """The present content of the PDO."""
        return b"".join(self._objects.encoded(key)[:length] for key, length in self.keys())

    def due(self, dt: float) -> bool:
        """Advances time; returns whether the PDO is due by its timer or an event."""
        self._since += dt
        if self.kind < 254:
            return False
        events = b"".join(self._objects.encoded(key) for key, _ in self.keys() if key in EVENTS)
        timer = self._objects.get(self._record, 5) / 1000.0
        inhibited = self._since < self._objects.get(self._record, 3) / 10_000.0
        if not ((timer and self._since >= timer - 1e-9) or (events != self._events and not inhibited)):
            return False
        self._since, self._events = 0.0, events
        return True

    def due_at_sync(self) -> bool:
        """Whether the PDO is due at a SYNC. Type 0 is sent at every SYNC."""
        if self.kind > 240:
            return False
        self._syncs += 1
        if self._syncs < max(1, self.kind):
            return False
        self._syncs = 0
        return True


def guard(objects: ObjectDictionary, key: Key, value: int) -> None:
    """Refuses mappings that CiA 301 forbids. Raises SdoAbort."""
    index, subindex = key
    if not any(index in records for records in _COUNTS):
        return
    valid = not objects.get(index - 0x200, 1) & INVALID
    if valid or (subindex and objects.get(index)):
        raise SdoAbort(STATE)
    if subindex and value:
        _check_mapped(objects, value)
    elif not subindex and sum(objects.get(index, n + 1) & 0xFF for n in range(value)) > 64:
        raise SdoAbort(PDO_LENGTH)


def _check_mapped(objects: ObjectDictionary, value: int) -> None:
    entry = objects.entries.get((value >> 16, value >> 8 & 0xFF))
    if entry is None:
        raise SdoAbort(NO_OBJECT)
    if not entry.mappable or value & 0xFF != 8 * TYPES[entry.type][0]:
        raise SdoAbort(NOT_MAPPABLE)
