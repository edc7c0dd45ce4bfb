"""The team of a mission, and where its hosts listen on this machine, for commands started later.

`up --all` takes free ports; it leaves a small file that `ps` finds by the deployment's hash. The file names
the process that wrote it, and is believed only while that process lives.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from lfield.lang.deployment import read_deployment
from lfield.mission import bundle
from lfield.mission.team import Team, team_of


def open_team(mission: Path) -> Team:
    """The team of a bundle, or of a deployment, whose program is not looked at: no kinds are known then.

    Raises InputFileError, and BundleError or ProgramError for a file with mistakes.
    """
    if mission.suffix == bundle.SUFFIX:
        return bundle.read(mission).team
    deployment = read_deployment(mission, None)
    return team_of(deployment.rows, deployment.kinds, deployment.ports)


def _folder() -> Path:
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"lfield-{os.getuid()}"


@contextmanager
def published(deployment: bytes, addresses: Mapping[str, str]) -> Iterator[None]:
    """Let others on this machine find these addresses (host name to "host:port") for the duration.

    Where the folder cannot be written nothing is published: only `ps` without --map is the poorer for it.
    """
    path = _folder() / f"{deployment.hex()[:32]}.json"
    with suppress(OSError):
        path.parent.mkdir(mode=0o700, exist_ok=True)
        path.write_text(json.dumps({"pid": os.getpid(), "addresses": dict(addresses)}), encoding="utf-8")
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink()


def find(deployment: bytes) -> dict[str, str]:
    """The addresses published for a deployment, {} when nobody who lives has published any."""
    path = _folder() / f"{deployment.hex()[:32]}.json"
    try:
        if path.parent.stat().st_uid != os.getuid():
            return {}
        record = json.loads(path.read_text(encoding="utf-8"))
        os.kill(int(record["pid"]), 0)
        return {str(k): str(v) for k, v in record["addresses"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
