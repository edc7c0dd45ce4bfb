"""The API for programs in Python: query, follow, start and stop a team, and call portals of its agents.

async with connect() as team:
    print(await team.call("arm1", "where"))

`lfield/docs/client.md` describes it. Errors are those of `lfield.errors`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfield.client.team import ConnectedTeam as Team
    from lfield.client.team import connect
    from lfield.vm.person_calls.l_object import LObject

__all__ = ["LObject", "Team", "connect"]


def __getattr__(name: str) -> object:
    # Commands use parts of this package, and start faster without the rest.
    if name in ("Team", "connect"):
        from lfield.client import team

        return team.ConnectedTeam if name == "Team" else team.connect
    if name == "LObject":
        from lfield.vm.person_calls.l_object import LObject

        return LObject
    raise AttributeError(f"module 'lfield.client' has no attribute '{name}'")
