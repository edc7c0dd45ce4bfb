"""Cache of known hosts on the operator's computer, so that a stop order needs only one round trip.

For each host of a team: the epochs that an order must name, the round-trip time, and its certificate. The
cache is `hosts` in the user's cache folder. It is optional: if it is missing or wrong, a host answers with a
challenge, which costs a second round trip. A team is identified by its CA, which has signed the certificates
of all hosts.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from lfield.authority.identity import Identity
from lfield.errors import NoHomeFolder, OutputFileError
from lfield.text.secure_files import read_private, write_private
from lfield.text.user_dirs import cache_dir
from lfield.wire.fields import Name
from lfield.wire.order_messages import Certificate, Epochs

#: The number of cached hosts; the least recently used ones are dropped.
MAX_HOSTS = 256
#: A larger file is not read, in bytes.
_MAX_FILE = 1 << 20
_FILE, _VERSION = "hosts", 1

TeamHash = Annotated[bytes, Meta(min_length=16, max_length=16)]
#: A round trip that is not a finite number of seconds up to an hour is ignored.
RoundTripTime = Annotated[float, Meta(gt=0.0, le=3600.0)]


class KnownHost(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A host: its epochs, the round trip in seconds if measured, and its certificate in DER."""

    epochs: Epochs = Epochs()
    trip: RoundTripTime | None = None
    certificate: Certificate = b""


class _Row(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    team: TeamHash
    host: Name
    known: KnownHost


class _File(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    version: int
    rows: Annotated[list[_Row], Meta(max_length=MAX_HOSTS)]


_decoder = msgspec.msgpack.Decoder(_File)

_Hosts = OrderedDict[tuple[bytes, str], KnownHost]


class KnownHosts:
    """The hosts of one team. `authority` is the certificate of the team's CA in PEM."""

    def __init__(self, authority: bytes, hosts: _Hosts | None = None) -> None:
        self._team = hashlib.sha256(authority).digest()[:16]
        #: The hosts of all teams, the most recently used one at the end.
        self._hosts: _Hosts = hosts if hosts is not None else OrderedDict()
        #: Changes since the file was read or saved.
        self._changed: dict[tuple[bytes, str], None] = {}

    @classmethod
    def read(cls, authority: bytes) -> KnownHosts:
        """The hosts in the cache file; empty if it cannot be read."""
        return cls(authority, _read())

    def host(self, host: str) -> KnownHost:
        """The cached data of a host."""
        return self._hosts.get((self._team, host), KnownHost())

    def learn(
        self,
        host: str,
        *,
        epochs: Epochs | None = None,
        trip: float | None = None,
        certificate: bytes = b"",
    ) -> None:
        """Update a host. Omitted values stay unchanged."""
        known = before = self.host(host)
        if epochs is not None and epochs != Epochs():
            known = replace(known, epochs=epochs)
        if trip is not None and 0.0 < trip <= 3600.0:
            known = replace(known, trip=trip)
        if certificate:
            known = replace(known, certificate=certificate)
        if known != before:
            _store(self._hosts, (self._team, host), known)
            self._changed[self._team, host] = None

    def on_verified(self, certificate: bytes, identity: Identity) -> None:
        """Store a certificate in DER that a handshake has verified."""
        if identity.kind == "host":
            self.learn(identity.name, certificate=certificate)

    def save(self) -> None:
        """Merge the changes into the cache file, which other commands may have written meanwhile."""
        if not self._changed:
            return
        hosts = _read()
        for key in self._changed:
            if key in self._hosts:
                _store(hosts, key, self._hosts[key])
        self._changed.clear()
        rows = [_Row(team, host, known) for (team, host), known in hosts.items()]
        with suppress(OSError, OutputFileError, NoHomeFolder):
            write_private(_path(), msgspec.msgpack.encode(_File(_VERSION, rows)))


def _store(hosts: _Hosts, key: tuple[bytes, str], known: KnownHost) -> None:
    hosts[key] = known
    hosts.move_to_end(key)
    while len(hosts) > MAX_HOSTS:
        hosts.popitem(last=False)


def _path() -> Path:
    return cache_dir() / _FILE


def _read() -> _Hosts:
    try:
        found = _decoder.decode(read_private(_path(), _MAX_FILE))
    except (OSError, OutputFileError, NoHomeFolder, msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return OrderedDict()
    if found.version != _VERSION:
        return OrderedDict()
    return OrderedDict(((row.team, row.host), row.known) for row in found.rows)
