"""Program files: a magic, a version, a checksum, then core and debug information.

    "LFLP"  u16 version  u16 0  32 bytes SHA-256 of all that follows  u32 length of core  core  debug

Decoding is safe for untrusted bytes: lengths and types are checked while decoding, no code is executed, and
the verifier checks the program before it is returned.
"""

from __future__ import annotations

import hashlib
import struct

import msgspec

from lfield.bytecode.program import Core, Debug, Program
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError

MAGIC = b"LFLP"
VERSION = 3
#: Programs of lfield 0.3, which lack some instructions and built-in classes.
OLD_VERSION = 2
#: The maximum size of a file; a larger one is not read.
MAX_SIZE = 16 << 20

_HEADER = struct.Struct("<4sHH32sI")
_encoder = msgspec.msgpack.Encoder()
_core = msgspec.msgpack.Decoder(Core)
_debug = msgspec.msgpack.Decoder(Debug)


#: The reason for records that cannot be decoded; the error has the decoder's exception as its cause.
DAMAGED = "the file is damaged: its records cannot be decoded"


def assemble(core: Core, debug: Debug) -> Program:
    """A program from its parts, verified; its identity is the hash of the encoded core."""
    program = Program(core, debug, hashlib.sha256(_encoder.encode(core)).digest())
    verify(program)
    return program


def encode(program: Program) -> bytes:
    """The bytes of a program file."""
    core, debug = encode_core(program), _encoder.encode(program.debug)
    body = core + debug
    return _HEADER.pack(MAGIC, VERSION, 0, hashlib.sha256(body).digest(), len(core)) + body


def encode_core(program: Program) -> bytes:
    """The core of a program alone; its SHA-256 is the program's identity."""
    return _encoder.encode(program.core)


def decode(data: bytes) -> Program:
    """A verified program from the bytes of a program file; raises ProgramFileError."""
    if len(data) < _HEADER.size or data[:4] != MAGIC:
        raise ProgramFileError("this is not a program file")
    if len(data) > MAX_SIZE:
        raise ProgramFileError(f"the file is larger than {MAX_SIZE >> 20} MiB")
    _, version, _, checksum, length = _HEADER.unpack_from(data)
    if version not in (OLD_VERSION, VERSION):
        raise ProgramFileError(
            f"the file has format {version}; this lfield reads formats {OLD_VERSION} and {VERSION}"
        )
    body = memoryview(data)[_HEADER.size :]
    if hashlib.sha256(body).digest() != checksum:
        raise ProgramFileError("the file is damaged: its checksum does not match")
    try:
        core, debug = _core.decode(body[:length]), _debug.decode(body[length:])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ProgramFileError(DAMAGED) from error
    return assemble(core, debug)


def decode_core(data: bytes | memoryview, debug: Debug) -> Program:
    """A verified program from its core and its debug information; raises ProgramFileError."""
    try:
        core = _core.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ProgramFileError(DAMAGED) from error
    return assemble(core, debug)
