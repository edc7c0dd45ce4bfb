"""For a randomly changed program, the verifier returns or raises ProgramFileError, and no other error."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import time

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from program_draft import ARM, Draft

from lfield.bytecode import encoding
from lfield.bytecode.opcodes import TABLE
from lfield.bytecode.program import (
    DEVICE,
    STRING,
    Core,
    DeviceField,
    FieldRecord,
    Handler,
    Program,
    Quad,
    encode_quads,
)
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError

_SOUND = Draft()
_CORE = _SOUND.core()
_QUADS = _SOUND.program().quads

_opcode = st.one_of(st.sampled_from([row.code for row in TABLE]), st.integers(-(1 << 31), (1 << 31) - 1))
_number = st.one_of(st.integers(-8, 70), st.sampled_from([-(1 << 31), (1 << 31) - 1]))
_quad = st.builds(Quad, _opcode, _number, _number, _number)


def accepts_or_refuses(core: Core) -> None:
    with contextlib.suppress(ProgramFileError):
        verify(Program(core, _SOUND.program().debug, b""))


def with_code(quads: list[Quad]) -> Core:
    return Core(*[getattr(_CORE, name) for name in Core.__struct_fields__[:-1]], encode_quads(quads))


@given(st.lists(st.tuples(st.integers(0, len(_QUADS) - 1), _quad), min_size=1, max_size=4))
@settings(deadline=None)
def test_changed_instructions_are_accepted_or_refused(changes: list[tuple[int, Quad]]) -> None:
    quads = [*_QUADS]
    for at, quad in changes:
        quads[at] = quad
    accepts_or_refuses(with_code(quads))


@given(st.integers(0, len(_QUADS) - 1), st.integers(0, 3), _number)
@settings(deadline=None)
def test_a_changed_operand_is_accepted_or_refused(at: int, position: int, number: int) -> None:
    quads = [*_QUADS]
    numbers = [*quads[at]]
    numbers[position] = number
    quads[at] = Quad(*numbers)
    accepts_or_refuses(with_code(quads))


@given(st.permutations(range(len(_QUADS))))
@settings(deadline=None, max_examples=50)
def test_reordered_instructions_are_accepted_or_refused(order: list[int]) -> None:
    accepts_or_refuses(with_code([_QUADS[i] for i in order]))


def _leaves(value: object, path: tuple[int, ...] = ()) -> list[tuple[int, ...]]:
    """The paths of all values in nested lists."""
    if isinstance(value, list):
        return [leaf for i, part in enumerate(value) for leaf in _leaves(part, (*path, i))]
    return [path]


#: Paths of the values in the records of the core; other tests change the code.
_RECORDS = _leaves(msgspec.msgpack.decode(msgspec.msgpack.encode(_CORE))[:-1])


@given(st.lists(st.sampled_from(_RECORDS), min_size=1, max_size=3), st.data())
@settings(deadline=None, max_examples=300)
def test_changed_records_are_accepted_or_refused(paths: list[tuple[int, ...]], data: st.DataObject) -> None:
    plain = msgspec.msgpack.decode(msgspec.msgpack.encode(_CORE))
    for path in paths:
        holder = plain
        for step in path[:-1]:
            holder = holder[step]
        holder[path[-1]] = data.draw(_like(holder[path[-1]]))
    try:
        core = msgspec.msgpack.decode(msgspec.msgpack.encode(plain), type=Core)
    except msgspec.ValidationError:
        return  # a value of another kind, which decoding refuses before the verifier
    accepts_or_refuses(core)


def _like(value: object) -> st.SearchStrategy[object]:
    if isinstance(value, str):
        return st.one_of(
            st.sampled_from(["class", "resource", "coordinator", "global", "Box"]), st.text(max_size=4)
        )
    if isinstance(value, bool) or value is None:
        return st.sampled_from([True, False, None])
    return st.one_of(st.integers(-3, 20), st.integers(-(1 << 63), (1 << 64) - 1))


def _file() -> bytes:
    return encoding.encode(encoding.assemble(_CORE, _SOUND.program().debug))


def test_encoding_and_decoding_keep_a_program_and_its_digest() -> None:
    program = encoding.decode(_file())
    assert program.core == _CORE
    assert program.digest == hashlib.sha256(msgspec.msgpack.encode(_CORE)).digest()


def test_the_digest_does_not_depend_on_debug_information() -> None:
    other = Draft()
    other.debug = []
    program = other.program()
    assert encoding.assemble(program.core, program.debug).digest == encoding.decode(_file()).digest


@given(st.integers(0, len(_file()) - 1), st.integers(1, 255))
@settings(deadline=None)
def test_a_changed_byte_is_refused(at: int, change: int) -> None:
    data = bytearray(_file())
    data[at] ^= change
    if 6 <= at < 8 or (at == 4 and data[at] == encoding.OLD_VERSION):
        return  # two unused bytes, or an older version, which is supported
    with pytest.raises(ProgramFileError):
        encoding.decode(bytes(data))


@given(st.integers(0, len(_file()) - 1))
@settings(deadline=None)
def test_a_truncated_file_is_refused(length: int) -> None:
    with pytest.raises(ProgramFileError):
        encoding.decode(_file()[:length])


@given(st.binary(max_size=200))
@settings(deadline=None)
def test_random_bytes_are_refused(body: bytes) -> None:
    """The checksum is correct, so lfield decodes the records."""
    header = encoding._HEADER.pack(
        encoding.MAGIC, encoding.VERSION, 0, hashlib.sha256(body).digest(), len(body)
    )
    with pytest.raises(ProgramFileError):
        encoding.decode(header + body)


def _seconds(count: int) -> float:
    """Processor time to verify `count` jumps, handlers, and device calls.

    The garbage collector is off, because it would also visit objects of other tests.
    """
    draft = Draft()
    draft.code[1][2:2] = [("jmp", at + 3, 0, 0) for at in range(count)]
    draft.change_method(1, handlers=tuple(Handler(at + 2, at + 3, 1, 0, 6) for at in range(count)))
    fields = tuple(FieldRecord(f"hand{i}", DEVICE) for i in range(count))
    devices = tuple(DeviceField(field.name, "Gripper") for field in fields)
    draft.change_class(ARM, fields=(FieldRecord("id", STRING), *fields), devices=devices)
    draft.change_device_call(field="hand0")
    draft.device_calls *= count
    program = Program(draft.core(), draft.program().debug, b"")
    gc.collect()
    gc.disable()
    try:
        started = time.process_time()
        verify(program)
        return time.process_time() - started
    finally:
        gc.enable()


@pytest.mark.few(0)
def test_verification_time_is_linear() -> None:
    """Eight times the records take less than 30 times the time; a quadratic check would take 64 times."""
    assert min(_seconds(12_000) for _ in range(3)) < 30 * _seconds(1_500)
