"""The keys of hosts that `lfield provision` installs."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from lfield.authority.ledger import create_ledger, open_ledger
from lfield.errors import KeysError
from lfield.provision.plan import needs_new_key
from lfield.provision.robot_facts import RobotFacts, parse_facts
from lfield.provision.team_keys import (
    RENEWAL,
    VALIDITY,
    has_authority,
    planned_keys,
    replaced_keys,
    team_keys,
)

NOW = 1_800_000_000.0
FACTS = parse_facts("time\t0\nmachine\taarch64\n")


@pytest.fixture
def authority(tmp_path) -> Path:
    folder = tmp_path / "authority"
    create_ledger(folder, NOW, NOW + 20 * VALIDITY)
    return folder


def files(keys) -> dict[str, bytes]:
    return {file.path.rpartition("/")[2]: file.data for file in keys}


def robot_with(keys) -> RobotFacts:
    return replace(FACTS, files={file.path: file.sha256 for file in keys})


def test_keys_are_created_once(authority):
    first = team_keys(authority, ["alpha", "bravo"], NOW)
    assert set(files(first["alpha"])) == {"authority.pem", "host.pem", "host.key", "revoked.crl"}
    assert {file.mode for file in first["alpha"] if file.path.endswith(".key")} == {"600"}
    assert {file.owner for file in first["alpha"]} == {"lfield:lfield"}
    assert team_keys(authority, ["alpha", "bravo"], NOW + 1) == first


def test_keys_are_renewed_before_and_after_their_expiry(authority):
    first = files(team_keys(authority, ["alpha"], NOW)["alpha"])
    assert files(team_keys(authority, ["alpha"], NOW + VALIDITY - RENEWAL - 1)["alpha"]) == first
    for later in (NOW + VALIDITY - RENEWAL, NOW + 3 * VALIDITY):
        renewed = files(team_keys(authority, ["alpha"], later)["alpha"])
        assert renewed["host.pem"] != first["host.pem"]
        assert renewed["host.key"] == first["host.key"]


def test_revoked_keys_are_an_error_and_not_replaced(authority):
    team_keys(authority, ["alpha"], NOW)
    with open_ledger(authority) as ledger:
        ledger.revoke("host", "alpha", NOW)
    with pytest.raises(KeysError, match="revoked"):
        team_keys(authority, ["alpha"], NOW)


def test_revocation_list_is_installed_with_the_keys(authority):
    first = files(team_keys(authority, ["alpha", "bravo"], NOW)["alpha"])
    with open_ledger(authority) as ledger:
        ledger.revoke("host", "bravo", NOW)
    assert files(team_keys(authority, ["alpha"], NOW)["alpha"])["revoked.crl"] != first["revoked.crl"]


def test_private_key_that_is_only_on_the_robot_is_kept(authority):
    all_keys = team_keys(authority, ["alpha"], NOW)["alpha"]
    (authority / "hosts/alpha/host.key").unlink()
    without_private_key = team_keys(authority, ["alpha"], NOW)["alpha"]
    assert set(files(without_private_key)) == set(files(all_keys)) - {"host.key"}
    assert not needs_new_key(robot_with(all_keys), without_private_key)
    assert needs_new_key(FACTS, without_private_key)
    assert not needs_new_key(FACTS, all_keys)
    assert not needs_new_key(FACTS, ())
    new_keys = replaced_keys(authority, "alpha", NOW + 1)
    assert files(new_keys)["host.key"] != files(all_keys)["host.key"]


def test_dry_run_creates_no_keys(authority):
    planned = planned_keys(authority, ["alpha"])["alpha"]
    assert "host.pem" in files(planned)
    assert not (authority / "hosts").exists()
    created = team_keys(authority, ["alpha"], NOW)
    assert planned_keys(authority, ["alpha"]) == created
    assert has_authority(authority)
    assert not has_authority(authority / "other")
