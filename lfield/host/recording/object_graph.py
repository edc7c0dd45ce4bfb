"""Walks, writes and reads graphs of objects, for snapshots of a core. Pure."""

from __future__ import annotations

from array import array
from collections import Counter, OrderedDict, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from functools import cached_property, partial
from itertools import count
from types import BuiltinMethodType, FunctionType, MethodType
from typing import Any

import msgspec
from msgspec.structs import force_setattr

from lfield.errors import RecordingError
from lfield.host.recording.snapshot_classes import (
    class_named,
    new_instance,
    reference_to,
    require_instantiable,
)
from lfield.vm.engine_interface import Reading
from lfield.vm.memory.block import Block
from lfield.vm.memory.block_allocator import BlockAllocator

#: Values that are encoded as they are.
PLAIN = (bool, int, float, str, bytes, type(None))
#: Makes an empty container of each kind.
_CONTAINERS: Mapping[str, Callable[[], Any]] = {
    **{kind.__name__: kind for kind in (dict, OrderedDict, Counter, list, set, deque)},
    "defaultdict": partial(defaultdict, list),
}
_OURS = "lfield."
#: The memory of all blocks of a snapshot, in bytes.
_MAX_BLOCKS = 1 << 31


def is_instance(value: object) -> bool:
    """Whether `value` is an object of a class of lfield, whose attributes are its state."""
    cls = type(value)
    return cls.__module__.startswith(_OURS) and not isinstance(value, (type, Enum, tuple, str, dict))


def is_container(value: object) -> bool:
    """Whether `value` is a container that is encoded by its elements."""
    make = _CONTAINERS.get(type(value).__name__)
    if make is None or type(default := make()) is not type(value):
        return False
    return all(
        getattr(value, name, None) is getattr(default, name, None) for name in ("maxlen", "default_factory")
    )


def is_frozen(value: object) -> bool:
    """Whether the attributes of an instance cannot change."""
    cls: Any = type(value)
    if isinstance(value, msgspec.Struct):
        return bool(cls.__struct_config__.frozen)
    parameters = getattr(cls, "__dataclass_params__", None)
    return parameters is not None and parameters.frozen


def attributes(value: object) -> Iterator[tuple[str, object]]:
    """The attributes of an instance by name, without cached ones."""
    cls = type(value)
    names: set[str] = set(getattr(value, "__dict__", ()))
    for base in cls.__mro__:
        slots = base.__dict__.get("__slots__", ())
        names.update((slots,) if isinstance(slots, str) else slots)
    names.update(getattr(cls, "__struct_fields__", ()))
    if isinstance(value, BaseException):
        names.add("args")
    for name in sorted(names):
        # Other attributes, such as __orig_class__, are set by `typing`.
        if name.startswith("__"):
            continue
        if not isinstance(getattr(cls, name, None), cached_property) and hasattr(value, name):
            yield name, getattr(value, name)


def children(value: object) -> Iterable[object]:
    """The objects that an object refers to, in a fixed order."""
    if isinstance(value, dict):
        return () if type(value).__module__.startswith(_OURS) else [x for pair in value.items() for x in pair]
    if isinstance(value, (list, tuple, deque)):
        return value
    if isinstance(value, FunctionType):
        return [cell.cell_contents for cell in value.__closure__ or ()]
    if isinstance(value, (MethodType, BuiltinMethodType)):
        return [value.__self__]
    if isinstance(value, partial):
        return [value.func, *value.args, *value.keywords.values()]
    if is_instance(value):
        return [each for _, each in attributes(value)]
    return ()


def walk(root: object, excluded: Mapping[int, object], opaque: tuple[type, ...]) -> list[object]:
    """All objects that can be reached from a root, each once, in a fixed order.

    Plain values and tuples are not listed; objects `excluded` by id are neither listed nor entered, `opaque`
    ones are listed only.
    """
    objects: list[object] = []
    visited: set[int] = set(excluded)
    # Tuples have no number, but must be alive while their ids are remembered.
    tuples: list[object] = []
    stack: list[object] = [root]
    while stack:
        each = stack.pop()
        if isinstance(each, (*PLAIN, Enum, frozenset, type, count)) or id(each) in visited:
            continue
        visited.add(id(each))
        (tuples if isinstance(each, tuple) else objects).append(each)
        if not isinstance(each, opaque):
            stack.extend(reversed(list(children(each))))
    return objects


class GraphWriter:
    """Encodes objects as plain data; objects with a reference in `known` (by id) are encoded as this
    reference.
    """

    def __init__(self, known: Mapping[int, list[Any]], number_of: Callable[[Reading], int]) -> None:
        self._known, self._number_of = known, number_of
        #: The unknown objects, by id, with their positions among `objects`.
        self._places: dict[int, int] = {}
        self._found: list[object] = []
        #: The bytes of all blocks.
        self._size = 0

    def state_of(self, value: object) -> Any:
        """The state of a known object; None if it cannot change."""
        if isinstance(value, dict):
            if type(value).__module__.startswith(_OURS):
                return None
            return [self.encode(x) for pair in value.items() for x in pair]
        if isinstance(value, (list, deque, set)):
            return [self.encode(each) for each in value]
        if is_instance(value) and not is_frozen(value):
            return [x for name, each in self._own(value) for x in (name, self.encode(each))]
        return None

    def _own(self, value: object) -> Iterator[tuple[str, object]]:
        """The attributes of a known object.

        A function that shadows a method of the class, such as that of a simulation that observes the calls,
        is omitted: the restored object has the method. Raises RecordingError for any other new function.
        """
        cls = type(value)
        for name, each in attributes(value):
            if not isinstance(each, FunctionType) or id(each) in self._known:
                yield name, each
            elif not isinstance(getattr(cls, name, None), FunctionType):
                raise RecordingError(f"a checkpoint cannot contain the function {cls.__name__}.{name}")

    def objects(self) -> list[Any]:
        """All objects that were encoded and are not known."""
        rows: list[Any] = []
        for each in self._found:
            rows.append(self._object(each))
        return rows

    def _object(self, value: object) -> list[Any]:
        if isinstance(value, Block):
            return self._block(value)
        if is_container(value):
            return [type(value).__name__, self.state_of(value)]
        cls: Any = type(value)
        return ["instance", require_instantiable(cls), self._state(value)]

    def _block(self, block: Block) -> list[Any]:
        capacity = len(block.w)
        self._size += 8 * capacity
        if not _has_valid_sizes(capacity, block.limit) or self._size > _MAX_BLOCKS:
            raise RecordingError("a checkpoint cannot contain a block of this size")
        used = bytes(memoryview(block.data)[: 8 * block.top])
        return ["block", used, capacity, block.limit, block.packed]

    def encode(self, value: object) -> Any:
        """A value as plain data. Raises RecordingError if it has no encoding."""
        if type(value) in PLAIN:
            if type(value) is int and not -(1 << 63) <= value < 1 << 64:
                raise RecordingError("a checkpoint cannot contain an integer of more than 64 bits")
            return value
        if (reference := self._known.get(id(value))) is not None:
            return reference
        if isinstance(value, Enum):
            return ["enum", reference_to(type(value)), _member_name(value)]
        if isinstance(value, (tuple, frozenset)):
            cls: Any = type(value)
            kind = cls.__name__ if cls in (tuple, frozenset) else reference_to(cls)
            return ["tuple", kind, [self.encode(each) for each in value]]
        if isinstance(value, Reading):
            return ["reading", self._number_of(value)]
        return self._encode_rare(value)

    def _encode_rare(self, value: object) -> Any:
        if isinstance(value, Block) or is_container(value) or is_instance(value):
            if id(value) not in self._places:
                self._places[id(value)] = len(self._found)
                self._found.append(value)
            return ["object", self._places[id(value)]]
        match value:
            case type():
                return ["type", reference_to(value)]
            # The text of the counter is the only public access to its next number: `count(5)`, with a step
            # `count(5, 2)`.
            case count() if (text := repr(value)[6:-1]).isdecimal():
                return ["count", int(text)]
            case memoryview() | bytearray() | array():
                view = memoryview(value)
                return [type(value).__name__, view.format, view.tobytes()]
            case MethodType() if getattr(value.__self__, value.__func__.__name__, None) == value:
                return ["method", self.encode(value.__self__), value.__func__.__name__]
            case partial() if not value.keywords:
                return ["partial", self.encode(value.func), [self.encode(each) for each in value.args]]
            case str():
                return ["text", reference_to(type(value)), str(value), self._state(value)]
        raise RecordingError(f"a checkpoint cannot contain a {type(value).__name__}")

    def _state(self, value: object) -> list[Any]:
        return [x for name, each in attributes(value) for x in (name, self.encode(each))]


class GraphReader:
    """Decodes the output of a GraphWriter; `resolve` returns the known object of a reference."""

    def __init__(
        self,
        resolve: Callable[[list[Any]], object],
        readings: list[Reading],
        space: BlockAllocator,
    ) -> None:
        self._resolve, self._readings, self._space = resolve, readings, space
        self._objects: list[Any] = []
        self._rows: list[Any] = []
        #: The bytes that further blocks may have, and the structs whose creation has begun.
        self._free = _MAX_BLOCKS
        self._created: set[int] = set()

    def create(self, objects: list[Any]) -> None:
        """Create all objects, then set their states: instances before containers that use their hashes."""
        self._rows = objects
        self._objects = [self._shell(each) for each in objects]
        for place, row in enumerate(objects):
            if row[0] == "instance":
                item = self._object(place)
                if not isinstance(item, msgspec.Struct):
                    self.set_state(item, row[2])
        for item, row in zip(self._objects, objects, strict=True):
            if row[0] not in ("instance", "block"):
                self.set_state(item, row[1])

    def _object(self, place: int) -> Any:
        """An object; a struct is created here, from its fields."""
        found = self._objects[place]
        if found is None:
            if place in self._created:
                raise RecordingError("a checkpoint has an object that contains itself")
            self._created.add(place)
            _, name, state = self._rows[place]
            fields = zip(state[::2], map(self.decode, state[1::2]), strict=True)
            found = self._objects[place] = class_named(name)(**dict(fields))
        return found

    def _shell(self, row: list[Any]) -> Any:
        match row[0]:
            case "block":
                return self._block(*row[1:])
            case "instance":
                cls: Any = class_named(row[1])
                return None if issubclass(cls, msgspec.Struct) else new_instance(cls)
            case str(kind) if kind in _CONTAINERS:
                return _CONTAINERS[kind]()
        raise RecordingError(f"a checkpoint has an object of an unknown kind: {row[0]}")

    def _block(self, data: bytes, capacity: int, limit: int, packed: int) -> Block:
        self._free -= 8 * capacity
        if not _has_valid_sizes(capacity, limit) or len(data) > 8 * capacity or self._free < 0:
            raise RecordingError("a checkpoint has a block with wrong sizes")
        buffer = self._space.allocate(8 * capacity)
        buffer[: len(data)] = data
        return Block(buffer, len(data) // 8, limit, self._space, packed=packed)

    def set_state(self, item: Any, state: list[Any]) -> None:
        """Set the state of an object, in place."""
        if isinstance(item, dict):
            items = [self.decode(each) for each in state]
            item.clear()
            # Not `update`, which counts the items of a Counter.
            for name, value in zip(items[::2], items[1::2], strict=True):
                item[name] = value
        elif isinstance(item, set):
            item.clear()
            item.update(self.decode(each) for each in state)
        elif isinstance(item, (list, deque)):
            values = [self.decode(each) for each in state]
            item.clear()
            item.extend(values)
        else:
            self._set_attributes(item, state)

    def _set_attributes(self, item: Any, state: list[Any]) -> None:
        names = state[::2]
        setter = force_setattr if isinstance(item, msgspec.Struct) else object.__setattr__
        for name, _ in list(attributes(item)):
            if name not in names:
                object.__delattr__(item, name)
        for name, value in zip(names, state[1::2], strict=True):
            if name.startswith("__"):
                raise RecordingError(f"a checkpoint sets an attribute that is no state: {name}")
            setter(item, name, self.decode(value))

    def decode(self, value: Any) -> Any:
        """A value from plain data. Raises RecordingError."""
        if not isinstance(value, list):
            return value
        match value:
            case ["object", int(place)]:
                return self._object(place)
            case ["tuple", str(kind), list(items)]:
                return self._tuple(kind, [self.decode(each) for each in items])
            case ["enum", str(kind), str(name)]:
                return class_named(kind)[name]  # type: ignore[index]  # an Enum class, by its members
            case ["type", str(kind)]:
                return class_named(kind)
            case ["reading", int(number)]:
                return self._readings[number]
            case ["count", int(start)]:
                return count(start)
            case ["memoryview", str(format), bytes(data)]:
                plain: Any = memoryview(bytearray(data))
                return plain.cast(format) if format != "B" else data
            case ["bytearray", _, bytes(data)]:
                return bytearray(data)
            case ["array", str(format), bytes(data)]:
                return array(format, data)
            case ["text", str(kind), str(text), list(state)]:
                return self._text(kind, text, state)
            case ["method", owner, str(name)]:
                return self._method(self.decode(owner), name)
            case ["partial", function, list(items)]:
                return partial(self.decode(function), *(self.decode(each) for each in items))
        return self._resolve(value)

    def _tuple(self, kind: str, items: list[Any]) -> Any:
        if kind == "frozenset":
            return frozenset(items)
        return tuple(items) if kind == "tuple" else tuple.__new__(class_named(kind), items)

    def _text(self, kind: str, text: str, state: list[Any]) -> str:
        cls = class_named(kind)
        if not issubclass(cls, str):
            raise RecordingError(f"a checkpoint names a class that is no text: {kind}")
        found = str.__new__(cls, text)
        self._set_attributes(found, state)
        return found

    def _method(self, owner: object, name: str) -> Any:
        found = getattr(owner, name)
        if not isinstance(found, MethodType) or not is_instance(owner):
            raise RecordingError(f"a checkpoint names a method that does not exist: {name}")
        return found


def _has_valid_sizes(capacity: int, limit: int) -> bool:
    return capacity <= limit + (1 << 16)


def _member_name(value: Enum) -> str:
    """The name of a member of an enumeration. Raises RecordingError for a combination of flags."""
    if value.name not in type(value).__members__:
        raise RecordingError(f"a checkpoint cannot contain {value!r}")
    return str(value.name)
