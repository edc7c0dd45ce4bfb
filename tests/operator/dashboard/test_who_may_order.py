"""The buttons of an operator: by the certificate over a network, by the user on this computer."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from lfield.authority.identity import Right
from lfield.authority.key_material import Keys
from lfield.client.team_actions import TeamActions
from lfield.client.team_connection import TeamConnection
from lfield.mission.access.access_rules import NO_RULES, Access, PersonRule
from lfield.net.tcp_transport import TcpTransport
from lfield.operator.dashboard.event_stream.host_locator import HostLocator
from lfield.operator.targets import TargetTeam
from lfield.testing.keyring import Keyring


def barred(
    addresses: Mapping[str, str], keys: Keys | None = None, access: Access = NO_RULES
) -> Mapping[str, str]:
    reach = HostLocator(TargetTeam((), addresses), lambda: [])
    actions = TeamActions(
        TeamConnection(TcpTransport(1 << 20), reach, keys),
        None,  # type: ignore[arg-type]
        lambda: None,  # type: ignore[arg-type, return-value]
        access,
    )
    return actions.denied_orders


@pytest.mark.parametrize(
    ("may", "not_may"),
    [
        ((Right.OBSERVE,), {"stop", "lift", "pause", "resume"}),
        ((Right.OBSERVE, Right.STOP), {"lift", "resume"}),
        ((Right.OBSERVE, Right.STOP, Right.OPERATE), set()),
    ],
)
def test_rights_of_the_certificate_decide_on_the_buttons(
    may: tuple[Right, ...], not_may: set[str], tmp_path
) -> None:
    keys = Keyring(tmp_path).issue("person", "anna", *may)
    found = barred({"alpha": "10.0.0.5:8181"}, keys)
    assert set(found) == not_may
    assert all("lfield keys person anna --may" in reason for reason in found.values())


def test_access_rules_remove_buttons_but_never_stop(tmp_path: Path) -> None:
    keys = Keyring(tmp_path).issue("person", "anna", Right.OBSERVE, Right.STOP, Right.OPERATE)
    for names in ("anna", "others"):
        access = Access("mission.access.yaml", (PersonRule(names, (Right.OBSERVE,), 2),))
        found = barred({"alpha": "10.0.0.5:8181"}, keys, access)
        assert set(found) == {"lift", "resume"}
        assert all(f"mission.access.yaml:2 limits {names} to: observe" in reason for reason in found.values())
    access = Access("mission.access.yaml", (PersonRule("bob", (Right.OBSERVE,), 2),))
    assert barred({"alpha": "10.0.0.5:8181"}, keys, access) == {}


def test_the_user_of_a_host_has_all_buttons_and_other_users_get_the_reason(
    tmp_path: Path, monkeypatch
) -> None:
    address = tmp_path / "alpha.sock"
    address.write_text("")
    assert barred({"alpha": f"unix:{address}"}) == {}
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    monkeypatch.setattr(os, "getgroups", lambda: [])
    found = barred({"alpha": f"unix:{address}"})
    assert set(found) == {"stop", "lift", "pause", "resume"}
    assert "the user who runs the host has it" in found["stop"]


def test_a_button_that_one_host_accepts_stays(tmp_path: Path) -> None:
    address = tmp_path / "alpha.sock"
    address.write_text("")
    keys = Keyring(tmp_path / "keys").issue("person", "anna", Right.OBSERVE)
    assert barred({"alpha": f"unix:{address}", "beta": "10.0.0.5:8181"}, keys) == {}


def test_with_unknown_rights_the_hosts_decide() -> None:
    assert barred({"alpha": "10.0.0.5:8181"}) == {}
    assert barred({"alpha": "unix:/nowhere/alpha.sock"}) == {}
