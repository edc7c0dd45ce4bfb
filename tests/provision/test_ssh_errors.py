"""The remedies for refusals of ssh, sudo and commands on a robot."""

from __future__ import annotations

import pytest

from lfield.provision.robot_facts import LoginAccess
from lfield.provision.robot_scripts import BUSY
from lfield.provision.ssh_connection import command_output
from lfield.provision.ssh_errors import (
    SshDestination,
    access_error,
    command_error,
    connection_error,
    is_unreachable,
)

ALPHA = SshDestination("10.0.0.11", "pi", 2222)


@pytest.mark.parametrize(
    ("message", "remedy"),
    [
        ("pi@10.0.0.11: Permission denied (publickey,password).", "ssh-copy-id -p 2222 pi@10.0.0.11"),
        ("Host key verification failed.", "ssh -p 2222 pi@10.0.0.11"),
        (
            "@ WARNING: REMOTE HOST IDENTIFICATION HAS CHANGED! @\nHost key verification failed.",
            "ssh-keygen -R 10.0.0.11",
        ),
        ("ssh: connect to host 10.0.0.11 port 22: No route to host", "addresses"),
        ("something else", "ssh -p 2222 pi@10.0.0.11"),
    ],
)
def test_refused_connection_names_the_remedy(message, remedy):
    error = connection_error("alpha", ALPHA, message)
    assert error.host == "alpha"
    assert remedy in error.advice


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("ssh: connect to host 10.0.0.11 port 22: Connection timed out", True),
        ("ssh: connect to host 10.0.0.11 port 22: Connection refused", True),
        ("ssh: Could not resolve hostname alpha.local: Name or service not known", True),
        ("kex_exchange_identification: Connection closed by remote host", True),
        ("Timeout, server 10.0.0.11 not responding.", True),
        ("pi@10.0.0.11: Permission denied (publickey).", False),
        ("Host key verification failed.", False),
    ],
)
def test_next_address_is_tried_only_for_unreachable_hosts(message, expected):
    assert is_unreachable(message) is expected


def test_sudo_with_a_password_names_the_missing_line():
    error = access_error("alpha", ALPHA, LoginAccess("pi", 1000, "password"))
    assert "pi ALL=(root) NOPASSWD: ALL" in error.advice
    assert "ssh -t -p 2222 pi@10.0.0.11" in error.advice
    advice = access_error("alpha", ALPHA, LoginAccess("pi", 1000, "tty")).advice
    assert "Defaults:pi !requiretty" in advice
    assert "NOPASSWD" not in advice
    assert "user: root" in access_error("alpha", ALPHA, LoginAccess("pi", 1000, "missing")).advice


@pytest.mark.parametrize("greeting", ["", "WELCOME\n", "hi", "WELCOME\nhi"])
def test_login_shell_output_is_removed_from_the_command_output(greeting):
    assert command_output(f"{greeting}lfield-provision-output\nuser\tpi\n") == "user\tpi\n"
    assert command_output(f"{greeting}lfield-provision-output\n") == ""


def test_concurrent_provisioning_is_reported():
    assert "another provision" in command_error("alpha", "wheels", BUSY, "").reason


@pytest.mark.parametrize(
    ("message", "remedy"),
    [
        ("tar: x: Cannot write: No space left on device\nerror", "free disk space"),
        ("ERROR: Could not install packages: [Errno 28] No space left on device", "free disk space"),
        ("mv: cannot move: Read-only file system", "card"),
        ("it failed", "continues"),
        ("fi: Command not found.", "chsh"),
        ("Unmatched ''.", "chsh"),
    ],
)
def test_failed_command_names_the_remedy(message, remedy):
    assert remedy in command_error("alpha", "wheels", 1, message).advice
