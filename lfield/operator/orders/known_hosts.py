"""What this user's computer has learned of hosts, so that an order to stop needs one round trip.

For each host of a team: the epochs that an order must name, the round-trip time, and its certificate. It is
kept in `hosts` in the cache folder of the user. Nothing depends on it: where it is missing or wrong, a host
answers with a challenge, which costs a second round trip. A team is an authority, since all hosts of one have
certificates of the same.
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
from lfield.errors import NoHome, OutputFileError
from lfield.text.own_folders import cache_folder
from lfield.text.private import read_private, write_private
from lfield.wire.fields import Name
from lfield.wire.orders import Certificate, Epochs

#: So many hosts are remembered, those that were heard last.
MOST_HOSTS = 256
#: A larger file is not read, in bytes.
_MAX_FILE = 1 << 20
_FILE, _VERSION = "hosts", 1

Team = Annotated[bytes, Meta(min_length=16, max_length=16)]
#: A round trip that is no finite number of seconds up to an hour was not measured.
Trip = Annotated[float, Meta(gt=0.0, le=3600.0)]


class KnownHost(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A host: its epochs, the round trip in seconds where it was measured, and its certificate in DER."""

    epochs: Epochs = Epochs()
    trip: Trip | None = None
    certificate: Certificate = b""


class _Row(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    team: Team
    host: Name
    known: KnownHost


class _File(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    version: int
    rows: Annotated[list[_Row], Meta(max_length=MOST_HOSTS)]


_decoder = msgspec.msgpack.Decoder(_File)

_Hosts = OrderedDict[tuple[bytes, str], KnownHost]


class KnownHosts:
    """The hosts of one team. `authority` is the certificate of the team's authority in PEM."""

    def __init__(self, authority: bytes, hosts: _Hosts | None = None) -> None:
        self._team = hashlib.sha256(authority).digest()[:16]
        #: Those of all teams, the one that was heard last at the end.
        self._hosts: _Hosts = hosts if hosts is not None else OrderedDict()
        #: What was learned since it was read or saved.
        self._news: dict[tuple[bytes, str], None] = {}

    @classmethod
    def read(cls, authority: bytes) -> KnownHosts:
        """Those of the cache file; none where it cannot be read."""
        return cls(authority, _read())

    def of(self, host: str) -> KnownHost:
        """What is known of a host."""
        return self._hosts.get((self._team, host), KnownHost())

    def learn(
        self,
        host: str,
        *,
        epochs: Epochs | None = None,
        trip: float | None = None,
        certificate: bytes = b"",
    ) -> None:
        """Something was heard of a host. What is not given stays as it was."""
        known = before = self.of(host)
        if epochs is not None and epochs != Epochs():
            known = replace(known, epochs=epochs)
        if trip is not None and 0.0 < trip <= 3600.0:
            known = replace(known, trip=trip)
        if certificate:
            known = replace(known, certificate=certificate)
        if known != before:
            _put(self._hosts, (self._team, host), known)
            self._news[self._team, host] = None

    def seen(self, certificate: bytes, who: Identity) -> None:
        """A handshake has verified a certificate in DER."""
        if who.kind == "host":
            self.learn(who.name, certificate=certificate)

    def save(self) -> None:
        """Write what was learned into the cache file, beside what other commands have written meanwhile."""
        if not self._news:
            return
        hosts = _read()
        for key in self._news:
            if key in self._hosts:
                _put(hosts, key, self._hosts[key])
        self._news.clear()
        rows = [_Row(team, host, known) for (team, host), known in hosts.items()]
        with suppress(OSError, OutputFileError, NoHome):
            write_private(_path(), msgspec.msgpack.encode(_File(_VERSION, rows)))


def _put(hosts: _Hosts, key: tuple[bytes, str], known: KnownHost) -> None:
    hosts[key] = known
    hosts.move_to_end(key)
    while len(hosts) > MOST_HOSTS:
        hosts.popitem(last=False)


def _path() -> Path:
    return cache_folder() / _FILE


def _read() -> _Hosts:
    try:
        found = _decoder.decode(read_private(_path(), _MAX_FILE))
    except (OSError, OutputFileError, NoHome, msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return OrderedDict()
    if found.version != _VERSION:
        return OrderedDict()
    return OrderedDict(((row.team, row.host), row.known) for row in found.rows)
