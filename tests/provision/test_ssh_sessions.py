"""Sessions of ssh whose process ends at once or never: a program in the place of ssh."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield import event_loop
from lfield.errors import ProvisionError
from lfield.provision import ssh_connection
from lfield.provision.ssh_connection import SshConnection
from lfield.provision.ssh_errors import SshDestination


@pytest.fixture
def connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """`connection(script)`: a connection by an ssh that is a script of sh."""

    def made(script: str) -> SshConnection:
        ssh = tmp_path / "ssh"
        ssh.write_text(f"#!/bin/sh\n{script}\n")
        ssh.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
        return SshConnection("alpha", tmp_path / "socket")

    return made


def test_a_session_that_ends_before_it_has_read_its_files_is_an_error_of_this_robot_alone(connection) -> None:
    """uvloop raised RuntimeError, which ended the provisioning of all robots."""
    session = connection("echo 'tar: not found' >&2; exit 127")

    async def fail() -> int:
        failed = 0
        for _ in range(20):
            with pytest.raises(ProvisionError, match="tar: not found"):
                await session.run("tar -xf -", "wheels", bytes(1 << 20))
            failed += 1
        return failed

    assert event_loop.run(fail()) == 20


def test_a_session_gets_its_files(connection) -> None:
    session = connection("wc -c")
    assert event_loop.run(session.run("wc -c", "wheels", bytes(3 << 20))).strip() == str(3 << 20)
    assert event_loop.run(session.run("wc -c", "facts")).strip() == "0"


def test_a_login_shell_that_refuses_is_quoted(connection) -> None:
    session = connection("echo 'This account is currently not available.'; exit 1")
    with pytest.raises(ProvisionError, match="not available"):
        event_loop.run(session.open([SshDestination("10.77.0.11")]))


def test_a_login_shell_that_waits_for_input_is_not_waited_for(connection, monkeypatch) -> None:
    monkeypatch.setattr(ssh_connection, "LOGIN_TIMEOUT", 0.2)
    session = connection("exec sleep 60")
    with pytest.raises(ProvisionError, match="no login within"):
        event_loop.run(session.open([SshDestination("10.77.0.11")]))


def test_a_sudo_that_hangs_is_named(connection, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ssh_connection, "LOGIN_TIMEOUT", 0.2)
    session = connection("exec sleep 60")
    with pytest.raises(ProvisionError, match="sudo"):
        event_loop.run(session.read_access())
