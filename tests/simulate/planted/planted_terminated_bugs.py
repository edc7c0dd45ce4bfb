"""What keeps a coordinator that has terminated from being recovered, each left out: the judge must see it."""

from __future__ import annotations

from typing import Any

from msgspec import structs
from planted_bugs import Bug, Patch

from lfield.host.team.leases import Leases
from lfield.quorum.core import Quorum
from lfield.quorum.terminations import Terminations
from lfield.simulate.stories.story import ending

#: By which breaches they may be found.
RECOVERED = frozenset({"terminated", "promised"})


def an_end_is_like_nothing_known(patch: Patch) -> None:
    """As it was: a coordinator that has terminated looks like one of which nothing was ever heard."""
    patch.setattr(Leases, "_saved_end", lambda self, agent: None)


def a_promise_in_spite_of_a_known_end(patch: Patch) -> None:
    """It is told in acknowledgements, but whoever is asked does not look."""
    on_propose, sought = Quorum._on_propose, Quorum._sought

    def promises(self: Quorum, host: str, message: Any, now: float) -> Any:
        return on_propose(self, host, structs.replace(message, start=2**62), now)

    def silent(self: Quorum, agent: str, now: float) -> Any:
        return structs.replace(sought(self, agent, now), ended=None)

    patch.setattr(Quorum, "_on_propose", promises)
    patch.setattr(Quorum, "_sought", silent)
    patch.setattr(Terminations, "all", property(lambda self: []))


def an_end_is_written_down_in_spite_of_a_promise(patch: Patch) -> None:
    """It becomes final while the recovery that was promised begins, and its proposer is not told."""
    patch.setattr(Terminations, "is_delayed", lambda self, ended, now: False)
    patch.setattr(Terminations, "all", property(lambda self: []))


def _bug(plant: Any, why: str, seed: int) -> Bug:
    return Bug(plant, why, RECOVERED, seed, ending)


TERMINATED_BUGS = [
    _bug(an_end_is_like_nothing_known, "who knows the end answers as who has never heard of it", 2),
    _bug(a_promise_in_spite_of_a_known_end, "a member promises what it knows to have terminated", 2),
    _bug(
        an_end_is_written_down_in_spite_of_a_promise,
        "a majority has the end on disk while the recovery that one of it has promised begins",
        32,
    ),
]
