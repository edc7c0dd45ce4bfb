"""The findings of `lfield doctor` on the keys of a computer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from lfield.authority import keystore as folders
from lfield.authority.key_material import Keys
from lfield.authority.ledger import Ledger, create_ledger
from lfield.operator.key_health import health, local_keys_health

AT, DAY = 1795464000.0, 86400.0


@pytest.fixture
def ledger(tmp_path: Path) -> Ledger:
    return create_ledger(tmp_path / "authority", AT, AT + 3650 * DAY)


def told(folder: Path, at: float) -> tuple[str, str]:
    """The state, and the text after the path."""
    (finding,) = health(folder, at)
    return finding.state, finding.what.removeprefix(f"keys {folder}: ")


def test_an_expiry_is_reported_before_it_happens(ledger: Ledger) -> None:
    folder = ledger.make("host", "alpha", (), AT, AT + 90 * DAY).folder
    assert told(folder, AT) == ("ok", "host alpha, valid until 2027-02-21 20:00 UTC")
    assert told(folder, AT + 65.5 * DAY) == ("warning", "host alpha, expire in 24 days, 2027-02-21 20:00 UTC")
    assert told(folder, AT + 90 * DAY) == ("problem", "host alpha, expired 2027-02-21 20:00 UTC")
    assert told(folder, 0.0) == ("warning", "host alpha, not valid before 2026-11-23 20:00 UTC")
    (ended,) = health(folder, AT + 90 * DAY)
    assert "lfield keys renew host alpha" in ended.cure


def test_unusable_keys_are_a_problem_with_a_reason(ledger: Ledger, tmp_path: Path) -> None:
    alpha = ledger.make("host", "alpha", (), AT, AT + DAY)
    bravo = ledger.make("host", "bravo", (), AT, AT + DAY)
    ledger.revoke("host", "alpha", AT)
    assert told(alpha.folder, AT) == ("problem", "host alpha, revoked")
    own, others = (folders.read_keys(made.folder, "host") for made in (bravo, alpha))
    folders.write_keys(bravo.folder, Keys("host", own.authority, own.certificate, others.key))
    state, what = told(bravo.folder, AT)
    assert (state, "is not that of the certificate of host bravo" in what) == ("problem", True)
    assert told(tmp_path, AT) == ("problem", "not found")


def test_all_keys_of_this_computer_are_checked(
    ledger: Ledger, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "home"))
    (nothing,) = local_keys_health({}, AT, tmp_path / "none")
    assert (nothing.state, nothing.what[:7]) == ("note", "no keys")
    keys_folder = ledger.make("person", "anna", (), AT, AT + 90 * DAY)
    own_keys = tmp_path / "home" / "lfield" / "keys" / "me"
    folders.write_keys(own_keys, folders.read_keys(keys_folder.folder, "person"))
    (found,) = local_keys_health({}, AT, tmp_path / "none")
    assert (found.state, found.details[1]) == ("ok", "has no rights")


@pytest.mark.process
def test_authority_without_verification_and_a_host_without_keys_do_not_load_cryptography() -> None:
    """The cryptography package costs 10 MB of memory and 50 ms of start-up time."""
    authority = ("trusted_clock", "keystore", "identity", "peer_verification", "key_material")
    names = [*(f"lfield.authority.{name}" for name in authority), "lfield.host.process.host_process"]
    looked = f"""
import importlib, sys
for name in {names}:
    importlib.import_module(name)
print("cryptography" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", looked], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "False\n"
