"""Calls hosts again and again while links with them are wanted, and reports what was tried."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Protocol

from lfield.clock import Clock
from lfield.errors import AddressError, GreetingError, WireError
from lfield.loop import spawn
from lfield.net.session import Session, Sessions

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.net.transport import Transport

#: Seconds between two attempts to reach a host: the first wait, and the longest. An attempt that nobody
#: answers repeats itself (`lfield.connecting`), so one begins at most this long after a path works again.
FIRST_RETRY, LAST_RETRY = 0.05, 0.5
#: A host that has been called for less long may just not be up yet, which is no news.
NEWS_AFTER = 3.0


class Diallers(Sessions, Protocol):
    """Who wants hosts to be called."""

    def wants(self, host: str) -> bool:
        """Whether a link with a host is wanted now."""

    def link_of(self, host: str) -> Session | None:
        """The link that counts, if there is one. One that is suspected does until another is made."""

    def called(self, host: str) -> None:
        """An attempt is over."""


class Dialler:
    """Calls one host, until this is cancelled or its link is not wanted any more. `note` is for the log."""

    def __init__(
        self,
        owner: Diallers,
        transport: Transport,
        clock: Clock,
        host: str,
        address: str,
        note: Callable[[str], None],
    ) -> None:
        self._owner, self._transport, self._clock, self._note = owner, transport, clock, note
        self._host, self._address = host, address
        #: The call that has not been taken yet.
        self.session: Session | None = None
        #: Whether it was called without success since it was last linked.
        self.has_failed = False
        #: What was reported since the host was last linked, and since when it is called.
        self._reported: set[str] = set()
        self._since = clock.monotonic()
        self._task = spawn(self._run())

    @property
    def is_over(self) -> bool:
        """Whether it calls no more."""
        return self._task.done()

    def cancel(self) -> None:
        """Call no more."""
        self._task.cancel()

    async def _run(self) -> None:
        wait, now = FIRST_RETRY, self._clock.monotonic
        while self._owner.wants(self._host):
            began = now()
            there = self._owner.link_of(self._host)
            if there is not None and not there.is_suspected:
                await there.doubtful.wait()
                wait = FIRST_RETRY
                self._begin_anew()
            elif barred := self._owner.barred_for(self._host):
                await asyncio.sleep(barred)
                continue
            else:
                session = self.session = Session(self._owner, dialled=self._host)
                reason = await self._dial(session)
                if session.linked:
                    wait = FIRST_RETRY
                    self._begin_anew()
                elif reason:
                    self._report(session, reason)
            # An attempt that took long has waited already: the path may be back at this moment.
            await asyncio.sleep(max(FIRST_RETRY, wait - (now() - began)))
            wait = min(LAST_RETRY, wait * 1.5)

    async def _dial(self, session: Session) -> str:
        """Call, and stay until the link is over; why it is, or was never there."""
        try:
            link = await self._transport.connect(self._address, session)
            there = self._owner.link_of(self._host)
            if there not in (None, session) and not there.is_suspected:
                # It has called meanwhile, or the link that was silent has woken up.
                link.close()
            else:
                session.begin(link)
            await session.over.wait()
            return session.reason
        except (AddressError, GreetingError, WireError) as error:
            # A host that does not prove its identity has answered all the same.
            answered = not isinstance(error, AddressError)
            session.connected |= answered
            self._owner.refusals.report(self._host, str(error) if answered else "")
            return error.reason if isinstance(error, AddressError) else str(error)
        finally:
            self.session = None
            self.has_failed = True
            self._owner.called(self._host)

    def _begin_anew(self) -> None:
        self._reported.clear()
        self._since = self._clock.monotonic()

    def _report(self, session: Session, reason: str) -> None:
        """One line for each result, until the host is linked: a call is repeated every second."""
        if reason in self._reported:
            return
        if session.connected:
            self._note(f"cannot talk to {self._host}: {reason}")
        elif self._clock.monotonic() - self._since >= NEWS_AFTER:
            self._note(
                f"{self._host} is not reached at {self._address}: {reason}; it is called every "
                f"{LAST_RETRY:g} s until it answers"
            )
        else:
            return
        self._reported.add(reason)
