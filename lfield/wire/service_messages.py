"""Messages to the service of a robot: bundles in pieces, votes about activation, and commands.

Desks send them, and the services of other hosts ask for votes. Messages as in `messages`, which has the union
of all. Lists that may be long are limited, so that a message fits the limit of an observer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal

from msgspec import Meta, Struct

from lfield import exit_status
from lfield.wire.fields import (
    Count,
    Hash,
    Index,
    Label,
    Moment,
    Name,
    OptionalName,
    OptionalOrderId,
    OrderId,
    Text,
)

#: The longest piece of a bundle and the most pieces of one offer.
MAX_PIECE, MAX_OFFER = 4096, 512
#: Digest of a piece: the first bytes of its SHA-256.
PIECE_DIGEST_SIZE = 16
PieceDigest = Annotated[bytes, Meta(min_length=PIECE_DIGEST_SIZE, max_length=PIECE_DIGEST_SIZE)]
#: The most hosts of a ballot, unfinished coordinators, and stored bundles in a message.
MAX_HOSTS, MAX_UNFINISHED, MAX_BUNDLES = 256, 64, 16
#: The most coordinators of a mission that are described.
MAX_COORDINATORS = 256

#: A vote: not yet known, or stored by its host.
Vote = Literal["yes", "no"]
#: The result of a ballot: open until every host has voted yes, or one no.
BallotOutcome = Literal["open", "activated", "aborted"]


def ballot_outcome(hosts: Iterable[str], votes: Mapping[str, Vote]) -> BallotOutcome:
    """The result of a ballot among `hosts`: a function of the votes only."""
    if "no" in votes.values():
        return "aborted"
    return "activated" if all(votes.get(host) == "yes" for host in hosts) else "open"


def missing_votes(hosts: Iterable[str], votes: Mapping[str, Vote]) -> list[str]:
    """The hosts whose votes are not known."""
    return [host for host in hosts if host not in votes]


#: The statuses of a host that has ended with the whole mission.
COMPLETED = (exit_status.DONE, exit_status.FAILED)
#: The phase of the mission's host, as seen by its service.
RunPhase = Literal["stopped", "starting", "running", "stopping", "waiting", "ended", "interrupted"]


class BundleInfo(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A stored bundle: its digest, its mission's name, its signer and the time of the signature.

    `hosts` are the hosts of the mission, `coordinators` its coordinators with the hosts on which they start.
    """

    digest: Hash
    name: Label
    by: Text = ""
    at: Moment = 0.0
    hosts: Annotated[list[Name], Meta(max_length=MAX_HOSTS)] = []
    coordinators: Annotated[dict[Name, Name], Meta(max_length=MAX_COORDINATORS)] = {}


class Ballot(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A proposal that all `hosts` activate the bundle `digest`; b"" for none.

    `id` is random. `by` is the name of its proposer.
    """

    id: OrderId
    digest: Hash
    hosts: Annotated[list[Name], Meta(min_length=1, max_length=MAX_HOSTS)]
    by: Text


class BallotState(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=51):
    """The state of a ballot on a host: the stored votes, by host, and the reasons of the votes against.

    `ballot` is None if the host has never received it; a host that voted no on demand may have the id only.
    The answer to Proposal, VoteQuery and VoteReport.
    """

    id: OrderId
    ballot: Ballot | None
    votes: Annotated[dict[Name, Vote], Meta(max_length=MAX_HOSTS)]
    reasons: Annotated[dict[Name, Label], Meta(max_length=MAX_HOSTS)]
    outcome: BallotOutcome

    @property
    def missing(self) -> list[str]:
        """The hosts whose votes are not known; none without the ballot."""
        return [] if self.ballot is None else missing_votes(self.ballot.hosts, self.votes)


class UnfinishedCoordinator(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A coordinator that has not ended as far as this host knows; `where` is its last known host.

    `state` is a description. `mission` is the name of its deployment.
    """

    agent: Name
    state: Label
    where: OptionalName
    mission: Label


class RunInfo(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The mission's host that the service starts: its bundle, its phase, and the reason of this phase.

    `since` is in seconds since 1970. `status` is the exit status of the last end, None before the first.
    `order` is the id of the order that started the host, b"" for none.
    """

    bundle: Hash = b""
    phase: RunPhase = "stopped"
    reason: Text = ""
    since: Moment = 0.0
    status: Annotated[int, Meta(ge=-255, le=255)] | None = None
    order: OptionalOrderId = b""

    @property
    def has_completed(self) -> bool:
        """Whether the mission has ended as a whole: it does not continue on another host."""
        return self.phase == "ended" and self.status in COMPLETED


class ServiceQuery(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=52):
    """Query the state of a service; answered by ServiceStatus."""


class ServiceStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=53):
    """The state of a service: version of lfield, active and previous bundle, stored bundles, last ballot.

    `refusal` is the reason why the host would vote no now, '' if it would vote yes. `unfinished` are the
    coordinators that have not ended. `time` is the time of its clock, in seconds since 1970.
    """

    host: Name
    version: Label
    active: Hash
    previous: Hash
    bundles: Annotated[list[BundleInfo], Meta(max_length=MAX_BUNDLES)]
    run: RunInfo
    ballot: BallotState | None
    unfinished: Annotated[list[UnfinishedCoordinator], Meta(max_length=MAX_UNFINISHED)]
    refusal: Text
    time: Moment


class BundleOffer(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=54):
    """Offer some pieces of a bundle, from number `first` of `count`; answered by PieceRequest.

    `digest` is the digest of the bundle and `file` the digest of its whole file, with the signature. `size`
    is in bytes.
    """

    digest: Hash
    file: Hash
    size: Count
    count: Count
    first: Count
    pieces: Annotated[list[tuple[PieceDigest, Index]], Meta(max_length=MAX_OFFER)]


class PieceRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=55):
    """The pieces of an offer that the host does not have, by number. `trouble` is the reason why it accepts
    none.

    With `retry`, here and in the next answers, it accepts pieces later: offer them again.
    """

    file: Hash
    first: Count
    missing: Annotated[list[Count], Meta(max_length=MAX_OFFER)]
    trouble: Text = ""
    retry: bool = False


class BundlePiece(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=56):
    """The bytes of a piece, compressed (raw deflate) if the result is shorter; answered by PieceStored."""

    file: Hash
    number: Count
    is_compressed: bool
    data: Annotated[bytes, Meta(max_length=MAX_PIECE)]


class PieceStored(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=57):
    """A piece is on disk. `trouble` is the reason why it is not."""

    file: Hash
    number: Count
    trouble: Text = ""
    retry: bool = False


class StageRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=58):
    """Put the pieces of a file together, verify digest and signature, and store the bundle."""

    digest: Hash
    file: Hash


class StageResult(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=59):
    """The bundle is stored. `trouble` is the reason why it is not, `code` the code of this error."""

    digest: Hash
    trouble: Text = ""
    code: Label = ""
    retry: bool = False


class Proposal(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=60):
    """Propose a ballot; answered by BallotState when the vote of the host is stored."""

    ballot: Ballot


class VoteQuery(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=61):
    """Query the state of a ballot on a host. With `closes`, a host that has not voted votes no."""

    id: OrderId
    closes: bool = False


class VoteReport(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=62):
    """Report the stored votes of other hosts; answered by BallotState."""

    id: OrderId
    votes: Annotated[dict[Name, Vote], Meta(max_length=MAX_HOSTS)]


class MissionCommand(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=63):
    """Start or stop the mission's host; answered by CommandResult when it runs, or has ended.

    `digest` is the bundle that must be active, b"" for any. `discards`: a stop also ends the coordinators
    that have not ended, so that the next start is another run. A start does not wait for the hosts `without`.
    `order` is the id of a start, the same on all hosts: with it, a host that was restarted while the mission
    ended recognises the end on another host as the end of its own run. `is_assistant`: an AI assistant sends
    the command for the person.
    """

    action: Literal["start", "stop"]
    digest: Hash = b""
    discards: bool = False
    without: Annotated[list[Name], Meta(max_length=MAX_HOSTS)] = []
    order: OptionalOrderId = b""
    is_assistant: bool = False


class CommandResult(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=64):
    """The state after a command.

    `trouble` is the reason why it was not executed, or, after a stop, why vehicles may not be at rest.
    `discarded` are the coordinators that the command has ended. `checked` is the end of a host before a stop,
    which says that its vehicles have been checked.
    """

    run: RunInfo
    trouble: Text = ""
    discarded: Annotated[list[Name], Meta(max_length=MAX_UNFINISHED)] = []
    checked: Text = ""


#: The messages to and from a service.
ServiceMessage = (
    BallotState
    | ServiceQuery
    | ServiceStatus
    | BundleOffer
    | PieceRequest
    | BundlePiece
    | PieceStored
    | StageRequest
    | StageResult
    | Proposal
    | VoteQuery
    | VoteReport
    | MissionCommand
    | CommandResult
)
