"""What keeps a coordinator that has terminated from being recovered, each left out: the judge must see it."""

from __future__ import annotations

from typing import Any

from planted_bugs import Bug, Patch

from lfield.quorum.terminations import Terminations
from lfield.simulate.stories.story import ending

#: By which breaches they may be found.
RECOVERED = frozenset({"terminated", "promised"})


def an_end_is_written_down_in_spite_of_a_promise(patch: Patch) -> None:
    """It becomes final while the recovery that was promised begins, and its proposer is not told."""
    patch.setattr(Terminations, "is_delayed", lambda self, ended, now: False)
    patch.setattr(Terminations, "all", property(lambda self: []))


def _bug(plant: Any, why: str, seed: int) -> Bug:
    return Bug(plant, why, RECOVERED, seed, ending)


TERMINATED_BUGS = [
    _bug(
        an_end_is_written_down_in_spite_of_a_promise,
        "a majority has the end on disk while the recovery that one of it has promised begins",
        32,
    ),
]
