"""Answers the requests to the service of one host, and executes the results of ballots.

The decisions are those of `ballots` and `restart_policy`. Disk, processes, and other services are interfaces,
so that simulations run the service without them.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress

from msgspec.structs import replace

from lfield import __version__
from lfield.clock import Clock
from lfield.errors import JournalError, OutputFileError, WireError
from lfield.service import ballots, messages
from lfield.service.ballots import ActivationState
from lfield.service.bundle_receiver import BundleReceiver, Verify
from lfield.service.bundle_store import ServiceRecord
from lfield.service.mission_runner import MissedEnd, MissionRunner
from lfield.service.service_interfaces import AskPeer, MissionProbe, ServiceFiles, ask_peers
from lfield.text.log_messages import LogLine
from lfield.text.suggestions import listed
from lfield.wire.fields import short_digest, truncate
from lfield.wire.service_messages import (
    MAX_BUNDLES,
    MAX_UNFINISHED,
    Ballot,
    BallotState,
    BundleOffer,
    BundlePiece,
    CommandResult,
    MissionCommand,
    Proposal,
    ServiceMessage,
    ServiceQuery,
    ServiceStatus,
    StageRequest,
    Vote,
    VoteQuery,
    VoteReport,
)

#: Seconds between two rounds of questions about an open ballot, after which they close it, and between two
#: log lines about it.
RESOLVE_EVERY, CLOSE_AFTER, REPORT_EVERY = 3.0, 30.0, 300.0


class Service:
    """The service of `host`. `verify` checks digest and signature of a bundle."""

    def __init__(
        self,
        host: str,
        record: ServiceRecord,
        store: ServiceFiles,
        runner: MissionRunner,
        probe: MissionProbe,
        verify: Verify,
        clock: Clock,
    ) -> None:
        self._host, self._store, self._runner, self._probe = host, store, runner, probe
        self._clock = clock
        self._activation, self._held = record.activation, record.held
        #: Held while a vote is made or a command executed: one decision at a time.
        self._lock = asyncio.Lock()
        #: The time of the vote in the open ballot (monotonic), None without one.
        self._bound_since: float | None = clock.monotonic() if self._activation.open_ballot else None
        #: The reason why the state could not be stored at the last attempt, '' if it was.
        self._store_problem = ""
        #: The time of the last log line about the open ballot.
        self._reported_at = -math.inf
        self._bundles = BundleReceiver(
            store, verify, lambda: self._activation.protected_bundles, self.note, clock.monotonic
        )
        runner.attach(self._store_run, self._start_refusal)
        self._missed_end = MissedEnd(runner, probe, clock)

    @property
    def activation(self) -> ActivationState:
        """The durable state of activations."""
        return self._activation

    def note(self, line: LogLine) -> None:
        """Write a log line."""
        self._runner.note(line)

    async def answer(self, message: ServiceMessage, operator: str, person: str = "") -> ServiceMessage:
        """See `RequestHandler`; the rights of the operator were checked. Raises WireError."""
        match message:
            case ServiceQuery():
                return await self.status()
            case BundleOffer():
                return self._bundles.on_offer(message, operator)
            case BundlePiece():
                return self._bundles.on_piece(message)
            case StageRequest():
                return self._bundles.on_stage(message)
            case Proposal():
                async with self._lock:
                    return await self._on_proposal(message.ballot)
            case VoteQuery():
                if message.closes:
                    self._store_activation(ballots.close(self._activation, message.id))
                return ballots.answer(self._activation, self._host, message.id)
            case VoteReport():
                await self.on_votes(message.id, message.votes)
                return ballots.answer(self._activation, self._host, message.id)
            case MissionCommand():
                caller = f"assistant of {operator}" if message.is_assistant else operator
                self.note(messages.COMMAND.line(action=message.action, operator=caller))
                # The operator did not know of an end of the host from now on.
                unsafe = self._runner.record.unsafe
                async with self._lock:
                    if message.action == "stop":
                        return await self._stop(message, caller, unsafe)
                    return await self._start(message, caller, person)
        raise WireError(f"{type(message).__name__} is not a request to a service")

    async def status(self) -> ServiceStatus:
        """The state of the service."""
        state = self._activation
        unfinished = await self._probe.unfinished()
        run = self._runner.info
        if self._runner.is_running and run.phase == "running":
            reason, failure = await self._probe.condition(), self._runner.last_failure
            # Until the host is up, the reason of the attempt before is more informative.
            because = f"; restarted after: {failure}" if reason and failure else ""
            run = replace(run, reason=truncate(reason + because))
        return ServiceStatus(
            self._host,
            __version__,
            state.active,
            state.previous,
            self._bundles.infos(MAX_BUNDLES),
            run,
            state.ballot,
            unfinished[:MAX_UNFINISHED],
            truncate(self._disk_problem() or await self._refusal(None)),
            self._clock.time(),
        )

    # --- votes ----------------------------------------------------------------------------------------

    async def _on_proposal(self, ballot: Ballot) -> BallotState:
        known = ballots.answer(self._activation, self._host, ballot.id)
        if known.ballot is not None or known.outcome != "open":
            return known
        if self._host not in ballot.hosts:
            raise WireError(f"{self._host} does not take part in this ballot")
        refusal = ""
        if self._activation.open_ballot is None:
            refusal = await self._refusal(ballot.digest, ballot.hosts)
            if not refusal and ballot.digest != self._activation.active:
                process = self._runner.process
                # Again when no vehicle can arm any more: one may have started in between.
                refusal = await self._hold(ballot.id) or await self._refusal(None)
                if not refusal and process != self._runner.process:
                    refusal = "the mission's host has ended during the vote: repeat it"
        try:
            self._store_activation(ballots.propose(self._activation, self._host, ballot, refusal))
        finally:
            if self._activation.open_ballot is None:
                await self._release()
        state = ballots.answer(self._activation, self._host, ballot.id)
        reason = state.reasons.get(self._host, "")
        self.note(
            messages.VOTED.line(
                vote=state.votes[self._host],
                bundle=short_digest(ballot.digest),
                by=ballot.by,
                reason=f": {reason}" if reason else "",
            )
        )
        await self._carry_out(state)
        return state

    async def on_votes(self, id: bytes, votes: Mapping[str, Vote]) -> None:
        """Handle votes of other hosts, from a desk or by requests to them."""
        async with self._lock:
            before = self._activation.open_ballot
            self._store_activation(ballots.learn(self._activation, self._host, id, votes))
            after = self._activation.ballot
            if before is not None and after is not None and after.outcome != "open":
                await self._carry_out(after)

    async def _carry_out(self, state: BallotState) -> None:
        """Execute a result: the host of another bundle ends, or a paused one continues."""
        if state.outcome == "open" or state.ballot is None:
            return
        bundle = short_digest(state.ballot.digest)
        if state.outcome == "activated":
            hosts = listed(state.ballot.hosts)
            self.note(messages.ACTIVATED.line(bundle=bundle, hosts=hosts))
            await self._end_other_bundle()
            return
        reasons = "; ".join(f"{host}: {reason}" for host, reason in state.reasons.items())
        opponents = listed([host for host, vote in state.votes.items() if vote == "no"])
        self.note(messages.ABORTED.line(bundle=bundle, reason=reasons or f"vote no of {opponents}"))
        await self._release()

    async def _end_other_bundle(self) -> None:
        active, record = self._activation.active, self._runner.record
        if active and record.open_run not in (b"", active) and record.bundle in (b"", record.open_run):
            # All hosts have voted that no coordinator of it exists.
            with suppress(OutputFileError):
                self._runner.end_run()
        # Without an active bundle the state was deleted while the host ran: no activation ends it.
        if active and self._runner.record.bundle not in (b"", active):
            # Held until the host ends: between its release and its end a vehicle could arm.
            await self._runner.stop("another bundle was activated")
            await self._release()

    async def _hold(self, ballot: bytes) -> str:
        """Hold a running host until the result, so that no vehicle arms; returns why it is not at rest."""
        if not self._runner.is_running:
            return ""
        self._set_held(True)
        if refusal := await self._probe.hold(ballot):
            await self._release()
        return refusal

    async def _release(self) -> None:
        """End the hold of the host. One that is started later is not held."""
        if self._held and (not self._runner.is_running or not await self._probe.release()):
            self._set_held(False)

    async def _refusal(self, digest: bytes | None, hosts: Sequence[str] = ()) -> str:
        """The reason why this host would vote no, or ''. `digest` is None for any other bundle.

        `hosts` are those that take part, none if unknown.
        """
        if digest is not None and digest == self._activation.active:
            return ""
        if digest and not self._bundles.is_valid(digest):
            return "the bundle is not stored here, or its signature is not valid any more"
        if motion := await self._motion():
            return motion
        if unfinished := await self._probe.unfinished():
            names = [f"{each.agent} ({each.state})" for each in unfinished[:MAX_UNFINISHED]]
            return f"coordinators have not ended: {listed(names)}; let them end, or 'lfield stop --discard'"
        return self._unaccounted(hosts)

    def _unaccounted(self, hosts: Sequence[str]) -> str:
        """The coordinators of an unfinished run that may exist on other hosts than these; '' if none.

        Only hosts that a coordinator has visited have a record of it.
        """
        run = self._runner.record.open_run or self._runner.record.bundle
        return ballots.coordinators_elsewhere(self._bundles.info(run), hosts) if run and hosts else ""

    async def _motion(self) -> str:
        """The reason why vehicles of the mission's host may not be at rest on the ground; '' if all are."""
        if self._runner.is_running:
            return await self._probe.vehicles()
        if self._runner.info.phase == "waiting":
            return f"the mission's host restarts: {self._runner.info.reason}"
        if unsafe := self._runner.record.unsafe:
            return f"the mission's host has ended ({unsafe}): check its vehicles, then 'lfield stop'"
        return ""

    async def resolve(self, ask: AskPeer) -> None:
        """Request the votes of an open ballot, or complete a result; at once and every few seconds.

        Never returns. On a full disk the next round tries again.
        """
        while True:
            with suppress(OutputFileError, JournalError):
                bound = self._activation.open_ballot
                if bound is None:
                    await self.settle()
                    await self._stop_after_missed_end(ask)
                else:
                    await self._ask_for_votes(bound, ask)
            await asyncio.sleep(RESOLVE_EVERY)

    async def _ask_for_votes(self, bound: BallotState, ask: AskPeer) -> None:
        since = self._bound_since
        waited = 0.0 if since is None else self._clock.monotonic() - since
        missing = [host for host in bound.missing if host != self._host]
        closes = waited >= CLOSE_AFTER
        if closes and self._clock.monotonic() - self._reported_at >= REPORT_EVERY:
            self._reported_at = self._clock.monotonic()
            bundle = short_digest(bound.ballot.digest) if bound.ballot is not None else ""
            line = messages.BALLOT_OPEN.line(bundle=bundle, seconds=waited, missing=listed(missing))
            self.note(line)
        query = VoteQuery(bound.id, closes=closes)
        votes: dict[str, Vote] = {}
        for answer in await ask_peers(ask, missing, query):
            if isinstance(answer, BallotState):
                votes |= answer.votes
        await self.on_votes(bound.id, votes)

    async def _stop_after_missed_end(self, ask: AskPeer) -> None:
        """Stop a host that was restarted while its mission ended: it would wait for hosts that have ended.

        The records of its journal about the coordinators are older than their ends.
        """
        process, mission = self._runner.process, self._bundles.info(self._runner.record.bundle)
        if mission is None or not (host := await self._missed_end.find(ask, mission.hosts)):
            return
        async with self._lock:
            if self._runner.process == process:
                reason = f"the mission has ended on {host} while this host did not run"
                await self._runner.stop(reason)
                await self._probe.discard(mission.name, reason)
                self._runner.end_run()

    # --- commands -------------------------------------------------------------------------------------

    async def _stop(self, command: MissionCommand, operator: str, unsafe: str) -> CommandResult:
        await self._runner.stop(f"stopped by {operator}", unsafe)
        discarded = await self._probe.discard() if command.discards else []
        if command.discards:
            self._runner.end_run()
        if discarded:
            self.note(messages.DISCARDED.line(agents=listed(discarded), operator=operator))
        checked = "" if self._runner.record.unsafe else unsafe
        return CommandResult(self._runner.info, await self._motion(), discarded[:MAX_UNFINISHED], checked)

    async def _start(self, command: MissionCommand, operator: str, person: str) -> CommandResult:
        active = self._activation.active
        # Before the start: a refused start has started nothing.
        refusal = self._start_refusal(active) or self._bundles.start_refusal(active, command, person)
        if refusal:
            self.note(messages.COMMAND_REFUSED.line(action="start", operator=operator, reason=refusal))
        else:
            await self._runner.start(active, command.order)
            if command.without:
                refusal = await self._probe.start_without(command.without)
        return CommandResult(self._runner.info, refusal)

    def _start_refusal(self, bundle: bytes) -> str:
        """The reason why the host of a bundle may not start here now; '' if it may."""
        bound = self._activation.open_ballot
        if bound is not None:
            missing = listed(bound.missing)
            return f"the activation of a bundle has no result yet: the votes of {missing} are unknown"
        if not self._activation.active:
            return "no bundle is active: 'lfield push' sends and activates one"
        if bundle != self._activation.active:
            return f"bundle {short_digest(bundle)} is not active any more"
        return ""

    # --- state ----------------------------------------------------------------------------------------

    def adopt(self) -> None:
        """After a start of the service: supervise a host that runs. Before the first request."""
        self._runner.adopt()
        # Also one that is held although the state of this service was deleted.
        self._held = self._held or self._runner.is_running

    async def settle(self) -> None:
        """Complete the steps after the last result, for instance after a restart of the service."""
        async with self._lock:
            if self._activation.open_ballot is None:
                await self._end_other_bundle()
                await self._release()

    def _store_activation(self, changed: ActivationState) -> None:
        """Store a state, then use it. Raises OutputFileError; then the state is unchanged."""
        if changed == self._activation:
            return
        self._save(ServiceRecord(changed, self._runner.record, self._held))
        was_open = self._activation.open_ballot is not None
        self._activation = changed
        if changed.open_ballot is None:
            self._bound_since = None
        elif not was_open:
            self._bound_since, self._reported_at = self._clock.monotonic(), -math.inf

    def _store_run(self) -> None:
        self._save(ServiceRecord(self._activation, self._runner.record, self._held))

    def _set_held(self, held: bool) -> None:
        if held != self._held:
            self._save(ServiceRecord(self._activation, self._runner.record, held))
            self._held = held

    def _save(self, record: ServiceRecord) -> None:
        try:
            self._store.save(record)
        except OutputFileError as error:
            if str(error) != self._store_problem:
                self.note(messages.STATE_ERROR.line(reason=error))
            self._store_problem = str(error)
            raise
        self._store_problem = ""

    def _disk_problem(self) -> str:
        """The reason why no vote can be stored now; '' after success, or when the disk has room again."""
        if self._store_problem:
            with suppress(OutputFileError):
                self._store_run()
        return f"no vote can be stored: {self._store_problem}; make room" if self._store_problem else ""
