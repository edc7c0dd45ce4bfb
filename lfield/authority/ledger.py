"""The folder of an authority, on the operator's computer: its key, and all that it has ever made.

    authority.pem  authority.key    its certificate and private key
    revoked.crl                     the newest revocation list
    issued/SERIAL.pem               every certificate that it has made, so that each can be revoked
    hosts/alpha  people/anna        key folders, as they are to be copied (folder.py)

A private key that was copied may be deleted in `hosts` and `people`: renewing does without. Whoever has
`authority.key` can make keys that may do everything. What is made is in `issued` before anybody can have it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple

from lfield.authority import folder as folders
from lfield.authority.believed import NOTABLE
from lfield.authority.identity import STRANGER, Identity, Right, with_brought
from lfield.authority.judge import Revoked, when
from lfield.authority.keys import AUTHORITY, MAX_PEM, REVOKED, Holder, Keys
from lfield.authority.making import Authority, new_authority, read_authority
from lfield.authority.reading import identity_in, revoked_in
from lfield.errors import InputFileError, KeysError
from lfield.text.files import read_bytes
from lfield.text.private import private_locked, write_private

KEY, ISSUED = "authority.key", "issued"
_FOLDERS: dict[Holder, str] = {"host": "hosts", "person": "people"}
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*|\[[0-9A-Fa-f:.]+(%[A-Za-z0-9._-]+)?\]", re.ASCII)
_SERIAL = re.compile(r"[1-9a-f][0-9a-f]{3,39}", re.ASCII)
#: One of so many digits is whole: numbers are drawn from 159 bits.
_WHOLE = 37


class Row(NamedTuple):
    """A certificate that was made, and what became of it."""

    who: Identity
    state: Literal["good", "ended", "revoked"]


class Made(NamedTuple):
    """Keys that were made or renewed, and the folder that has them."""

    who: Identity
    folder: Path


class Ledger:
    """An authority with its folder. Have it by `opened`, so that two commands do not write at once."""

    def __init__(self, folder: Path, authority: Authority) -> None:
        self.folder, self.authority = folder, authority
        self._list = folders.read_list(folder)
        if not self._list:
            raise KeysError(
                f"{folder / REVOKED} is not there: put a copy of it there, of the keys of any host; a list "
                "that begins anew would be taken for an older one"
            )
        with folders.of(folder / REVOKED):
            self.revoked = revoked_in(self._list, authority.certificate)

    def rows(self, at: float) -> list[Row]:
        """Everything that was made, by kind and name, the oldest first. Raises KeysError."""
        found = sorted(self._issued(), key=lambda who: (who.kind, who.name, who.begins, who.serial))
        return [Row(who, self._state(who, at)) for who in found]

    def make(self, holder: Holder, name: str, may: Iterable[Right], at: float, ends: float) -> Made:
        """Keys for a host or person who has none that are good. Raises KeysError."""
        if _NAME.fullmatch(name) is None:
            raise KeysError(
                f"'{name}' is no name for keys: it begins with a letter or digit, and has letters, digits, "
                "'.', '_' and '-'"
            )
        if good := [row.who for row in self._of(holder, name, at) if row.state == "good"]:
            raise KeysError(
                f"{good[-1]} has keys until {when(good[-1].ends)}: 'lfield keys renew {holder} {name}' "
                f"makes them last longer, 'lfield keys revoke {holder} {name}' ends them"
                + (", and then there can be some with other rights" if holder == "person" else "")
            )
        return self._issue(holder, name, with_brought(may), at, ends)

    def renew(self, holder: Holder, name: str, at: float, ends: float, *, new_key: bool = False) -> Made:
        """A certificate until later for the newest key of somebody, or for a new one; the old stays good.

        Raises KeysError.
        """
        found = [row.who for row in self._of(holder, name, at) if row.state != "revoked"]
        if not found:
            more = " --may ..." if holder == "person" else ""
            raise KeysError(
                f"{holder} {name} has no keys that are not revoked: 'lfield keys {holder} {name}{more}' "
                "makes some"
            )
        newest = max(found, key=lambda who: (who.begins, who.ends))
        old = b"" if new_key else self._certificate(newest.serial)
        return self._issue(holder, name, newest.may, at, ends, old)

    def renew_authority(self, at: float, ends: float) -> None:
        """A certificate of the authority until later, for the same key; all that it has made stays good."""
        self._see_time(at)
        self.authority = self.authority.renewed(at, ends)
        write_private(self.folder / AUTHORITY, self.authority.certificate, 0o644, durable=True)
        for folder in self._key_folders():
            write_private(folder / AUTHORITY, self.authority.certificate, 0o644)

    def revoke(self, holder: Holder, name: str, at: float) -> list[Identity]:
        """Put all certificates of somebody on the list. Raises KeysError when there is nothing to revoke."""
        found = [row.who for row in self._of(holder, name, at) if row.state != "revoked"]
        if not found:
            raise KeysError(f"{holder} {name} has no keys of this authority that are not revoked already")
        return self._revoke(found, at)

    def revoke_serial(self, serial: str, at: float) -> list[Identity]:
        """Put one certificate on the list, by the first digits of its number. Raises KeysError.

        By the whole number also one that is not known here: an authority that was put back from a copy knows
        nothing of what was made after it.
        """
        if _SERIAL.fullmatch(serial) is None:
            raise KeysError(f"'{serial}' is no number of a certificate: see 'lfield keys list'")
        found = [who for who in self._issued() if who.serial.startswith(serial)]
        if not found and len(serial) >= _WHOLE:
            found = [replace(STRANGER, serial=serial)]
        if len(found) != 1:
            raise KeysError(f"{len(found) or 'no'} certificates have a number that begins with {serial}")
        if found[0].serial in self.revoked.serials:
            raise KeysError(f"certificate {serial} of {found[0]} is revoked already")
        return self._revoke(found, at)

    def _revoke(self, found: list[Identity], at: float) -> list[Identity]:
        self._see_time(at)
        serials = self.revoked.serials.union(who.serial for who in found)
        # Also where a copy of the folder was put back, whose number is one that the hosts have had.
        number = max(self.revoked.number + 1, int(at))
        self.revoked = Revoked(number, serials, at)
        self._list = self.authority.revocation_list(self.revoked)
        folders.write_list(self.folder, self._list)
        for folder in self._key_folders():
            folders.write_list(folder, self._list)
        return found

    def _issue(
        self,
        holder: Holder,
        name: str,
        may: Iterable[Right],
        at: float,
        ends: float,
        renews: bytes = b"",
    ) -> Made:
        self._see_time(at)
        issued = self.authority.issue(holder, name, may=may, at=at, ends=ends, renews=renews)
        who = identity_in(issued.certificate, self.authority.certificate)
        write_private(self.folder / ISSUED / f"{who.serial}.pem", issued.certificate, 0o644, durable=True)
        folder = self.folder / _FOLDERS[holder] / name
        # A person passes it on with every command, so an empty one is left out.
        revoked = self._list if holder == "host" or self.revoked.number else b""
        keys = Keys(holder, self.authority.certificate, issued.certificate, issued.key, revoked)
        folders.write(folder, keys)
        return Made(who, folder)

    def _see_time(self, at: float) -> None:
        """What is made later must not begin earlier: a begin is our word that it was so late already."""
        last = max((who.begins for who in self._issued()), default=0.0)
        if at < max(last, self.revoked.at) - NOTABLE:
            raise KeysError(
                f"the clock of this computer says {when(at)}, and this authority has made something "
                f"{when(max(last, self.revoked.at))}: set the clock"
            )

    def _of(self, holder: Holder, name: str, at: float) -> list[Row]:
        return [row for row in self.rows(at) if (row.who.kind, row.who.name) == (holder, name)]

    def _state(self, who: Identity, at: float) -> Literal["good", "ended", "revoked"]:
        if who.serial in self.revoked.serials:
            return "revoked"
        return "ended" if at >= who.ends else "good"

    def _issued(self) -> Iterator[Identity]:
        for path in sorted((self.folder / ISSUED).glob("*.pem")):
            certificate = self._certificate(path.stem)
            with folders.of(path):
                who = identity_in(certificate, self.authority.certificate)
            yield who

    def _certificate(self, serial: str) -> bytes:
        try:
            return read_bytes(self.folder / ISSUED / f"{serial}.pem", MAX_PEM)
        except InputFileError as error:
            raise KeysError(str(error)) from None

    def _key_folders(self) -> list[Path]:
        """The folders that were made to be copied, as far as they are still there."""
        found = (self.folder / below for below in _FOLDERS.values())
        return sorted(path for below in found if below.is_dir() for path in below.iterdir() if path.is_dir())


def begin(folder: Path, at: float, ends: float) -> Ledger:
    """A new authority in a folder that has none, from now (`at`) until `ends`. Raises KeysError."""
    made = new_authority(at, ends)
    with private_locked(folder):
        if (folder / KEY).exists() or (folder / AUTHORITY).exists():
            raise KeysError(f"{folder} has an authority already: name another folder")
        write_private(folder / KEY, made.key, 0o600, durable=True)
        folders.write_list(folder, made.revocation_list(Revoked(at=at)))
        write_private(folder / AUTHORITY, made.certificate, 0o644, durable=True)
    return Ledger(folder, made)


@contextmanager
def opened(folder: Path) -> Iterator[Ledger]:
    """The authority in a folder, for this process alone. Raises KeysError."""
    if not (folder / AUTHORITY).exists():
        raise KeysError(f"{folder} has no authority: 'lfield keys init' makes one, --authority names another")
    with private_locked(folder):
        trusted, key = folders.read_trusted(folder), folders.read_secret(folder / KEY)
        with folders.of(folder):
            authority = read_authority(trusted, key)
        yield Ledger(folder, authority)
