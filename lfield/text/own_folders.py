"""Where a user's own folders are: where the environment says, else in the user's home.

What is no absolute path is not taken: the folder would be another one wherever a command is called.
"""

from __future__ import annotations

import os
import pwd
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from lfield.errors import NoHome


def own_folder(variable: str, place: str, environment: Mapping[str, str] = os.environ) -> Path:
    """The folder that a variable names, else the one at that `place` in the home. Raises NoHome."""
    for base, inside in ((environment.get(variable, ""), "."), (_home(environment), place)):
        if os.path.isabs(base):
            return Path(base) / inside
    raise NoHome(variable)


def state_folder() -> Path:
    """The folder of what outlives a run: the service's, else the user's own. Raises NoHome."""
    # systemd names all state folders of a unit, with colons between.
    service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(service) if service else own_folder("XDG_STATE_HOME", ".local/state") / "lfield"


def cache_folder() -> Path:
    """The folder of what can be made again. Raises NoHome."""
    return own_folder("XDG_CACHE_HOME", ".cache") / "lfield"


def _home(environment: Mapping[str, str]) -> str:
    if "HOME" in environment:
        return environment["HOME"]
    with suppress(KeyError):
        return pwd.getpwuid(os.geteuid()).pw_dir
    return ""
