"""Compilation of programs to machine code, once per process, with a cache on disk.

Cached code is used only if it is complete and was made of this program by these files and this wasmtime. As
it is machine code, only the user may be able to write the cache. With a cache, compilation runs in another
process.
"""

from __future__ import annotations

import hashlib
import platform
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Protocol

import msgspec
import wasmtime

from lfield.vm.reference.step_compiler import PreparedProgram
from lfield.vm.wasm.lowering.module_lowering import WasmModule, lower_program
from lfield.vm.wasm.runtime.runtime_functions import runtime_text
from lfield.vm.wasm.wasm_compiler import compiler

#: The number of programs kept in memory: tests have many, a host has one.
CACHED_PROGRAMS = 16
_recent: OrderedDict[tuple[bytes, int], MachineCode] = OrderedDict()
#: The key of the runtime among the digests of programs.
_RUNTIME = b"runtime"
#: Packages whose files determine the code: the imports of `lowering`.
_MAKERS = ("lfield.vm", "lfield.bytecode")
#: The other imports of `lowering`, which do not affect the code: device kinds, errors and their numbers.
_NO_MAKERS = ("lfield.manifest", "lfield.errors", "lfield.exit_status")


class CodeCache(Protocol):
    """A store of code by name for this user, which compiles missing code."""

    def get(self, name: str) -> bytes | None:
        """The stored code, None if no trusted code is stored."""

    def put(self, name: str, data: bytes) -> None:
        """Store code, if possible."""

    def damaged(self, name: str, reason: str) -> None:
        """The result of `get` was corrupted; it is compiled again."""

    def compiled(self, texts: Sequence[str], reservation: int) -> Sequence[bytes]:
        """The machine code of each module, for memories with that reservation. Raises EngineUnavailable."""


class MachineCode(msgspec.Struct, frozen=True):
    """Machine code for memories with a reservation; `points` and `unsupported` are the module's."""

    compiled: wasmtime.Module
    points: dict[int, int]
    unsupported: dict[str, str]


class _StoredCode(msgspec.Struct, frozen=True, array_like=True):
    points: dict[int, int]
    unsupported: dict[str, str]
    machine_code: bytes


_stored_decoder = msgspec.msgpack.Decoder(_StoredCode)


def code_of(prepared: PreparedProgram, reservation: int, cache: CodeCache | None = None) -> MachineCode:
    """The code of a program: from memory, else from the cache, else compiled."""
    digest = prepared.program.digest
    return _codes({digest: lambda: lower_program(prepared)}, reservation, cache)[digest]


def runtime_of(
    reservation: int, cache: CodeCache | None = None, program: PreparedProgram | None = None
) -> wasmtime.Module:
    """The code of the runtime, the same for all programs; compiled together with the code of a `program`."""
    lowerings = {_RUNTIME: lambda: WasmModule(runtime_text(), {}, {})}
    if program is not None:
        lowerings[program.program.digest] = lambda: lower_program(program)
    return _codes(lowerings, reservation, cache)[_RUNTIME].compiled


def _codes(
    lowerings: Mapping[bytes, Callable[[], WasmModule]], reservation: int, cache: CodeCache | None
) -> dict[bytes, MachineCode]:
    """The code for each digest; missing code is compiled in one run."""
    known = {digest: _recent.pop((digest, reservation), None) for digest in lowerings}
    codes = {digest: code or _from_cache(digest, reservation, cache) for digest, code in known.items()}
    missing = {digest: lowerings[digest]() for digest, code in codes.items() if code is None}
    compiled = _compile(missing, reservation, cache)
    all_codes = {digest: code or compiled[digest] for digest, code in codes.items()}
    _recent.update({(digest, reservation): code for digest, code in all_codes.items()})
    while len(_recent) > CACHED_PROGRAMS:
        _recent.popitem(last=False)
    return all_codes


def _from_cache(digest: bytes, reservation: int, cache: CodeCache | None) -> MachineCode | None:
    """Code from the cache, if usable."""
    if cache is None:
        return None
    name = name_of(digest, reservation)
    data = cache.get(name)
    if data is None:
        return None
    try:
        return _read(name, data, reservation)
    except (ValueError, msgspec.DecodeError, wasmtime.WasmtimeError) as error:
        cache.damaged(name, str(error).partition("\n")[0])
        return None


def _compile(
    modules: Mapping[bytes, WasmModule], reservation: int, cache: CodeCache | None
) -> dict[bytes, MachineCode]:
    """Compile now, in the way that the cache determines."""
    engine = compiler(reservation)
    if cache is None:
        return {
            digest: MachineCode(wasmtime.Module(engine, module.text), module.points, module.unsupported)
            for digest, module in modules.items()
        }
    codes = {}
    machine_codes = (
        cache.compiled([module.text for module in modules.values()], reservation) if modules else ()
    )
    for (digest, module), machine_code in zip(modules.items(), machine_codes, strict=True):
        name = name_of(digest, reservation)
        content = msgspec.msgpack.encode(_StoredCode(module.points, module.unsupported, machine_code))
        cache.put(name, _header_of(name, content) + content)
        compiled = wasmtime.Module.deserialize(engine, machine_code)
        codes[digest] = MachineCode(compiled, module.points, module.unsupported)
    return codes


def _read(name: str, data: bytes, reservation: int) -> MachineCode:
    content = data[32:]
    if _header_of(name, content) != data[:32]:
        raise ValueError("its header does not match its name or content")
    found = _stored_decoder.decode(content)
    compiled = wasmtime.Module.deserialize(compiler(reservation), found.machine_code)
    return MachineCode(compiled, found.points, found.unsupported)


def _header_of(name: str, content: bytes) -> bytes:
    """The header of a file, which detects a renamed file."""
    return hashlib.sha256(name.encode() + b"\0" + content).digest()


def name_of(digest: bytes, reservation: int) -> str:
    """The file name of a program's code, which differs by program, lfield, wasmtime and processor."""
    made_by = version("wasmtime").encode(), platform.machine().encode(), _makers()
    made_of = (digest, str(reservation).encode(), *made_by)
    return hashlib.sha256(b"\0".join(made_of)).hexdigest()[:32]


@cache
def _makers() -> bytes:
    """A digest of the files that determine the code."""
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
