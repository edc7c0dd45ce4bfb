"""ssh sessions whose process ends early or hangs, with a script in place of ssh."""

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
    """`connection(script)`: a connection with a shell script as ssh."""

    def connection_by(script: str) -> SshConnection:
        ssh = tmp_path / "ssh"
        ssh.write_text(f"#!/bin/sh\n{script}\n")
        ssh.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
        return SshConnection("alpha", tmp_path / "socket")

    return connection_by


def test_early_end_of_a_session_is_an_error_of_that_robot_only(connection) -> None:
    """Regression: uvloop raised RuntimeError, which ended the provisioning of all robots."""
    session = connection("echo 'tar: not found' >&2; exit 127")

    async def count_failures() -> int:
        failed = 0
        for _ in range(20):
            with pytest.raises(ProvisionError, match="tar: not found"):
                await session.run("tar -xf -", "wheels", bytes(1 << 20))
            failed += 1
        return failed

    assert event_loop.run(count_failures()) == 20


def test_session_sends_its_input_to_the_command(connection) -> None:
    session = connection("wc -c")
    assert event_loop.run(session.run("wc -c", "wheels", bytes(3 << 20))).strip() == str(3 << 20)
    assert event_loop.run(session.run("wc -c", "facts")).strip() == "0"


def test_refusal_of_the_login_shell_is_quoted(connection) -> None:
    session = connection("echo 'This account is currently not available.'; exit 1")
    with pytest.raises(ProvisionError, match="not available"):
        event_loop.run(session.open([SshDestination("10.77.0.11")]))


def test_login_shell_that_waits_for_input_times_out(connection, monkeypatch) -> None:
    monkeypatch.setattr(ssh_connection, "LOGIN_TIMEOUT", 0.2)
    session = connection("exec sleep 60")
    with pytest.raises(ProvisionError, match="no login within"):
        event_loop.run(session.open([SshDestination("10.77.0.11")]))


@pytest.mark.parametrize("limit", [0.2, 0.0])
def test_hanging_sudo_times_out(connection, monkeypatch: pytest.MonkeyPatch, limit: float) -> None:
    """With a limit of 0 the time-out comes while ssh starts; no process may remain."""
    monkeypatch.setattr(ssh_connection, "LOGIN_TIMEOUT", limit)
    session = connection("exec sleep 60")
    with pytest.raises(ProvisionError, match="sudo"):
        event_loop.run(session.read_access())
