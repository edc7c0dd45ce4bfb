"""A robot refuses a bundle whose devices need files that it does not have."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.certificate_reader import identity_in
from lfield.authority.identity import ALL_RIGHTS
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import SystemClock
from lfield.errors import BundleError
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.mission.relocation import companion_files, relocate
from lfield.service.bundle_receiver import BundleVerifier
from lfield.testing.keyring import Keyring

PROGRAM = "resource Sky { Mavlink fc; init(string[] arg) { } portal say() { } }\n"
DEVICES = """
agents:
  one: {devices: {fc: {driver: mavlink, endpoint: "udp:127.0.0.1:14550", kind: copter, signing_key: one.key}}}
  two: {devices: {fc: {driver: mavlink, endpoint: "udp:127.0.0.1:14560", kind: copter, system: 2}}}
"""


def test_only_the_files_of_the_host_s_own_devices_are_required(tmp_path: Path) -> None:
    keyring = Keyring(tmp_path / "keys")
    keyring.put("me", keyring.issue("person", "anna", *ALL_RIGHTS))
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("//Sky:one@alpha\n//Sky:two@bravo\n")
    (tmp_path / "mission.devices.yaml").write_text(DEVICES)
    (tmp_path / "one.key").write_bytes(bytes(32))
    (tmp_path / "one.key").chmod(0o600)
    mission = relocate(load_mission(tmp_path / "mission.dL"), tmp_path, tmp_path)
    assert (companion_files(mission), companion_files(mission, "bravo")) == (["one.key"], [])
    path = tmp_path / "mission.lfm"
    path.write_bytes(bundle.encode(mission))
    keyring.sign(path)

    def verified(host: str, folder: Path) -> str:
        keys = keyring.issue("host", host)
        own = identity_in(keys.certificate, keys.authority)
        admission = CertificateAdmission(keys, own, TrustedClock(SystemClock()))
        return BundleVerifier(host, keys, admission, folder)(path.read_bytes()).by

    empty = tmp_path / "empty"
    empty.mkdir()
    assert verified("bravo", empty) == "anna"
    assert verified("alpha", tmp_path) == "anna"
    with pytest.raises(BundleError, match=r"one\.key"):
        verified("alpha", empty)
    with pytest.raises(BundleError, match="has no host charlie"):
        verified("charlie", tmp_path)
