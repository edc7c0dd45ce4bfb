"""Holes planted in a copy of lfield, one by one: a cell of the security matrix must fail with each.

A hole without a failing cell is a path that the matrix does not test.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class Hole:
    """Text that occurs once in a file of lfield, and its replacement; the cells of `ways` must fail."""

    name: str
    file: str
    stands: str
    becomes: str
    ways: str

    @property
    def broken(self) -> str:
        """The change, for the catalogue."""
        new, old = (" ".join(text.split()) for text in (self.becomes, self.stands))
        return f"`{self.file}`: `{new or 'nothing'}` for `{old}`"


HOLES = (
    Hole(
        "portal rules are not applied",
        "vm/portal_calls.py",
        "if (rules := scheduler.hooks.rules) is not None and (reason",
        "if False and (rules := scheduler.hooks.rules) is not None and (reason",
        "from_a_coordinator",
    ),
    Hole(
        "the VM gets no portal rules",
        "host/core.py",
        "hooks = VmHooks(rules=rules, liveness=self.services, run_limit=limit, fresh_time=fresh)",
        "hooks = VmHooks(liveness=self.services)",
        "from_a_coordinator",
    ),
    Hole(
        "a refused agent is offered",
        "host/team_directory.py",
        "if mission.access.callers:",
        "if False:",
        "from_a_coordinator",
    ),
    Hole(
        "any coordinator may reserve any resource",
        "vm/reservations/reserve_handlers.py",
        "if not (refused and all(refused)):",
        "if True:",
        "is_reserved",
    ),
    Hole(
        "every user at the Unix socket is root",
        "net/peer_credentials.py",
        "return identity_of(user, ",
        "return identity_of(0, ",
        "at_the_door",
    ),
    Hole(
        "every user at the Unix socket is in the group",
        "net/peer_credentials.py",
        "{group, *_peer_groups(unix_socket)}",
        "{_group_id()}",
        "at_the_door",
    ),
    Hole(
        "no user at the Unix socket is in the group",
        "net/peer_credentials.py",
        "{group, *_peer_groups(unix_socket)}",
        "{group}",
        "at_the_door",
    ),
    Hole(
        "every user at the Unix socket runs the host",
        "net/peer_credentials.py",
        "os.geteuid(), _group_id())",
        "user, _group_id())",
        "at_the_door",
    ),
    Hole(
        "the user at the Unix socket is not determined",
        "net/stream_link.py",
        "self.identity = identity_of_listener(sock) if self._calls else identity_of_caller(sock)",
        "self.identity = identity_of_listener(sock)",
        "at_the_door",
    ),
    Hole(
        "signatures are not required",
        "host/process/host_process.py",
        "release, reason = require_signature("
        "mission, credentials, admission, journal.records() if journal else ())",
        'release, reason = mission.release, ""',
        "as_a_bundle",
    ),
    Hole(
        "the rights of the signer are not checked",
        "mission/access/signed_bundle.py",
        'if verdict.extent != "all":',
        "if False:",
        "as_a_bundle",
    ),
    Hole(
        "revoked signers are accepted",
        "host/process/credentials.py",
        "        revoked=admission.revoked,\n",
        "",
        "as_a_bundle",
    ),
    Hole(
        "every bundle counts as started by the user",
        "host/process/credentials.py",
        "if release.digest and release.digest == proof.accepted_bundle.digest:",
        "if release.digest:",
        "as_a_bundle",
    ),
    Hole(
        "keys of other hosts are accepted",
        "host/process/credentials.py",
        'if (own.kind, own.name) != ("host", host):',
        "if False:",
        "with_keys",
    ),
    Hole(
        "expired or revoked keys are accepted",
        "host/process/credentials.py",
        "    _require_valid(own, revoked, time.now(), credentials.min_lifetime, signed)\n",
        "",
        "with_keys",
    ),
    Hole(
        "the duration of the mission is ignored",
        "cli/run/host_keys.py",
        "folders, args.lasts)",
        "folders)",
        "with_keys",
    ),
    Hole(
        "a peer that claims to be a host is accepted as one",
        "net/handshake.py",
        "if identity.name != hello.host:",
        "if False:",
        "over_the_network",
    ),
    Hole(
        "peers are not verified again",
        "net/link_manager.py",
        "session.on_reauthorised(self._admission.decide(identity, linked=session in links))",
        "pass",
        "on_a_link",
    ),
    Hole(
        "a host treats the call of an assistant as that of the person",
        "host/person_calls/person_calls.py",
        "if order.is_assistant and (reason",
        "if False and (reason",
        "of_an_assistant",
    ),
    Hole(
        "a service treats the start of an assistant as that of the person",
        "service/bundle_receiver.py",
        "if not command.is_assistant:",
        "if True:",
        "of_an_assistant",
    ),
    Hole(
        "assistants of all persons may act when one is listed",
        "mission/access/access_rules.py",
        "if OTHERS in self.assistants or (person and person in self.assistants):",
        "if self.assistants:",
        "of_an_assistant",
    ),
)


def planted(hole: Hole, folder: Path) -> None:
    """A copy of lfield with that hole, in a folder with the other folders that lfield needs."""
    (folder / "capabilities").symlink_to(ROOT / "capabilities")
    shutil.copytree(ROOT / "lfield", folder / "lfield", ignore=shutil.ignore_patterns("__pycache__"))
    file = folder / "lfield" / hole.file
    file.write_text(file.read_text(encoding="utf-8").replace(hole.stands, hole.becomes), encoding="utf-8")


def noticed(hole: Hole) -> int:
    """The number of failed cells. Raises RuntimeError when no cell was tested."""
    with tempfile.TemporaryDirectory(prefix="lfield-hole-") as name:
        planted(hole, Path(name))
        # Python searches the working directory first.
        command = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", "-c"]
        arguments = [str(ROOT / "pyproject.toml"), "--rootdir", str(ROOT), "--tb=no", "-k", hole.ways]
        process = subprocess.run(
            [*command, *arguments, str(ROOT / "tests" / "matrix")],
            cwd=name,
            env={**os.environ, "PYTHONPATH": name},
            capture_output=True,
            text=True,
        ).stdout
    failed = len(re.findall(r"^FAILED ", process, re.MULTILINE))
    if not failed and not re.match(r"\.+ ", process):
        raise RuntimeError(process)
    return failed
