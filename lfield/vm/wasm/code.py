"""A program as machine code: compiled once in a process, and once on a computer where a cache keeps it.

What a cache gives is used only when it is whole and was made of this program by these very files and this
wasmtime. It is machine code: a cache must give nothing that anybody but its user could have written. Whoever
has a cache compiles elsewhere too.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Protocol

import msgspec
import wasmtime

from lfield.vm.reference.prepare import Prepared
from lfield.vm.wasm.compiling import compiler
from lfield.vm.wasm.lower.module import Module, module
from lfield.vm.wasm.runtime.functions import runtime_text

#: So many programs are kept in a process: tests have many of them, a host has one.
KEPT = 16
_recent: OrderedDict[tuple[bytes, int], Code] = OrderedDict()
#: What stands for the runtime among the digests of programs.
_RUNTIME = b"runtime"
#: The packages whose files say what code is made of a program: whatever `lower` imports.
_MAKERS = ("lfield.vm", "lfield.bytecode")
#: What it imports besides, which says nothing of code: kinds of devices, errors and their numbers.
_NO_MAKERS = ("lfield.manifest", "lfield.errors", "lfield.exits")


class Cache(Protocol):
    """Keeps the code of programs by name, for this user alone, and compiles what it has not."""

    def get(self, name: str) -> bytes | None:
        """What was put there, None if there is nothing that could be believed."""

    def put(self, name: str, data: bytes) -> None:
        """Keep this, if it can be."""

    def damaged(self, name: str, reason: str) -> None:
        """What `get` gave was not what was put; it is made again."""

    def compiled(self, texts: Sequence[str], reservation: int) -> Sequence[bytes]:
        """The machine code of each module, for memories with so many addresses. Raises NoEngine."""


@dataclass(frozen=True, slots=True)
class Code:
    """Machine code for memories with a number of reserved addresses; `points` and `left` are the module's."""

    compiled: wasmtime.Module
    points: dict[int, int]
    left: dict[str, str]


class _Kept(msgspec.Struct, frozen=True, array_like=True):
    points: dict[int, int]
    left: dict[str, str]
    machine_code: bytes


_kept = msgspec.msgpack.Decoder(_Kept)


def code_of(prepared: Prepared, reservation: int, kept: Cache | None = None) -> Code:
    """The code of a program: of this process, else of the cache, else made now."""
    digest = prepared.program.digest
    return _codes({digest: lambda: module(prepared)}, reservation, kept)[digest]


def runtime_of(
    reservation: int, kept: Cache | None = None, beside: Prepared | None = None
) -> wasmtime.Module:
    """The code of the runtime, the same for all programs; that of one `beside` it is made with it."""
    makers = {_RUNTIME: lambda: Module(runtime_text(), {}, {})}
    if beside is not None:
        makers[beside.program.digest] = lambda: module(beside)
    return _codes(makers, reservation, kept)[_RUNTIME].compiled


def _codes(
    makers: Mapping[bytes, Callable[[], Module]], reservation: int, kept: Cache | None
) -> dict[bytes, Code]:
    """The code for each digest; what is to be made is compiled in one go."""
    known = {digest: _recent.pop((digest, reservation), None) for digest in makers}
    codes = {digest: code or _found(digest, reservation, kept) for digest, code in known.items()}
    missing = {digest: makers[digest]() for digest, code in codes.items() if code is None}
    made = _made(missing, reservation, kept)
    whole = {digest: code or made[digest] for digest, code in codes.items()}
    _recent.update({(digest, reservation): code for digest, code in whole.items()})
    while len(_recent) > KEPT:
        _recent.popitem(last=False)
    return whole


def _found(digest: bytes, reservation: int, kept: Cache | None) -> Code | None:
    """What the cache has, where it can be used."""
    if kept is None:
        return None
    name = name_of(digest, reservation)
    data = kept.get(name)
    if data is None:
        return None
    try:
        return _read(name, data, reservation)
    except (ValueError, msgspec.DecodeError, wasmtime.WasmtimeError) as error:
        kept.damaged(name, str(error).partition("\n")[0])
        return None


def _made(modules: Mapping[bytes, Module], reservation: int, kept: Cache | None) -> dict[bytes, Code]:
    """Compiled now: where the cache says."""
    engine = compiler(reservation)
    if kept is None:
        return {
            digest: Code(wasmtime.Module(engine, made.text), made.points, made.left)
            for digest, made in modules.items()
        }
    codes = {}
    machine_codes = kept.compiled([made.text for made in modules.values()], reservation) if modules else ()
    for (digest, made), machine_code in zip(modules.items(), machine_codes, strict=True):
        name = name_of(digest, reservation)
        content = msgspec.msgpack.encode(_Kept(made.points, made.left, machine_code))
        kept.put(name, _seal(name, content) + content)
        compiled = wasmtime.Module.deserialize(engine, machine_code)
        codes[digest] = Code(compiled, made.points, made.left)
    return codes


def _read(name: str, data: bytes, reservation: int) -> Code:
    content = data[32:]
    if _seal(name, content) != data[:32]:
        raise ValueError("it is not what was written there")
    found = _kept.decode(content)
    compiled = wasmtime.Module.deserialize(compiler(reservation), found.machine_code)
    return Code(compiled, found.points, found.left)


def _seal(name: str, content: bytes) -> bytes:
    """What stands before the content: a file that was given the name of another is no file of that name."""
    return hashlib.sha256(name.encode() + b"\0" + content).digest()


def name_of(digest: bytes, reservation: int) -> str:
    """The name of a program's code: that of another program, lfield or wasmtime has another one."""
    made_of = (digest, str(reservation).encode(), version("wasmtime").encode(), _makers())
    return hashlib.sha256(b"\0".join(made_of)).hexdigest()[:32]


@cache
def _makers() -> bytes:
    """A digest of the files that say what code is made."""
    digest = hashlib.sha256()
    for package in _MAKERS:
        for name, data in sorted(_sources(files(package), package)):
            digest.update(f"{name}\0{len(data)}\0".encode() + data)
    return digest.digest()


def _sources(folder: Traversable, name: str) -> Iterator[tuple[str, bytes]]:
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _sources(entry, f"{name}/{entry.name}")
        elif entry.name.endswith((".py", ".wat")):
            yield f"{name}/{entry.name}", entry.read_bytes()
