"""Dump files: a block with everything `lfield inspect` needs to explain it, in one file.

"LFDP"  u16 version  u16 0  then a msgpack record
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import msgspec

from lfield.bytecode.encoding import decode as decode_program
from lfield.bytecode.encoding import encode as encode_program
from lfield.bytecode.program import Program
from lfield.errors import BlockError
from lfield.vm.agent import Member
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import Layouts
from lfield.vm.memory.soundness import Soundness

MAGIC = b"LFDP"
VERSION = 1
MAX_SIZE = 512 << 20


class Dump(msgspec.Struct, frozen=True, array_like=True):
    """An agent at one moment: its block, program, the team's ids, types and hosts, and why it was dumped."""

    host: str
    reason: str
    limit: int
    members: tuple[str, ...]
    types: tuple[str, ...]
    hosts: tuple[str, ...]
    program: bytes
    block: bytes


_HEADER = struct.Struct("<4sHH")
_decoder = msgspec.msgpack.Decoder(Dump)


def encode(
    host: str,
    reason: str,
    limit: int,
    team: Sequence[Member],
    hosts: tuple[str, ...],
    program: Program,
    block: Block,
) -> bytes:
    """The bytes of a dump file; `limit` is the agent's heap limit in bytes."""
    members, types = tuple(m.id for m in team), tuple(m.type for m in team)
    record = Dump(host, reason, limit, members, types, hosts, encode_program(program), bytes(block.image()))
    return _HEADER.pack(MAGIC, VERSION, 0) + msgspec.msgpack.encode(record)


def decode(data: bytes) -> tuple[Dump, Program, Block]:
    """A dump, its program and its block, all checked; raises BlockError and ProgramFileError."""
    if len(data) < _HEADER.size or data[:4] != MAGIC:
        raise BlockError("it does not begin as a dump file does")
    _, version, reserved = _HEADER.unpack_from(data)
    if version != VERSION or reserved:
        raise BlockError(f"it has format {version}, this lfield reads format {VERSION}")
    try:
        dump = _decoder.decode(memoryview(data)[_HEADER.size :])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BlockError(f"its record is malformed ({error})") from None
    program = decode_program(dump.program)
    checker = Soundness(program, Layouts(program), dump.types)
    return dump, program, checker.check_heap(dump.block, len(dump.block) // 8 + 1)
