"""Bundles that somebody has signed, and that were changed since, as they are shown to a host with keys."""

from __future__ import annotations

import hashlib
import struct
from pathlib import Path

import msgspec
from callers import NOW
from certificates import Team, made

from lfield.authority.identity import Right, uri_of
from lfield.authority.judge import Revoked
from lfield.authority.keys import Keys
from lfield.authority.pem import private_in
from lfield.authority.reading import der_of, fingerprint_in, identity_in
from lfield.errors import LfieldError
from lfield.mission import bundle
from lfield.mission.access.release import Release, taken
from lfield.mission.load import load_mission

DAY = 86400.0
PURPOSE = b"lfield bundle\0"
FILES = {
    ".L": 'resource Echo { init(string[] arg) { } portal say() { print("here"); } }\n'
    "coordinator Caller { init(string[] arg) { findEcho(arg[1]).say(); } }\n",
    ".dL": "//Caller:tom@alpha?echo\n//Echo:echo@bravo\n",
    ".access.yaml": "people: {anna: [observe]}\n",
}


class Bundles:
    """Who signs, and what becomes of it."""

    def __init__(self, folder: Path) -> None:
        for ending, text in FILES.items():
            (folder / f"mission{ending}").write_text(text)
        mission = load_mission(folder / "mission.dL")
        self.data = bundle.encode(mission)
        (folder / "mission.L").write_text(FILES[".L"].replace("here", "there"))
        self.another = bundle.encode(load_mission(folder / "mission.dL"))
        self.team, self.other = Team(), Team()
        self.authority = self.team.authority.certificate
        command = (Right.COMMAND,)
        self.signers: dict[str, Keys | None] = {
            "commander": self.team.person("anna", *command),
            "operator": self.team.person("otto", Right.OPERATE),
            "host": self.team.host("bravo"),
            "ended": self.team.person("emil", *command, end=NOW - DAY),
            "revoked": self.team.person("rosa", *command),
            "foreign": self.other.person("anna", *command),
            "selfsigned": self.team.with_(made("anna", [uri_of("person", "anna", command)])),
            "nobody": None,
        }
        gone = self.signers["revoked"]
        assert gone is not None
        self.revoked = Revoked(1, frozenset({identity_in(gone.certificate, self.authority).serial}), NOW)

    def tried(self, who: str, what: str) -> bool:
        """Whether a host of the team runs it."""
        keys = self.signers[who]
        # Whoever has ended meanwhile has signed while it was time.
        at = NOW - 2 * DAY
        signature = sealed(self.data, keys, at) if keys is not None else b""
        shown = self.data
        if what == "moved":
            shown, signature = self.data, sealed(self.another, keys, at) if keys is not None else b""
        elif what == "signature":
            signature = signature[:-1] + bytes([signature[-1] ^ 1]) if signature else b"\x01"
        elif what != "whole":
            shown = resealed(self.data, what)
        try:
            found = bundle.contents(bundle.with_signature(shown, signature))
            release = Release(found.digest, found.signature)
            taken(release, self.authority, fingerprint_in(self.authority), at=NOW, revoked=self.revoked)
        except LfieldError:
            return False
        return True


def sealed(data: bytes, keys: Keys, at: float) -> bytes:
    """A signature as `authority.signature` makes it, by whoever has keys: also by those who may not."""
    second = int(at)
    signed = private_in(keys.key).sign(PURPOSE + bundle.contents(data).digest + struct.pack("<Q", second))
    return msgspec.msgpack.encode([der_of(keys.certificate), second, signed])


def resealed(data: bytes, part: str) -> bytes:
    """The bundle with one bit of a part changed, and all digests as they must be then."""
    parts = {name: bytes(value) for name, value in bundle.contents(data).parts.items()}
    value = parts[part] or b"\0"
    parts[part] = bytes([value[0] ^ 1]) + value[1:]
    rows = [(name, len(value), hashlib.sha256(value).digest()) for name, value in parts.items()]
    table = msgspec.msgpack.encode(rows)
    head = struct.pack("<4sHHI32s", b"LFMB", bundle.VERSION, 0, len(table), hashlib.sha256(table).digest())
    return head + table + b"".join(parts.values())
