"""A robot whose clock shows 1970 accepts bundles by the times of certificates and signatures."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.certificate_reader import identity_in
from lfield.authority.identity import ALL_RIGHTS, Right
from lfield.authority.key_material import Keys
from lfield.authority.trusted_clock import TrustedClock
from lfield.clock import ManualClock
from lfield.errors import SignatureError
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.service.bundle_receiver import BundleVerifier
from lfield.testing.keyring import Keyring

PROGRAM = "resource Post { init(string[] arg) { } portal say() { } }\n"


def signed(folder: Path, keyring: Keyring) -> bytes:
    """A bundle with one host."""
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("//Post:post@alpha\n")
    path = folder / "mission.lfm"
    path.write_bytes(bundle.encode(load_mission(folder / "mission.dL")))
    keyring.sign(path)
    return path.read_bytes()


def verifier(keys: Keys) -> BundleVerifier:
    own = identity_in(keys.certificate, keys.authority)
    return BundleVerifier(
        "alpha", keys, CertificateAdmission(keys, own, TrustedClock(ManualClock(0.0))), Path()
    )


def test_bundle_is_accepted_and_its_signature_advances_the_clock(tmp_path: Path) -> None:
    keyring = Keyring(tmp_path / "keys")
    keyring.put("me", keyring.issue("person", "anna", *ALL_RIGHTS))
    data = signed(tmp_path, keyring)
    info = verifier(keyring.issue("host", "alpha"))(data)
    assert info.by == "anna"
    assert abs(info.at - time.time()) < 600


def test_signer_without_the_right_is_refused_in_1970(tmp_path: Path) -> None:
    keyring = Keyring(tmp_path / "keys")
    keyring.put("me", keyring.issue("person", "maria", Right.COMMAND))
    data = signed(tmp_path, keyring)
    other = Keyring(tmp_path / "other")
    with pytest.raises(SignatureError):
        verifier(other.issue("host", "alpha"))(data)
