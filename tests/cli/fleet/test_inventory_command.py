"""`lfield inventory`: the contents of the file, and the addresses that answer."""

from __future__ import annotations

import shutil
import socket

import pytest
from robots import told

from lfield.cli.fleet.inventory import _finding
from lfield.operator.fleet.address_check import Endpoint, EndpointState
from lfield.testing.keyring import Keyring

pytestmark = pytest.mark.process


def state_of(said, host: str, purpose: str) -> tuple[str, str]:
    """The state of the only address of a host for a purpose, and the name in the certificate."""
    (found,) = [each for each in told(said)[host]["addresses"] if each["for"] == purpose]
    return found["state"], found["certificate"]


@pytest.mark.few(0)
def test_each_address_is_checked_and_a_host_without_an_answer_is_named(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up("alpha")
    with socket.create_server(("127.0.0.1", 0)) as ssh:
        extra = f", ssh_port: {ssh.getsockname()[1]}}}"
        team.inventory.write_text(team.inventory.read_text().replace("}", extra, 1))
        result = here("inventory", "check", "--json", status=69)
        assert state_of(result, "alpha", "service") == ("answers", "alpha")
        assert state_of(result, "alpha", "mission") == ("closed", "")
        assert state_of(result, "alpha", "ssh") == ("answers", "")
        assert state_of(result, "bravo", "service") == ("closed", "")
        assert [each["reached"] for each in told(result).values()] == [True, False]
        here("inventory", "check", "alpha", status=0)
    output = here("inventory", "check")
    assert (output.status, output.err) == (69, ["lfield: not reached: bravo"])
    _, service = team.ports["alpha"]
    assert output.out[1].split()[:4] == ["alpha", "127.0.0.1", str(service), "answers"]


@pytest.mark.few(0)
def test_a_wrong_address_is_named_by_its_certificate(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    ports = {host: service for host, (_, service) in team.ports.items()}
    text = team.inventory.read_text()
    text = text.replace(f"service_port: {ports['alpha']}", "service_port: S")
    text = text.replace(f"service_port: {ports['bravo']}", f"service_port: {ports['alpha']}")
    team.inventory.write_text(text.replace("S", str(ports["bravo"])))
    result = here("inventory", "check", "--json", status=69)
    assert state_of(result, "alpha", "service") == ("other-host", "bravo")
    assert state_of(result, "bravo", "service") == ("other-host", "alpha")
    assert not any(each["reached"] for each in told(result).values())
    output = here("inventory", "check")
    assert any(f"127.0.0.1:{ports['bravo']} is an address of bravo" in line for line in output.out)
    # Both have answered.
    assert output.err == [
        "lfield: bravo answered at an address of alpha",
        "lfield: alpha answered at an address of bravo",
    ]


def test_a_host_of_another_team_is_refused(lfield, here, robots) -> None:
    team = robots("alpha")
    team.up()
    other = Keyring(lfield.folder / "other").give("alpha") / "me"
    result = here("inventory", "check", "--keys", other, "--json", status=69)
    assert state_of(result, "alpha", "service") == ("refused", "")
    output = here("inventory", "check", "--keys", other)
    assert output.err == ["lfield: refused: alpha"]


def test_a_program_that_is_not_a_host_is_not_reached(lfield, here, robots) -> None:
    team = robots("alpha")
    with socket.create_server(("127.0.0.1", team.ports["alpha"][0])):
        result = here("inventory", "check", "--json")
    assert state_of(result, "alpha", "mission") == ("unreachable", "")
    assert told(result)["alpha"]["reached"] is False


def test_without_keys_only_connections_are_tried(lfield, here, robots) -> None:
    team = robots("alpha")
    team.up()
    shutil.rmtree(lfield.folder / "config/lfield/keys/me")
    result = here("inventory", "check", "--json", status=0)
    assert state_of(result, "alpha", "service") == ("answers", "")


def test_the_file_is_shown_as_parsed(lfield, here) -> None:
    lfield.write(
        "team.yaml",
        'hosts: {alpha: {addresses: ["fe80::1%wlan0", robot.lan:9000], user: pi, arch: aarch64,\n'
        '  python: "3.11", groups: [gpio], devices: a.yaml}, bravo: {addresses: [10.0.0.2]}}\n',
    )
    result = here("inventory", "show", "--inventory", "team.yaml", "--json", status=0)
    alpha = told(result)["hosts"]["alpha"]
    assert alpha["addresses"] == ["[fe80::1%wlan0]:8181", "robot.lan:9000"]
    assert alpha["service_addresses"] == ["[fe80::1%wlan0]:8182", "robot.lan:8182"]
    assert (alpha["user"], alpha["arch"], alpha["python"]) == ("pi", "aarch64", "3.11")
    assert alpha["devices"] == str(lfield.folder / "a.yaml")
    assert list(told(here("inventory", "show", "bravo", "--inventory", "team.yaml", "--json"))["hosts"]) == [
        "bravo"
    ]
    output = here("inventory", "show", "--inventory", "team.yaml")
    assert output.out[0] == "team.yaml"
    assert any(line.split()[:2] == ["bravo", "10.0.0.2:8181"] for line in output.out)


def test_an_unknown_host_and_a_missing_inventory_are_usage_errors(lfield, here) -> None:
    lfield.write("team.yaml", "hosts: {alpha: {addresses: [10.0.0.1]}}\n")
    here("inventory", "show", "alhpa", "--inventory", "team.yaml", status=64)
    here("inventory", "show", status=64)


def test_a_link_local_address_without_a_listener_is_explained() -> None:
    """The zone of a link-local address is an interface of the connecting computer."""
    closed = EndpointState("closed")
    assert "wlan0" in _finding(Endpoint("alpha", "mission", "[fe80::1%wlan0]:8181"), closed)
    assert _finding(Endpoint("alpha", "mission", "[fd00::1]:8181"), closed) == ""
    assert _finding(Endpoint("alpha", "mission", "[fe80::1%wlan0]:8181"), EndpointState("answers")) == ""


def test_an_unknown_key_is_reported_with_all_known_ones(lfield, here) -> None:
    file = lfield.write("team.yaml", "hosts: {alpha: {addresses: [127.0.0.1], port: 22}}\n")
    refused = here("inventory", "show", "--inventory", file, status=65)
    assert "ssh_port" in " ".join(refused.err)


def test_files_that_do_not_exist_are_named(lfield, here, robots) -> None:
    team = robots("alpha")
    more = ", devices: a.yaml, files: [here.dbc, b.dbc]}"
    team.inventory.write_text(team.inventory.read_text().replace("}", more))
    lfield.write("config/lfield/here.dbc", "")
    for command in (("inventory", "show"), ("status",)):
        text = " ".join(here(*command).err)
        assert "a.yaml for alpha" in text
        assert "b.dbc for alpha" in text
        assert "here.dbc" not in text
