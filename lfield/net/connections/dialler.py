"""Dials hosts repeatedly while links with them are needed, and logs the results."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Protocol

from lfield.address_race import retry_pause
from lfield.clock import Clock
from lfield.errors import AddressError, HandshakeError, WireError
from lfield.event_loop import spawn
from lfield.net.session import Session, SessionOwner
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.net.transport import Transport

#: The first pause between two attempts in seconds; `retry_pause` has the longest. An unanswered attempt
#: repeats itself (`lfield.address_race`).
FIRST_RETRY = 0.05
#: Seconds: a host dialled for a shorter time may still be starting, which is not logged.
REPORT_AFTER = 3.0


class DialOwner(SessionOwner, Protocol):
    """The owner of the diallers."""

    def needs_link(self, host: str) -> bool:
        """Whether a link with a host is needed now."""

    def link_of(self, host: str) -> Session | None:
        """The current link with a host. A suspected link remains current until another one replaces it."""

    def on_dialled(self, host: str) -> None:
        """An attempt has ended."""


class Dialler:
    """Dials one host until cancelled, or until its link is no longer needed. `note` writes a log line."""

    def __init__(
        self,
        owner: DialOwner,
        transport: Transport,
        clock: Clock,
        host: str,
        address: str,
        note: Callable[[LogLine], None],
    ) -> None:
        self._owner, self._transport, self._clock, self._note = owner, transport, clock, note
        self._host, self._address = host, address
        #: The dialled link that has not been accepted yet.
        self.session: Session | None = None
        #: Whether an attempt has failed since the last link.
        self.has_failed = False
        #: The log lines since the last link, and the time since when the host is dialled.
        self._reported: set[str] = set()
        self._since = clock.monotonic()
        self._task = spawn(self._run())

    @property
    def is_over(self) -> bool:
        """Whether dialling has ended."""
        return self._task.done()

    def clear_failure(self) -> None:
        """A link with the host exists."""
        self.has_failed = False

    def cancel(self) -> None:
        """Stop dialling."""
        self._task.cancel()

    async def _run(self) -> None:
        wait, now = FIRST_RETRY, self._clock.monotonic
        while self._owner.needs_link(self._host):
            start = now()
            established = self._owner.link_of(self._host)
            if established is not None and not established.is_suspected:
                await established.suspected.wait()
                wait = FIRST_RETRY
                self._reset_reports()
            elif ban_seconds := self._owner.ban_remaining(self._host):
                await asyncio.sleep(ban_seconds)
                continue
            else:
                session = self.session = Session(self._owner, dialled=self._host)
                reason = await self._dial(session)
                if session.linked:
                    wait = FIRST_RETRY
                    self._reset_reports()
                elif reason:
                    self._report(session, reason)
            # A slow attempt needs no further delay: the path may just work again.
            await asyncio.sleep(max(FIRST_RETRY, wait - (now() - start)))
            wait = min(retry_pause(now() - self._since), wait * 1.5)

    async def _dial(self, session: Session) -> str:
        """Dial, and wait for the end of the link. Returns the reason why the link ended, or was not made."""
        try:
            link = await self._transport.connect(self._address, session, self._host)
            established = self._owner.link_of(self._host)
            if established not in (None, session) and not established.is_suspected:
                # The host has dialled in the meantime, or the silent link has recovered.
                link.close()
            else:
                session.open(link)
            await session.closed.wait()
            return session.reason
        except (AddressError, HandshakeError, WireError) as error:
            # A host that fails authentication has answered.
            answered = not isinstance(error, AddressError)
            if answered:
                session.mark_connected()
            self._owner.refusals.report(self._host, str(error) if answered else "")
            return error.reason if isinstance(error, AddressError) else str(error)
        finally:
            self.session = None
            self.has_failed = True
            self._owner.on_dialled(self._host)

    def _reset_reports(self) -> None:
        self._reported.clear()
        self._since = self._clock.monotonic()

    def _report(self, session: Session, reason: str) -> None:
        """Log each distinct result once per link: attempts repeat every second."""
        if reason in self._reported:
            return
        if session.connected:
            self._note(log_messages.LINK_REFUSED.line(host=self._host, reason=reason))
        elif self._clock.monotonic() - self._since >= REPORT_AFTER:
            self._note(
                log_messages.HOST_UNREACHABLE.line(host=self._host, address=self._address, reason=reason)
            )
        else:
            return
        self._reported.add(reason)
