"""Plant holes in a copy of lfield, one by one, and tell how many cells of the security matrix notice each.

    python tests/matrix/planted_holes.py [WORD]      those whose name has this word in it

A hole that no cell notices is a way that the matrix does not go.
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
    """What stands in a file of lfield once, and what somebody might make of it; the cells of `ways` fail."""

    name: str
    file: str
    stands: str
    becomes: str
    ways: str


HOLES = (
    Hole(
        "the rules of portals are not asked",
        "vm/portals.py",
        "if (rules := scheduler.attached.rules) is not None and (why",
        "if False and (rules := scheduler.attached.rules) is not None and (why",
        "from_a_coordinator",
    ),
    Hole(
        "no machine has rules",
        "host/core.py",
        "self.programs, machine.attached.rules = Programs(machine, clock.monotonic), mission.calls",
        "self.programs = Programs(machine, clock.monotonic)",
        "from_a_coordinator",
    ),
    Hole(
        "what is refused is offered",
        "host/offers.py",
        "if mission.access.callers:",
        "if False:",
        "from_a_coordinator",
    ),
    Hole(
        "anybody reserves anything",
        "vm/reserve/heads.py",
        "if not (refused and all(refused)):",
        "if True:",
        "is_reserved",
    ),
    Hole(
        "everybody at the door is root",
        "net/door.py",
        "return judged(user, ",
        "return judged(0, ",
        "at_the_door",
    ),
    Hole(
        "everybody at the door is in the group",
        "net/door.py",
        "{group, *_other_groups(made)}",
        "{_number_of_group()}",
        "at_the_door",
    ),
    Hole(
        "nobody at the door is in the group",
        "net/door.py",
        "{group, *_other_groups(made)}",
        "{group}",
        "at_the_door",
    ),
    Hole(
        "whoever calls runs the host",
        "net/door.py",
        "os.geteuid(), _number_of_group())",
        "user, _number_of_group())",
        "at_the_door",
    ),
    Hole(
        "who calls at the door is not asked",
        "net/stream.py",
        "self.who = host_at(made) if self._calls else caller_at(made)",
        "self.who = host_at(made)",
        "at_the_door",
    ),
    Hole(
        "signatures are not asked for",
        "host/process/run.py",
        "release, doubt = insist_on_signature(mission, proof, admission, journal.pages() if journal else ())",
        'release, doubt = mission.release, ""',
        "as_a_bundle",
    ),
    Hole(
        "who has signed does not matter",
        "mission/access/release.py",
        'if verdict.extent != "all":',
        "if False:",
        "as_a_bundle",
    ),
    Hole(
        "revoked signers count",
        "host/process/proving.py",
        "        revoked=admission.revoked,\n",
        "",
        "as_a_bundle",
    ),
    Hole(
        "every bundle was vouched for",
        "host/process/proving.py",
        "if release.digest and release.digest == proof.vouched.digest:",
        "if release.digest:",
        "as_a_bundle",
    ),
    Hole(
        "keys of other hosts are taken",
        "host/process/proving.py",
        'if (own.kind, own.name) != ("host", host):',
        "if False:",
        "with_keys",
    ),
    Hole(
        "keys that end or are revoked are taken",
        "host/process/proving.py",
        "    _insist_on_good(own, revoked, time.now(), proof.lasts)\n",
        "",
        "with_keys",
    ),
    Hole(
        "how long a mission lasts is forgotten",
        "cli/run/own_keys.py",
        "folders, args.lasts)",
        "folders)",
        "with_keys",
    ),
    Hole(
        "what calls itself a host is one",
        "net/greeting.py",
        "if who.name != hello.host:",
        "if False:",
        "over_the_network",
    ),
    Hole(
        "nothing is judged again",
        "net/peers.py",
        "session.judged(self._admission.verdict(session.link.who, linked=session in links))",
        "pass",
        "on_a_link",
    ),
)


def planted(hole: Hole, folder: Path) -> None:
    """A copy of lfield with that hole, in a folder, beside what else lfield has beside it."""
    (folder / "capabilities").symlink_to(ROOT / "capabilities")
    shutil.copytree(ROOT / "lfield", folder / "lfield", ignore=shutil.ignore_patterns("__pycache__"))
    file = folder / "lfield" / hole.file
    file.write_text(file.read_text(encoding="utf-8").replace(hole.stands, hole.becomes), encoding="utf-8")


def noticed(hole: Hole) -> int:
    """How many cells fail. Raises RuntimeError where none was tried."""
    with tempfile.TemporaryDirectory(prefix="lfield-hole-") as name:
        planted(hole, Path(name))
        # The folder where it runs is the first in which Python looks.
        command = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", "-c"]
        words = [str(ROOT / "pyproject.toml"), "--rootdir", str(ROOT), "--tb=no", "-k", hole.ways]
        told = subprocess.run(
            [*command, *words, str(ROOT / "tests" / "matrix")],
            cwd=name,
            env={**os.environ, "PYTHONPATH": name},
            capture_output=True,
            text=True,
        ).stdout
    failed = len(re.findall(r"^FAILED ", told, re.MULTILINE))
    if not failed and not re.match(r"\.+ ", told):
        raise RuntimeError(told)
    return failed


def main(word: str) -> int:
    """Plant them; 1 when one was not noticed."""
    chosen = [hole for hole in HOLES if word in hole.name]
    missed = 0
    for hole in chosen:
        cells = noticed(hole)
        missed += not cells
        print(f"{hole.name}: {cells or 'not noticed by any'} of {hole.ways}", flush=True)
    print(f"{len(chosen)} holes, {missed} not noticed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else ""))
