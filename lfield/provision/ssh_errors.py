"""The meaning of messages of ssh, sudo and the commands on a robot, as errors with the remedy. Pure."""

from __future__ import annotations

import re
from collections.abc import Sequence

from msgspec import Struct

from lfield.errors import ProvisionError
from lfield.provision.robot_facts import LoginAccess
from lfield.provision.robot_scripts import BUSY, LOCK_TIMEOUT


class SshDestination(Struct, frozen=True):
    """The destination of ssh: a name or address, with user and port from the inventory."""

    address: str
    user: str = ""
    port: int = 0

    def __str__(self) -> str:
        return f"{self.user}@{self.address}" if self.user else self.address

    def options(self) -> list[str]:
        """The options of ssh."""
        user = ["-l", self.user] if self.user else []
        return [*user, *(["-p", str(self.port)] if self.port else [])]

    def command(self, program: str = "ssh") -> str:
        """The command line for a person, of ssh or ssh-copy-id."""
        port = f"-p {self.port} " if self.port else ""
        return f"{program} {port}{self}"


#: Messages after which another address of the same robot may succeed.
_UNREACHABLE = re.compile(
    r"Connection (?:timed out|refused|reset)|Operation timed out|No route to host|Network is unreachable"
    r"|Could not resolve hostname|Name or service not known|Connection closed|not responding|Broken pipe"
    r"|kex_exchange_identification|banner exchange",
)


#: Messages of tcsh and csh, which do not accept the scripts.
_OTHER_SHELL = re.compile(r"^\S+: Command not found\.|^Unmatched '", re.MULTILINE)


def is_unreachable(message: str) -> bool:
    """Whether a message of ssh says that the robot was not reached at that address."""
    return _UNREACHABLE.search(message) is not None


def connection_error(host: str, destination: SshDestination, message: str) -> ProvisionError:
    """The error of a connection that ssh could not make or has lost."""
    if "REMOTE HOST IDENTIFICATION HAS CHANGED" in message:
        advice_text = f"ssh-keygen -R {destination.address}; then '{destination.command()}' once"
        return _error(host, "its host key has changed", f"if the robot was installed again: {advice_text}")
    if "Host key verification failed" in message:
        return _error(host, "its host key is unknown", f"run '{destination.command()}' once, and confirm it")
    if "Permission denied" in message or "Too many authentication failures" in message:
        user = destination.user or "the user of ssh"
        advice_text = f"run '{destination.command('ssh-copy-id')}', or load the key with ssh-add"
        return _error(host, f"no key of this desk is accepted for {user}", advice_text)
    if is_unreachable(message):
        reason = f"{destination} is unreachable: {_last_line(message)}"
        return _error(host, reason, "switch the robot on, or correct its addresses in the inventory")
    return _error(
        host, f"ssh to {destination} failed: {_last_line(message)}", f"try '{destination.command()}'"
    )


def joined_error(errors: Sequence[ProvisionError]) -> ProvisionError:
    """The error of all addresses of a robot, with the advice of the last one."""
    reasons = "; ".join(error.reason for error in errors)
    return ProvisionError(errors[-1].host, reasons, errors[-1].advice)


def access_error(host: str, destination: SshDestination, access: LoginAccess) -> ProvisionError:
    """The error of a user who cannot become root without a password."""
    if access.sudo == "missing":
        return _error(
            host, f"there is no sudo, and {access.user} is not root", "set `user: root`, or install sudo"
        )
    line = f"{access.user} ALL=(root) NOPASSWD: ALL"
    reason = f"sudo of {access.user} requires a password"
    if access.sudo == "tty":
        line, reason = f"Defaults:{access.user} !requiretty", f"sudo of {access.user} requires a terminal"
    command = destination.command("ssh -t")
    file = "/etc/sudoers.d/lfield-provision"
    advice_text = (
        f"{command} \"echo '{line}' | sudo tee {file}\"; remove that file when the robots are installed"
    )
    return _error(host, reason, advice_text)


def command_error(host: str, step: str, status: int, message: str) -> ProvisionError:
    """The error of a command that has failed on the robot."""
    if "No space left on device" in message or "Disk quota exceeded" in message:
        advice_text = "free disk space on the robot (sudo apt-get clean), and run provision again"
        return _error(host, f"{step}: the disk is full", advice_text)
    if "Read-only file system" in message:
        advice_text = "check its card (dmesg), and run provision again"
        return _error(host, f"{step}: the disk is read-only", advice_text)
    if status == BUSY and not message.strip():
        reason = f"{step}: another provision has been running on the robot for {LOCK_TIMEOUT} s"
        return _error(host, reason, "wait for it, or end it there, and run provision again")
    if _OTHER_SHELL.search(message):
        reason = f"{step}: the login shell of the user is no POSIX shell: {_last_line(message)}"
        return _error(host, reason, "set another one on the robot: sudo chsh -s /bin/bash USER")
    reason = _last_line(message) or f"exit status {status}"
    return _error(host, f"{step}: {reason}", "correct it, and run provision again: it continues")


def _error(host: str, reason: str, advice: str) -> ProvisionError:
    return ProvisionError(host, reason, advice)


def _last_line(message: str) -> str:
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return lines[-1] if lines else ""
