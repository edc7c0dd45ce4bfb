"""Keys for hosts that a test starts by itself, as on several computers.

    keys = Keyring(tmp_path / "keys")
    keys.give("alpha", "bravo")
    subprocess.run(["lfield", "up", "mission.lfm", "--host", "alpha", "--keys", keys.folder])

For tests only: the CA is deleted with the test. `lfield up --all` needs no keys.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from lfield.authority import keystore as folders
from lfield.authority.bundle_signature import sign_bundle
from lfield.authority.certificate_authority import new_authority
from lfield.authority.identity import ALL_RIGHTS, Right
from lfield.authority.key_material import Holder, Keys
from lfield.authority.peer_verification import RevocationList
from lfield.mission.bundle import contents, read_file, with_signature

#: Validity of a test CA and its certificates, in seconds.
VALIDITY = 7 * 86400.0


class Keyring:
    """A new CA. Its output is in `folder`: a folder per host, and `me` for the operator."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        now = time.time()
        self._authority = new_authority(now, now + VALIDITY)

    def give(self, *hosts: str) -> Path:
        """Issues keys for these hosts, and for this user with all rights; existing keys are kept."""
        for host in hosts:
            if not (self.folder / host).exists():
                self.put(host, self.issue("host", host))
        if not (self.folder / folders.OWN).exists():
            self.put(folders.OWN, self.issue("person", "operator", *ALL_RIGHTS))
        return self.folder

    def issue(self, holder: Holder, name: str, *may: Right, lasts: float = VALIDITY) -> Keys:
        """The keys of a host, or of a person with these rights."""
        now = time.time()
        issued = self._authority.issue(holder, name, may=may, at=now, ends=now + lasts)
        return Keys(holder, self._authority.certificate, issued.certificate, issued.key)

    def put(self, name: str, keys: Keys) -> None:
        """Writes keys into a folder in `folder`, replacing existing ones."""
        if keys.holder == "host" and not keys.revoked:
            keys = replace(keys, revoked=self.revocation_list(0))
        folders.write_keys(self.folder / name, keys)

    def sign(self, bundle: Path) -> None:
        """Signs a bundle in place, as this user: hosts with keys accept no other."""
        self.give()
        data, keys = read_file(bundle), folders.read_keys(self.folder / folders.OWN, "person")
        bundle.write_bytes(with_signature(data, sign_bundle(contents(data).digest, keys, time.time())))

    def revocation_list(self, number: int, *serials: str, at: float | None = None) -> bytes:
        """The revocation list of that number with these certificates; issued now, or at a time."""
        issued_at = time.time() if at is None else at
        return self._authority.revocation_list(RevocationList(number, frozenset(serials), issued_at))
