"""The pages of a journal: one for each thing that is kept, written over by its key; and their bytes.

A page is written as a msgpack array whose first item is its tag. `lfield/docs/formats.md` has the table of
all kinds, those to come included.
"""

from __future__ import annotations

import struct
import zlib
from typing import Literal, NamedTuple

import msgspec
from msgspec import Struct

from lfield.wire.coordinators import Outcome
from lfield.wire.fields import Count, Hash

#: The version of all pages that are written here. A page of a newer one is not read.
VERSION = 2

#: What is kept of a copy. FROZEN is not: nothing was sent, so it is the copy that last began to run here.
KeptState = Literal["ABSENT", "RUN", "PREPARED", "MOVED", "EXITED"]

_CHECKED = struct.Struct("<qdH")


class Key(NamedTuple):
    """Which page: its kind, and the agent or digest (in hex) and the number that it is about, if any."""

    kind: str
    name: str = ""
    number: int = 0


class CopyPage(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="copy"):
    """One start of one coordinator, seen from this host (mobility/copies.py).

    `sequence` is the highest transfer number that this start used or tried here. `kind` and `reason` are the
    refusal of that transfer, '' for none. `target` is where it was sent, and `memory` the identity of that
    host's journal, or of its process if it has none. `outcome`, `detail` and `ended_on` belong to EXITED.
    `program` is the hash of the program and deployment the block belongs to, b"" without a block; `block` its
    bytes, b"" for none. `doubt` is why the fate of a copy that was sent is not known, '' where it is.
    """

    agent: str
    generation: Count
    state: KeptState
    sequence: Count = 0
    hops: Count = 0
    kind: str = ""
    reason: str = ""
    target: str = ""
    memory: Count = 0
    outcome: Outcome | Literal[""] = ""
    detail: str = ""
    ended_on: str = ""
    program: Hash = b""
    block: bytes = b""
    doubt: str = ""


class BegunPage(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="begun"):
    """A portal call that a coordinator has begun here and fetches later (`together`; host/team/begun.py).

    `number` tells the calls of one start of it apart; `resource` and `portal` are names. `outcome` is ''
    while the call may be under way; `parcel` is what it gave or threw, as the machine packs it, of the
    mission with the hash `program`.
    """

    agent: str
    generation: Count
    number: Count
    resource: str
    portal: str
    outcome: Literal["", "done", "thrown"] = ""
    parcel: bytes = b""
    program: Hash = b""


class ReservationPage(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="reservation"):
    """The number of the last reservation of a resource here, and which start of an agent has it.

    `agent` is '' when nobody has.
    """

    resource: str
    number: Count
    agent: str = ""
    generation: Count = 0


class Starts(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="starts"):
    """How many starts this host has made: the counter that generations come from."""

    count: Count


class Run(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="run"):
    """Whether this host's run goes on at its next start. An orderly end with nothing left closes it."""

    open: bool


class BundlePage(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="bundle"):
    """The signed bundle that this host has begun, by its digest; b"" once it has ended in order, and
    so has every coordinator of the team, as this host has heard."""

    digest: Hash


class Paused(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="paused"):
    """Whether somebody has paused the mission on this host: no agent runs until it is resumed.

    `order` is the id of the last order to pause or to resume, b"" in pages of version 1.
    """

    on: bool
    order: bytes = b""


class Stopped(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="stopped"):
    """Why an emergency stop bars the devices of this host, '' when it was lifted.

    `order` is the id of the last order to stop or to lift, b"" for a lock-out and in pages of version 1.
    """

    reason: str
    order: bytes = b""


class Fence(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="fence"):
    """No copy of an earlier generation of this agent may run here any more."""

    agent: str
    generation: Count


class ProgramPage(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="program"):
    """What explains blocks: their program, once for each digest that pages name.

    `code` is a program file (bytecode/encoding.py). `members`, `types` and `hosts` are the ids and types of
    the team's agents and its hosts, in their order: proxies and trails are numbers in them.
    """

    digest: Hash
    code: bytes
    members: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    hosts: tuple[str, ...] = ()


Page = (
    CopyPage
    | BegunPage
    | ReservationPage
    | Starts
    | Run
    | BundlePage
    | Paused
    | Stopped
    | Fence
    | ProgramPage
)

_encode = msgspec.msgpack.Encoder().encode
_decoder: msgspec.msgpack.Decoder[Page] = msgspec.msgpack.Decoder(Page)


class PageError(Exception):
    """Bytes that are not the page that their key and their checksum promise. It never leaves this room."""


def key_of(page: Page) -> Key:
    """Under which key a page is kept."""
    match page:
        case CopyPage():
            return Key("copy", page.agent, page.generation)
        case BegunPage():
            return begun_key(page.agent, page.generation, page.number)
        case ReservationPage():
            return Key("reservation", page.resource)
        case Fence():
            return Key("fence", page.agent)
        case ProgramPage():
            return Key("program", page.digest.hex())
        case Starts():
            return Key("starts")
        case Run():
            return Key("run")
        case BundlePage():
            return Key("bundle")
        case Paused():
            return Key("paused")
        case Stopped():
            return Key("stopped")


def begun_key(agent: str, generation: int, number: int) -> Key:
    """Under which key the page of a call that was begun is kept."""
    return Key("begun", f"{generation} {agent}", number)


class NewerPage(PageError):
    """A sound page of a later version of lfield."""


class Entry(NamedTuple):
    """A page as it lies on the disk: `kept` at Unix time in seconds; `check` covers all the rest."""

    key: Key
    kept: float
    version: int
    body: bytes
    check: int


def entry(page: Page, kept: float) -> Entry:
    """A page, made ready for the disk."""
    key, body = key_of(page), _encode(page)
    return Entry(key, kept, VERSION, body, _check(key, kept, VERSION, body))


def page_of(found: Entry) -> Page:
    """The page of an entry. Raises PageError."""
    try:
        if found.check != _check(*found[:-1]):
            raise PageError("its checksum does not fit")
        if found.version > VERSION:
            raise NewerPage(f"it is of version {found.version}")
        page = _decoder.decode(found.body)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise PageError(f"it cannot be read: {error}") from None
    except (TypeError, ValueError, AttributeError, struct.error):
        raise PageError("it is not of the right kind") from None
    if key_of(page) != found.key:
        raise PageError("it lies in the place of another")
    return page


def _check(key: Key, kept: float, version: int, body: bytes) -> int:
    """The CRC-32 of all that an entry says, its place included."""
    start = zlib.crc32(f"{key.kind}\0{key.name}\0".encode())
    return zlib.crc32(body, zlib.crc32(_CHECKED.pack(key.number, kept, version), start))
