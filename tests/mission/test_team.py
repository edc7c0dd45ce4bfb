from __future__ import annotations

import pytest

from lfield.errors import UsageError
from lfield.lang.deployment import parse_deployment
from lfield.mission.team import Team, parse_maps, team_of


def team(text: str) -> Team:
    deployment, _ = parse_deployment(text, "mission.dL", None)
    assert deployment is not None
    return team_of(deployment.rows, deployment.kinds, deployment.ports)


def test_hosts_are_found_by_name() -> None:
    members = team("//Arm:a@olive\n//Arm:b@ficus")
    assert members.find_host("ficus") == "ficus"
    with pytest.raises(UsageError, match=r"no host 'oliv': it has olive and ficus; did you mean 'olive'"):
        members.find_host("oliv")


def test_hosts_have_addresses() -> None:
    members = team("//Arm:a@olive\n//Arm:b@ficus:9000")
    assert members.addresses_by_host == {"olive": "olive:8181", "ficus": "ficus:9000"}
    moved = members.at({"olive": "10.0.0.1:1", "absent": "10.0.0.2:2"})
    assert moved.addresses == ("10.0.0.1:1", "ficus:9000")
    assert moved.deployment == members.deployment


def test_a_witness_is_a_host_without_agents() -> None:
    members = team("//@elm:9000\n//Arm:a@olive\n//Arm:b@ficus\n//@oak")
    assert members.hosts == ("olive", "ficus", "elm", "oak")
    assert members.addresses_by_host["elm"] == "elm:9000"
    assert [(m.id, m.number, m.host) for m in members.members] == [("a", 0, 0), ("b", 1, 1)]
    assert not members.members_on(members.number("elm"))
    assert team_of(members.rows, {"Arm": "resource"}, {}).deployment == members.deployment


def test_maps_are_parsed() -> None:
    members = team("//Arm:a@olive")
    assert parse_maps(["olive=10.0.0.1:1"], members) == {"olive": "10.0.0.1:1"}
    for word in ("olive", "olive=10.0.0.1", "olive=10.0.0.1:0", "olive=:1", "olive=x:70000"):
        with pytest.raises(UsageError, match="write it as NAME=ADDR:PORT"):
            parse_maps([word], members)
    with pytest.raises(UsageError, match="has no host 'ficus'"):
        parse_maps(["ficus=10.0.0.1:1"], members)
