"""Keys for hosts that a test starts by itself, as it would start them on several computers.

    keys = Keyring(tmp_path / "keys")
    keys.give("alpha", "bravo")
    subprocess.run(["lfield", "up", "mission.lfm", "--host", "alpha", "--keys", keys.folder])

Nothing of it is for robots: the authority is gone with the test. `lfield up --all` needs none of this.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from lfield.authority import folder as folders
from lfield.authority.identity import ALL, Right
from lfield.authority.judge import Revoked
from lfield.authority.keys import Holder, Keys
from lfield.authority.making import new_authority
from lfield.authority.signature import sign
from lfield.mission.bundle import contents, read_file, with_signature

#: Seconds that an authority of a test lasts, and what it makes.
LASTS = 7 * 86400.0


class Keyring:
    """A new authority. What it makes is in `folder`: a folder for each host, and `me` for whoever asks."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        now = time.time()
        self._authority = new_authority(now, now + LASTS)

    def give(self, *hosts: str) -> Path:
        """Keys for these hosts, and for this user, who may do everything; those that have some keep them."""
        for host in hosts:
            if not (self.folder / host).exists():
                self.put(host, self.made("host", host))
        if not (self.folder / folders.ME).exists():
            self.put(folders.ME, self.made("person", "operator", *ALL))
        return self.folder

    def made(self, holder: Holder, name: str, *may: Right, lasts: float = LASTS) -> Keys:
        """The keys of a host, or of a person who may do this."""
        now = time.time()
        issued = self._authority.issue(holder, name, may=may, at=now, ends=now + lasts)
        return Keys(holder, self._authority.certificate, issued.certificate, issued.key)

    def put(self, name: str, keys: Keys) -> None:
        """Keys into a folder in `folder`, in place of those that are there."""
        if keys.holder == "host" and not keys.revoked:
            keys = replace(keys, revoked=self.listed(0))
        folders.write(self.folder / name, keys)

    def sign(self, bundle: Path) -> None:
        """Sign a bundle in its place, as this user: hosts with keys take no other."""
        self.give()
        data, keys = read_file(bundle), folders.read(self.folder / folders.ME, "person")
        bundle.write_bytes(with_signature(data, sign(contents(data).digest, keys, time.time())))

    def listed(self, number: int, *serials: str, at: float | None = None) -> bytes:
        """The revocation list of that number, with these certificates on it; made now, or then."""
        made = time.time() if at is None else at
        return self._authority.revocation_list(Revoked(number, frozenset(serials), made))
