"""The folder of a CA on the operator's computer: its key, and all certificates that it has issued.

    authority.pem  authority.key    its certificate and private key
    revoked.crl                     the newest revocation list
    issued/SERIAL.pem               every issued certificate, so that each can be revoked
    hosts/alpha  people/anna        key folders to be copied (keystore.py)

Private keys in `hosts` and `people` may be deleted after copying: renewing does not need them. A person with
`authority.key` can make keys with every right. A certificate is in `issued` before its keys are written.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal, NamedTuple

from msgspec.structs import replace

from lfield.authority import keystore as folders
from lfield.authority.certificate_authority import CertificateAuthority, new_authority, read_authority
from lfield.authority.certificate_reader import identity_in, revoked_in
from lfield.authority.identity import ANONYMOUS, Identity, Right, with_implied
from lfield.authority.key_material import AUTHORITY, MAX_PEM, REVOKED, Holder, Keys
from lfield.authority.peer_verification import RevocationList, format_time
from lfield.authority.trusted_clock import MIN_WARNING
from lfield.errors import InputFileError, KeysError
from lfield.text.input_files import read_bytes
from lfield.text.secure_files import lock_private_folder, write_private

KEY, ISSUED = "authority.key", "issued"
_FOLDERS: dict[Holder, str] = {"host": "hosts", "person": "people"}
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]*|\[[0-9A-Fa-f:.]+(%[A-Za-z0-9._-]+)?\]", re.ASCII)
_SERIAL = re.compile(r"[1-9a-f][0-9a-f]{3,39}", re.ASCII)
#: The length of a whole serial number in digits: they are drawn from 159 bits.
_SERIAL_LENGTH = 37


class LedgerRow(NamedTuple):
    """An issued certificate and its state."""

    identity: Identity
    state: Literal["good", "ended", "revoked"]


class LedgerKeys(NamedTuple):
    """Keys that were made or renewed, and their folder."""

    identity: Identity
    folder: Path


class Ledger:
    """A CA with its folder. Obtain it by `open_ledger`, which locks it against concurrent commands."""

    def __init__(self, folder: Path, authority: CertificateAuthority) -> None:
        self.folder, self.authority = folder, authority
        self._list = folders.read_crl(folder)
        if not self._list:
            raise KeysError(
                f"{folder / REVOKED} is missing: copy it there from the keys of any host; hosts refuse a new "
                "list, because its number would be lower"
            )
        with folders.errors_in(folder / REVOKED):
            self.revoked = revoked_in(self._list, authority.certificate)

    def rows(self, at: float) -> list[LedgerRow]:
        """Every issued certificate, by kind and name, oldest first. Raises KeysError."""
        found = sorted(
            self._issued(),
            key=lambda identity: (identity.kind, identity.name, identity.valid_from, identity.serial),
        )
        return [LedgerRow(identity, self._state(identity, at)) for identity in found]

    def make(self, holder: Holder, name: str, may: Iterable[Right], at: float, ends: float) -> LedgerKeys:
        """Make keys for a host or person without valid ones. Raises KeysError."""
        require_name(name)
        if valid := [row.identity for row in self._rows_of(holder, name, at) if row.state == "good"]:
            raise KeysError(
                f"{valid[-1]} has keys until {format_time(valid[-1].valid_until)}: 'lfield keys renew "
                f"{holder} {name}' "
                f"makes them last longer, 'lfield keys revoke {holder} {name}' ends them"
                + (", and then there can be some with other rights" if holder == "person" else "")
            )
        return self._issue(holder, name, with_implied(may), at, ends)

    def renew(
        self, holder: Holder, name: str, at: float, ends: float, *, new_key: bool = False
    ) -> LedgerKeys:
        """Issue a certificate with a later end for the newest key of a holder, or a new key; the old one
        stays valid.

        Raises KeysError.
        """
        found = [row.identity for row in self._rows_of(holder, name, at) if row.state != "revoked"]
        if not found:
            more = " --may ..." if holder == "person" else ""
            raise KeysError(
                f"{holder} {name} has no keys that are not revoked: 'lfield keys {holder} {name}{more}' "
                "makes some"
            )
        newest = max(found, key=lambda identity: (identity.valid_from, identity.valid_until))
        old = b"" if new_key else self._certificate(newest.serial)
        return self._issue(holder, name, newest.may, at, ends, old)

    def renew_authority(self, at: float, ends: float) -> None:
        """Extend the CA certificate with the same key; all issued certificates stay valid."""
        self._check_time(at)
        self.authority = self.authority.renewed(at, ends)
        write_private(self.folder / AUTHORITY, self.authority.certificate, 0o644, durable=True)
        for folder in self._key_folders():
            write_private(folder / AUTHORITY, self.authority.certificate, 0o644)

    def revoke(self, holder: Holder, name: str, at: float) -> list[Identity]:
        """Revoke all certificates of a holder. Raises KeysError when it has none to revoke."""
        found = [row.identity for row in self._rows_of(holder, name, at) if row.state != "revoked"]
        if not found:
            raise KeysError(f"{holder} {name} has no keys of this authority that are not revoked already")
        return self._revoke(found, at)

    def revoke_serial(self, serial: str, at: float) -> list[Identity]:
        """Revoke one certificate by the first digits of its serial number. Raises KeysError.

        A whole number may also be unknown here: a CA that was restored from a copy does not know the
        certificates that it issued after the copy.
        """
        if _SERIAL.fullmatch(serial) is None:
            raise KeysError(f"'{serial}' is not the number of a certificate: see 'lfield keys list'")
        found = [identity for identity in self._issued() if identity.serial.startswith(serial)]
        if not found and len(serial) >= _SERIAL_LENGTH:
            found = [replace(ANONYMOUS, serial=serial)]
        if len(found) != 1:
            raise KeysError(f"{len(found) or 'no'} certificates have a number that begins with {serial}")
        if found[0].serial in self.revoked.serials:
            raise KeysError(f"certificate {serial} of {found[0]} is revoked already")
        return self._revoke(found, at)

    def _revoke(self, identities: list[Identity], at: float) -> list[Identity]:
        self._check_time(at)
        serials = self.revoked.serials.union(identity.serial for identity in identities)
        # A number above that of any list that hosts may have, also after the folder was restored from a copy.
        number = max(self.revoked.number + 1, int(at))
        self.revoked = RevocationList(number, serials, at)
        self._list = self.authority.revocation_list(self.revoked)
        folders.write_crl(self.folder, self._list)
        for folder in self._key_folders():
            folders.write_crl(folder, self._list)
        return identities

    def _issue(
        self,
        holder: Holder,
        name: str,
        may: Iterable[Right],
        at: float,
        ends: float,
        renews: bytes = b"",
    ) -> LedgerKeys:
        self._check_time(at)
        issued = self.authority.issue(holder, name, may=may, at=at, ends=ends, renews=renews)
        identity = identity_in(issued.certificate, self.authority.certificate)
        write_private(
            self.folder / ISSUED / f"{identity.serial}.pem", issued.certificate, 0o644, durable=True
        )
        folder = self.folder / _FOLDERS[holder] / name
        # An operator sends the list with every command, so an empty one is omitted.
        revoked = self._list if holder == "host" or self.revoked.number else b""
        keys = Keys(holder, self.authority.certificate, issued.certificate, issued.key, revoked)
        folders.write_keys(folder, keys)
        return LedgerKeys(identity, folder)

    def _check_time(self, at: float) -> None:
        """Refuse a clock that went backwards: notBefore asserts that the time has passed."""
        last = max((identity.valid_from for identity in self._issued()), default=0.0)
        if at < max(last, self.revoked.at) - MIN_WARNING:
            raise KeysError(
                f"the clock of this computer shows {format_time(at)}, and this authority has issued keys "
                f"{format_time(max(last, self.revoked.at))}: set the clock"
            )

    def _rows_of(self, holder: Holder, name: str, at: float) -> list[LedgerRow]:
        return [row for row in self.rows(at) if (row.identity.kind, row.identity.name) == (holder, name)]

    def _state(self, identity: Identity, at: float) -> Literal["good", "ended", "revoked"]:
        if identity.serial in self.revoked.serials:
            return "revoked"
        return "ended" if at >= identity.valid_until else "good"

    def _issued(self) -> Iterator[Identity]:
        for path in sorted((self.folder / ISSUED).glob("*.pem")):
            certificate = self._certificate(path.stem)
            with folders.errors_in(path):
                identity = identity_in(certificate, self.authority.certificate)
            yield identity

    def _certificate(self, serial: str) -> bytes:
        try:
            return read_bytes(self.folder / ISSUED / f"{serial}.pem", MAX_PEM)
        except InputFileError as error:
            raise KeysError(str(error)) from None

    def _key_folders(self) -> list[Path]:
        """The key folders that were made for copying, as far as they exist."""
        found = (self.folder / below for below in _FOLDERS.values())
        return sorted(path for below in found if below.is_dir() for path in below.iterdir() if path.is_dir())


def require_name(name: str) -> None:
    """Refuse a name that is none of a host or person. Raises KeysError."""
    if _NAME.fullmatch(name) is None:
        raise KeysError(
            f"'{name}' is not a valid name: it begins with a letter or digit, and has letters, digits, "
            "'.', '_' and '-'"
        )


def issued_hosts(folder: Path) -> frozenset[str]:
    """The hosts for which the CA in a folder has issued keys; none if it cannot be read. Does not lock it."""
    with suppress(KeysError, InputFileError):
        authority = folders.read_trusted(folder)
        paths = (folder / ISSUED).glob("*.pem")
        holders = (identity_in(read_bytes(path, MAX_PEM), authority) for path in paths)
        with folders.errors_in(folder):
            return frozenset(identity.name for identity in holders if identity.kind == "host")
    return frozenset()


def create_ledger(folder: Path, at: float, ends: float) -> Ledger:
    """Create a CA in a folder that has none, valid from now (`at`) until `ends`. Raises KeysError."""
    ca = new_authority(at, ends)
    with lock_private_folder(folder):
        if (folder / KEY).exists() or (folder / AUTHORITY).exists():
            raise KeysError(f"{folder} has an authority already: name another folder")
        write_private(folder / KEY, ca.key, 0o600, durable=True)
        folders.write_crl(folder, ca.revocation_list(RevocationList(at=at)))
        write_private(folder / AUTHORITY, ca.certificate, 0o644, durable=True)
    return Ledger(folder, ca)


@contextmanager
def open_ledger(folder: Path) -> Iterator[Ledger]:
    """The CA in a folder, locked for this process. Raises KeysError."""
    if not (folder / AUTHORITY).exists():
        raise KeysError(f"{folder} has no authority: 'lfield keys init' makes one, --authority names another")
    with lock_private_folder(folder):
        trusted, key = folders.read_trusted(folder), folders.read_secret(folder / KEY)
        with folders.errors_in(folder):
            authority = read_authority(trusted, key)
        yield Ledger(folder, authority)
