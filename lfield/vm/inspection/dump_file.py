"""Dump file format: a block with all data that `lfield inspect` needs.

    "LFDP"  u16 version  u16 0  u32 CRC-32 of the record  then the record in msgpack; numbers little-endian

Version 1, of lfield 0.3, has no checksum.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import msgspec

from lfield.bytecode.encoding import decode as decode_program
from lfield.bytecode.encoding import encode as encode_program
from lfield.bytecode.program import Program
from lfield.errors import BlockError
from lfield.vm.agent import TeamMember
from lfield.vm.memory.block import Block
from lfield.vm.memory.block_verifier import BlockVerifier
from lfield.vm.memory.layout import Layouts

MAGIC = b"LFDP"
VERSION = 2
MAX_SIZE = 512 << 20


class Dump(msgspec.Struct, frozen=True, array_like=True):
    """An agent at one moment: block, program, the team's ids, types and hosts, and the reason of the dump."""

    host: str
    reason: str
    limit: int
    members: tuple[str, ...]
    types: tuple[str, ...]
    hosts: tuple[str, ...]
    program: bytes
    block: bytes


_HEADER = struct.Struct("<4sHH")
_CHECKSUM = struct.Struct("<I")
_decoder = msgspec.msgpack.Decoder(Dump)


def encode(
    host: str,
    reason: str,
    limit: int,
    team: Sequence[TeamMember],
    hosts: tuple[str, ...],
    program: Program,
    block: Block,
) -> bytes:
    """The bytes of a dump file; `limit` is the agent's heap limit in bytes."""
    members, types = tuple(m.id for m in team), tuple(m.type for m in team)
    dump = Dump(host, reason, limit, members, types, hosts, encode_program(program), bytes(block.image()))
    record = msgspec.msgpack.encode(dump)
    return b"".join((_HEADER.pack(MAGIC, VERSION, 0), _CHECKSUM.pack(zlib.crc32(record)), record))


def decode(data: bytes) -> tuple[Dump, Program, Block]:
    """A verified dump, its program and its block. Raises BlockError and ProgramFileError."""
    if len(data) < _HEADER.size or data[:4] != MAGIC:
        raise BlockError("it does not start with the header of a dump file")
    _, version, reserved = _HEADER.unpack_from(data)
    if version not in (1, VERSION) or reserved:
        raise BlockError(f"it has format {version}, this lfield reads format {VERSION}")
    record = memoryview(data)[_HEADER.size :]
    try:
        dump = _decoder.decode(record if version == 1 else _checked(record))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BlockError(f"its record is malformed ({error})") from None
    return dump, *decode_program_and_block(dump.program, dump.types, dump.block)


def decode_program_and_block(code: bytes, types: Sequence[str], block: bytes) -> tuple[Program, Block]:
    """A verified program file and a block of it; `types` are the types of the team's agents.

    Raises BlockError and ProgramFileError.
    """
    program = decode_program(code)
    checker = BlockVerifier(program, Layouts(program), types)
    return program, checker.check_heap(block, len(block) // 8 + 1)


def _checked(data: memoryview) -> memoryview:
    """The data after the leading checksum. Raises BlockError."""
    record = data[_CHECKSUM.size :]
    if len(data) < _CHECKSUM.size or zlib.crc32(record) != _CHECKSUM.unpack_from(data)[0]:
        raise BlockError(
            "it is damaged: its checksum does not match; copy it again from the host that wrote it"
        )
    return record
