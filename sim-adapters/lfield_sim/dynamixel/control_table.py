"""The control table: registers as bytes, with their access rules."""

from __future__ import annotations

from enum import IntEnum

from lfield_sim.dynamixel.servo_model import Register, ServoModel


class RefusalCode(IntEnum):
    """Error numbers of protocol 2.0."""

    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    RANGE = 4
    LENGTH = 5
    LIMIT = 6
    ACCESS = 7


class InstructionRefused(Exception):
    """A refused instruction."""

    def __init__(self, reason: RefusalCode) -> None:
        self.reason = reason
        super().__init__(reason.name)


class ControlTable:
    """The registers of one servo, with initial values."""

    def __init__(self, model: ServoModel) -> None:
        self.model = model
        self._items = model.items
        self._owner: dict[int, Register] = {}
        for item in model.items.values():
            self._owner.update(dict.fromkeys(range(item.address, item.address + item.size), item))
        self._indirect = _indirect(model)
        self._windows = [(data, data + count) for _, data, count in model.indirect]
        # Two representations: bytes for the bus, numbers for the servo, which reads them often.
        self._memory = bytearray(1 + max(self._owner))
        self._values: dict[str, int] = {}
        for item in model.items.values():
            self.put(item.name, item.initial)

    def __contains__(self, name: str) -> bool:
        return name in self._items

    def __getitem__(self, name: str) -> int:
        return self._values[name]

    def put(self, name: str, value: int) -> None:
        """Sets a register without rules; values wrap around."""
        item = self._items[name]
        raw = (value & ((1 << 8 * item.size) - 1)).to_bytes(item.size, "little")
        self._memory[item.address : item.address + item.size] = raw
        self._values[name] = int.from_bytes(raw, "little", signed=item.signed)

    def read(self, address: int, length: int) -> bytes:
        """Reads bytes; addresses without a register are 0. Raises InstructionRefused."""
        end = address + length
        if length == 0:
            raise InstructionRefused(RefusalCode.LENGTH)
        if end > len(self._memory):
            raise InstructionRefused(RefusalCode.ACCESS)
        if not any(first < end and address < last for first, last in self._windows):
            return bytes(self._memory[address:end])
        return bytes(self._memory[self._target(place)] for place in range(address, end))

    def _target(self, address: int) -> int:
        """The target of an address: indirect data is stored at another one."""
        pointer = self._indirect.get(address)
        if pointer is None:
            return address
        target = int.from_bytes(self._memory[pointer : pointer + 2], "little")
        # One level of indirection only, which excludes cycles.
        return target if target < len(self._memory) else address

    def changes(self, address: int, data: bytes) -> list[tuple[Register, int]]:
        """The registers of a write, with their values; sets nothing. Raises InstructionRefused.

        A register is written as a whole or not at all.
        """
        if not data:
            raise InstructionRefused(RefusalCode.LENGTH)
        byte_by_address = {self._target(address + offset): byte for offset, byte in enumerate(data)}
        changes = []
        while byte_by_address:
            first = next(iter(byte_by_address))
            item = self._owner.get(first)
            if item is None:
                raise InstructionRefused(RefusalCode.ACCESS)
            try:
                raw = bytes(byte_by_address.pop(item.address + offset) for offset in range(item.size))
            except KeyError:
                raise InstructionRefused(RefusalCode.LENGTH) from None
            changes.append((item, int.from_bytes(raw, "little", signed=item.signed)))
        return changes

    def reset(self, keep: frozenset[str] = frozenset(), *, eeprom: bool = True) -> None:
        """Resets everything (or only the RAM area) except `keep`."""
        for item in self._items.values():
            if item.name not in keep and (eeprom or not item.eeprom):
                self.put(item.name, item.initial)


def _indirect(model: ServoModel) -> dict[int, int]:
    """The address register of each byte of indirect data."""
    return {
        data + place: first + 2 * place for first, data, count in model.indirect for place in range(count)
    }
