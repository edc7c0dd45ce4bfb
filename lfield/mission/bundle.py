"""A bundle: a mission in one file (`mission.lfm`), built on the ground computer, run by robots.

    "LFMB"  u16 version  u16 size of the signature  u32 length of the table  32 bytes SHA-256 of the table
    table  parts  signature

The table is msgpack: for each part its name, its size and the SHA-256 of its bytes, in the order of the
parts. So the digest in the header covers all parts; the optional signature signs it
(`authority/bundle_signature.py`).

    program   the core of the program; its digest is the program's identity
    team      types, ids, hosts and arguments of all agents; its digest is that of the deployment
    registry  capabilities of the team (registry_part.py); empty when the program names no capability
    bindings  limits, devices, and the addresses of hosts
    drivers   manifests of the drivers of these devices
    access    access rules (access/access_rules.py); empty when there is no access file
    texts     name, warnings, sources and line maps, for messages

Encoding is deterministic. Decoding is safe for untrusted bytes: nothing is executed, every length and type is
checked, and the verifier checks the program before it is used.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from lfield.bytecode import encoding
from lfield.bytecode.program import Debug, Program
from lfield.capability.model import Registry
from lfield.driver.driver_index import DriverIndex, DriverInfo
from lfield.errors import BindingError, BundleError, InputFileError, ProgramFileError
from lfield.mission.access.access_rules import Access, decode_access, encode_access
from lfield.mission.access.signed_bundle import BundleId
from lfield.mission.bindings import Bindings, with_files
from lfield.mission.bundle_check import check_bindings, check_rows
from lfield.mission.mission import Mission, needed_devices
from lfield.mission.team import Team, TeamRow, encode_rows, team_of
from lfield.text.input_files import error_reason, read_head

#: The suffix of a bundle.
SUFFIX = ".lfm"
MAGIC = b"LFMB"
VERSION = 3
#: A larger file is rejected unread.
MAX_SIZE = 64 << 20

_HEADER = struct.Struct("<4sHHI32s")
#: The parts in order.
PARTS = ("program", "team", "registry", "bindings", "drivers", "access", "texts")


class PartEntry(NamedTuple):
    """A row of the table."""

    name: str
    size: int
    digest: bytes


class BindingsPart(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The part `bindings`, which a host may override. `addresses` are "host:port" by host."""

    bindings: Bindings
    addresses: dict[str, str]


class TextsPart(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The part `texts`."""

    name: str
    warnings: tuple[str, ...]
    debug: Debug


class BundleContents(NamedTuple):
    """The parts of a bundle, checked against their digests, and the digest of all.

    `signature` is not verified; empty for an unsigned bundle.
    """

    digest: bytes
    table: tuple[PartEntry, ...]
    parts: Mapping[str, memoryview]
    signature: bytes


_encoder = msgspec.msgpack.Encoder()
_table = msgspec.msgpack.Decoder(list[PartEntry])
_rows = msgspec.msgpack.Decoder(list[TeamRow])
_bound = msgspec.msgpack.Decoder(BindingsPart)
_drivers = msgspec.msgpack.Decoder(dict[str, DriverInfo])
_texts = msgspec.msgpack.Decoder(TextsPart)


def encode(mission: Mission) -> bytes:
    """The bytes of a bundle."""
    from lfield.mission.registry_part import encode_registry

    parts = (
        encoding.encode_core(mission.program),
        encode_rows(mission.team.rows),
        b"" if mission.registry is None else encode_registry(mission.registry),
        _encoder.encode(BindingsPart(mission.bindings, mission.team.addresses_by_host)),
        _encoder.encode(
            {name: driver.without_local_parts for name, driver in mission.drivers.by_driver.items()}
        ),
        encode_access(mission.access),
        _encoder.encode(TextsPart(mission.name, mission.warnings, mission.program.debug)),
    )
    rows = [PartEntry(name, len(p), hashlib.sha256(p).digest()) for name, p in zip(PARTS, parts, strict=True)]
    table = _encoder.encode(rows)
    header = _HEADER.pack(MAGIC, VERSION, 0, len(table), hashlib.sha256(table).digest())
    return b"".join((header, table, *parts))


def contents(data: bytes) -> BundleContents:
    """The parts of a bundle. Raises BundleError for other or damaged bytes."""
    if len(data) < _HEADER.size or data[:4] != MAGIC:
        raise BundleError("it does not start with the header of a bundle")
    if len(data) > MAX_SIZE:
        raise BundleError(f"it is larger than {MAX_SIZE >> 20} MiB")
    _, version, size, length, digest = _HEADER.unpack_from(data)
    if version != VERSION:
        raise BundleError(
            f"it has format {version}, this lfield reads format {VERSION}",
            "install the version of lfield that built it, or build it again with this one",
        )
    rest = memoryview(data)[_HEADER.size :]
    table, parts = rest[:length], rest[length : max(length, len(rest) - size)]
    if hashlib.sha256(table).digest() != digest:
        raise BundleError("it is damaged or truncated (the digest of its table does not match)")
    try:
        rows = tuple(_table.decode(table))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BundleError(f"the table of its parts is malformed ({error})") from None
    return BundleContents(digest, rows, _split(rows, parts), bytes(rest[length + len(parts) :]))


def with_signature(data: bytes, signature: bytes) -> bytes:
    """The bundle with another signature, or its first; its digest stays. Raises BundleError."""
    found = contents(data)
    magic, version, _, length, digest = _HEADER.unpack_from(data)
    header = _HEADER.pack(magic, version, len(signature), length, digest)
    return b"".join((header, data[_HEADER.size : len(data) - len(found.signature)], signature))


def _split(rows: tuple[PartEntry, ...], data: memoryview) -> dict[str, memoryview]:
    """The parts by name, after a check of their digests."""
    if tuple(row.name for row in rows) != PARTS:
        raise BundleError("its parts are not those of a bundle")
    if any(row.size < 0 for row in rows) or sum(row.size for row in rows) != len(data):
        raise BundleError("it is truncated, or followed by other data")
    found, at = {}, 0
    for row in rows:
        found[row.name] = part = data[at : at + row.size]
        at += row.size
        if hashlib.sha256(part).digest() != row.digest:
            raise BundleError(f"it is damaged (the digest of its {row.name} does not match)")
    return found


def decode(data: bytes) -> Mission:
    """The mission in the bytes of a bundle, fully checked. Raises BundleError."""
    parsed = contents(data)
    parts, release = parsed.parts, BundleId(parsed.digest, parsed.signature)
    texts: TextsPart = _decoded("texts", _texts, parts)
    try:
        program = encoding.decode_core(parts["program"], texts.debug)
    except ProgramFileError as error:
        raise BundleError(f"its program is invalid: {error.reason}") from None
    bound: BindingsPart = _decoded("bindings", _bound, parts)
    team = _team(_decoded("team", _rows, parts), program, bound.addresses)
    drivers = DriverIndex(_decoded("drivers", _drivers, parts))
    check_bindings(bound.bindings, needed_devices(program, team), drivers, team.hosts)
    registry, access = _registry(parts["registry"], bound.bindings), _access(parts["access"])
    return _check_recovery(
        Mission(texts.name, program, team, bound.bindings, drivers, registry, texts.warnings, access, release)
    )


def _check_recovery(mission: Mission) -> Mission:
    """The mission, after a check that its recovery members are named where required."""
    try:
        _ = mission.recovery
    except BindingError as error:
        raise BundleError(str(error)) from None
    return mission


def _decoded(name: str, decoder: msgspec.msgpack.Decoder[Any], parts: Mapping[str, memoryview]) -> Any:
    try:
        return decoder.decode(parts[name])
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise BundleError(f"its {name} cannot be decoded ({error})") from None


def _team(rows: list[TeamRow], program: Program, addresses: Mapping[str, str]) -> Team:
    check_rows(rows, program.units)
    kinds = {name: kind for name, kind in program.units.items() if kind != "class"}
    return team_of(rows, kinds, {}).at(addresses)


def _registry(data: memoryview, bindings: Bindings) -> Registry | None:
    if not data:
        return None
    # Only a mission that names a capability needs the checker of conditions.
    from lfield.mission.registry_part import check_stated, decode_registry

    try:
        registry = decode_registry(data)
        check_stated(bindings.attributes, registry)
        return registry
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise BundleError(f"its registry cannot be decoded ({error})") from None


def _access(data: memoryview) -> Access:
    try:
        return decode_access(data)
    except (msgspec.DecodeError, RecursionError, ValueError) as error:
        raise BundleError(f"its access rules cannot be decoded ({error})") from None


def read(path: Path, files: Path | None = None) -> Mission:
    """The mission in a file; paths of files in device options are relative to its folder, or to `files`.

    Raises InputFileError, and BundleError that names the file.
    """
    data = read_file(path)
    try:
        mission = decode(data)
    except BundleError as error:
        raise error.of(path) from None
    folder = path.resolve().parent if files is None else files.resolve()
    return mission.with_bindings(
        with_files(mission.bindings, mission.drivers, lambda file: str(folder / file))
    )


def read_file(path: Path) -> bytes:
    """The bytes of a file, at most one more than MAX_SIZE. Raises InputFileError."""
    try:
        return read_head(path, MAX_SIZE + 1)
    except (OSError, ValueError) as error:
        raise InputFileError(str(path), error_reason(error)) from None
