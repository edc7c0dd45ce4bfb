"""Signed bundles, and bundles changed after their signature, as a host with keys receives them."""

from __future__ import annotations

import hashlib
import random
import struct
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
from certificates import Team, made
from host_start import does_host_start
from network_callers import NOW

from lfield.authority import keystore
from lfield.authority.certificate_reader import der_of
from lfield.authority.identity import Right, uri_of
from lfield.authority.key_material import Keys
from lfield.authority.pem import private_in
from lfield.errors import BundleError
from lfield.mission import bundle
from lfield.mission.loader import load_mission

DAY = 86400.0
PURPOSE = b"lfield bundle\0"
#: Every part of the bundle has content.
FILES = {
    ".L": """resource Crane {
    Mavlink fc;
    init(string[] arg) { }
    portal hoist(real height) emit real { print("here"); return height; }
}
coordinator Foreman { init(string[] arg) { findLift()[0].lift(1.0); } }
""",
    ".dL": "//Foreman:tom@alpha?echo\n//Crane:near@bravo\n",
    ".capabilities.yaml": """registry: 1
providers: {Crane: {attributes: {payload: 50.0}, serves: {Lift: {portals: {lift: hoist, lower: hoist}}}}}
""",
    ".devices.yaml": """agents:
  near:
    devices:
      fc: {driver: mavlink, endpoint: "udp:127.0.0.1:14550", kind: copter, limits: {speed: 3, altitude: 20}}
""",
    ".access.yaml": "people: {anna: [observe]}\n",
}


class Bundles:
    """The signers of a bundle and its changed forms."""

    def __init__(self, place: Path) -> None:
        self._place = place
        for ending, text in FILES.items():
            (place / f"mission{ending}").write_text(text)
        self.data = bundle.encode(load_mission(place / "mission.dL"))
        (place / "mission.L").write_text(FILES[".L"].replace("here", "there"))
        self.another = bundle.encode(load_mission(place / "mission.dL"))
        self.team, self.other = Team(), Team()
        command = (Right.COMMAND,)
        person = self.team.person("rosa", *command)
        self.signers: dict[str, Keys | None] = {
            "commander": self.team.person("anna", *command),
            "operator": self.team.person("otto", Right.OPERATE),
            "host": self.team.host("bravo"),
            "ended": self.team.person("emil", *command, end=NOW - DAY),
            "revoked": person,
            "foreign": self.other.person("anna", *command),
            "selfsigned": self.team.with_(made("anna", [uri_of("person", "anna", command)])),
            "nobody": None,
        }
        keys = self.team.host("alpha")
        keystore.write_keys(place / "alpha", replace(keys, revoked=self.team.revoked(1, person)))

    def tried(self, who: str, what: str) -> bool:
        """Whether a host of the team runs the bundle."""
        keys = self.signers[who]
        # A signer whose certificate has expired meanwhile signed while it was valid.
        at = NOW - 2 * DAY
        shown = self.data if what in ("whole", "signature", "moved") else changed(self.data, what)
        signed = self.another if what == "moved" else self.data
        signature = sealed(signed, keys, at) if keys is not None else b""
        if what == "signature":
            signature = signature[:-1] + bytes([signature[-1] ^ 1]) if signature else b"\x01"
        return self._runs(bundle.with_signature(shown, signature))

    def runs_if_signed(self, part: str) -> bool:
        """Whether a host runs the changed bundle when an authorised person signs it."""
        keys, shown = self.signers["commander"], changed(self.data, part)
        assert keys is not None
        return self._runs(bundle.with_signature(shown, sealed(shown, keys, NOW - 2 * DAY)))

    def _runs(self, data: bytes) -> bool:
        file = self._place / "shown.lfm"
        file.write_bytes(data)
        return does_host_start(file, "alpha", self._place / "alpha", NOW)


@cache
def changed(data: bytes, part: str) -> bytes:
    """The bundle with one bit of a part changed such that it is a different, still valid bundle."""
    rng = random.Random(part)
    while True:
        found = resealed(data, part, rng)
        try:
            bundle.decode(found)
        except BundleError:
            continue
        return found


def sealed(data: bytes, keys: Keys, at: float) -> bytes:
    """A signature in the form of `authority.signature`, with any keys, also those without the right."""
    second = int(at)
    signed = private_in(keys.key).sign(PURPOSE + bundle.contents(data).digest + struct.pack("<Q", second))
    return msgspec.msgpack.encode([der_of(keys.certificate), second, signed])


def resealed(data: bytes, part: str, rng: random.Random) -> bytes:
    """The bundle with one bit of a part changed, and all digests recomputed."""
    parts = {name: bytes(value) for name, value in bundle.contents(data).parts.items()}
    value = bytearray(parts[part])
    value[rng.randrange(len(value))] ^= 1 << rng.randrange(8)
    parts[part] = bytes(value)
    rows = [(name, len(value), hashlib.sha256(value).digest()) for name, value in parts.items()]
    table = msgspec.msgpack.encode(rows)
    head = struct.pack("<4sHHI32s", b"LFMB", bundle.VERSION, 0, len(table), hashlib.sha256(table).digest())
    return head + table + b"".join(parts.values())
