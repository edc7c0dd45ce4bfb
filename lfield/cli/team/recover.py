"""`lfield recover`: a person says that the host of a coordinator is gone for good; another goes on."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs
from lfield.cli.yes import says_yes
from lfield.errors import CoordinatorAlive, LfieldError, UsageError
from lfield.text.visible import in_one_line

if TYPE_CHECKING:
    from lfield.operator.addressed import Party
    from lfield.operator.recover import Belief


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument("agent", metavar="AGENT", help="id of the coordinator")
    add_running_mission(parser)
    parser.add_argument("--yes", action="store_true", help="do not ask for confirmation")


def run(args: argparse.Namespace) -> int:
    """0 when it goes on, 1 when nobody agreed, 69 when it is alive or its host does not go on with it."""
    from lfield.operator.addressed import believed_of, names_of
    from lfield.operator.ask import STATUS, ask_parties, silent, tell_silent
    from lfield.operator.recover import believed

    parties = believed_of(meant_parties(args, meant_runs(args)))
    names = names_of(parties)
    answers = ask_parties(parties, STATUS, args.keys)
    if all(isinstance(answer, LfieldError) for answer in answers.values()):
        tell_silent(silent({names[place]: answer for place, answer in answers.items()}))
        return exits.UNAVAILABLE
    belief = believed(args.agent, answers, names)
    print("\n".join(map(in_one_line, belief.lines)))
    if not _agreed(args.agent, names[belief.place], yes=args.yes):
        return exits.FAILED
    _carry_out(parties, belief, names[belief.place], args.keys)
    return exits.DONE


def _agreed(agent: str, host: str, *, yes: bool) -> bool:
    """Whoever cannot be asked has not agreed: raises UsageError."""
    if yes:
        return True
    if not sys.stdin.isatty():
        raise UsageError(
            "nothing was done: nobody can be asked here; add --yes if whoever had it is gone for good"
        )
    print(f"If the host that had {agent} is not gone for good, two copies may run.")
    return says_yes(f"Type 'yes' to go on with {agent} on {host}: ")


def _carry_out(parties: list[Party], belief: Belief, host: str, keys: Path | None) -> None:
    """Raises CoordinatorAlive when the host says no, and AddressError when it says nothing."""
    import asyncio

    from lfield.operator.ask import observer, own_keys, recover
    from lfield.operator.observing import ask

    address = next(party.places[belief.place] for party in parties if belief.place in party.places)
    transport = observer(own_keys([address], keys))
    answer = asyncio.run(ask(transport, address, recover(belief.word), belief.place.host))
    if not answer.generation:
        raise CoordinatorAlive(f"nothing was done: {answer.reason}")
    print(f"{host}: {belief.word.agent} goes on, as start {answer.generation}")
