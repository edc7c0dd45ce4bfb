"""Requests the votes of some hosts' services about the activation of a bundle, and reports them to all.

The desk does not decide (`lfield.service.ballots`): if it ends, the hosts settle the ballot among themselves.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Sequence

from lfield.errors import LfieldError
from lfield.operator.fleet.service_link import ServiceLinks
from lfield.wire.service_messages import (
    Ballot,
    BallotOutcome,
    BallotState,
    Proposal,
    ServiceMessage,
    Vote,
    VoteQuery,
    VoteReport,
    ballot_outcome,
    missing_votes,
)

#: Bytes of the id of a ballot.
ID_SIZE = 16
#: Seconds for all votes; then the hosts that have not voted are asked to vote no.
VOTE_TIMEOUT = 25.0
#: Seconds for one vote: a host pauses its mission before it votes.
ANSWER_TIMEOUT = 15.0
#: Seconds for which a result is reported to a host that does not answer.
REPORT_TIMEOUT = 10.0


class BallotResult:
    """The votes of a ballot known to the desk: votes and reasons by host, and the hosts that know the
    result.
    """

    def __init__(self, ballot: Ballot) -> None:
        self.ballot = ballot
        self.votes: dict[str, Vote] = {}
        self.reasons: dict[str, str] = {}
        self.informed: set[str] = set()
        #: The reasons why hosts did not answer, or could not vote; `late` are those that have answered later.
        self.unreached: dict[str, LfieldError] = {}
        self.late: dict[str, LfieldError] = {}

    def add(self, host: str, state: BallotState) -> None:
        """Add the answer of a host."""
        self.votes |= state.votes
        self.reasons |= state.reasons
        # A host that answers without a vote could not store it: its error stays.
        if host in state.votes and (error := self.unreached.pop(host, None)) is not None:
            self.late[host] = error
        if state.outcome != "open" and state.outcome == self.outcome:
            self.informed.add(host)

    @property
    def outcome(self) -> BallotOutcome:
        """The result of the votes that are known here."""
        return ballot_outcome(self.ballot.hosts, self.votes)

    @property
    def missing(self) -> list[str]:
        """The hosts whose votes are not known here."""
        return missing_votes(self.ballot.hosts, self.votes)


def new_ballot(
    digest: bytes, hosts: Sequence[str], by: str, draw: Callable[[int], bytes] = secrets.token_bytes
) -> Ballot:
    """A ballot of `hosts`; `draw` gives random bytes for its id."""
    return Ballot(draw(ID_SIZE), digest, list(hosts), by)


async def activate(
    links: ServiceLinks, ballot: Ballot, on_change: Callable[[BallotResult], None] = lambda result: None
) -> BallotResult:
    """The result of a ballot among services.

    The result is open if hosts could not be reached: then the hosts that have voted yes settle it when they
    meet.
    """
    result = BallotResult(ballot)

    async def ask(host: str, message: ServiceMessage, within: float) -> None:
        try:
            # A service that is restarted meanwhile has stored its vote, or can still vote.
            answer = await links.ask(host, message, BallotState, within, ANSWER_TIMEOUT, restart=within)
            result.add(host, answer)
        except LfieldError as error:
            result.unreached[host] = error
        on_change(result)

    tasks = [asyncio.ensure_future(ask(host, Proposal(ballot), VOTE_TIMEOUT)) for host in ballot.hosts]
    await _until_decided(result, tasks)
    if result.outcome == "open":
        uninformed = result.missing
        query = VoteQuery(ballot.id, closes=True)
        await asyncio.gather(*(ask(host, query, ANSWER_TIMEOUT) for host in uninformed))
    report = VoteReport(ballot.id, result.votes)
    uninformed = [host for host in ballot.hosts if host not in result.informed]
    await asyncio.gather(*(ask(host, report, REPORT_TIMEOUT) for host in uninformed))
    return result


async def _until_decided(result: BallotResult, requests: Sequence[asyncio.Future[None]]) -> None:
    """Wait for the requests for votes until all have ended, or one host has voted no."""
    while result.outcome == "open" and (pending := [each for each in requests if not each.done()]):
        await asyncio.wait(pending, return_when=asyncio.FIRST_COMPLETED)
    for each in requests:
        each.cancel()
    await asyncio.gather(*requests, return_exceptions=True)
