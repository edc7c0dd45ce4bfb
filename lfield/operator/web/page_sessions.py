"""Who may open the page: whoever has the link that was printed on the terminal, once; then that browser.

Every user of a computer reaches its loopback, and so does every web page that one of them has open; a network
is open to more people still. So a request must bring the cookie of a session, which the link gives. It must
be for an address of ours, or a name that somebody else made point here would do (DNS rebinding); and what
comes from a page must come from ours.
"""

from __future__ import annotations

import hmac
from collections.abc import Callable, Collection
from dataclasses import dataclass

#: So many browsers have the page open; of more the one that came first must take a new link.
MAX_SESSIONS = 32

NO_SESSION = "this page is opened by the link that 'lfield watch' has printed last, once for each browser"
OLD_LINK = "this link has been used: take the one that 'lfield watch' has printed last on its terminal"
FOREIGN_ADDRESS = "this page is not served under that address: take the one that 'lfield watch' has printed"
FOREIGN_PAGE = "another page asks for this, and only the page of 'lfield watch' may"


@dataclass(frozen=True, slots=True)
class PageRequest:
    """A request, as far as it says who asks: two headers, '' for none, and whether it acts.

    `sessions` are the values of the cookies that have the page's name: another program on this address may
    have set one of that name, too.
    """

    host: str
    origin: str = ""
    sessions: tuple[str, ...] = ()
    is_action: bool = False


class PageSessions:
    """Lets browsers in. `addresses` are those of the page as browsers name them, `rng` makes secrets."""

    def __init__(self, addresses: Collection[str], rng: Callable[[], str], scheme: str = "http") -> None:
        self._addresses = frozenset(addresses)
        #: Whether nobody on the way can read what is said here.
        self.secure = scheme == "https"
        self._origins = frozenset(f"{scheme}://{address}" for address in addresses)
        self._rng = rng
        self._sessions: dict[str, None] = {}
        self.token = rng()

    def log_in(self, token: str) -> str | None:
        """The session that a link opens, None for a link that opens none. It is used up then."""
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return None
        self.token = self._rng()
        session = self._rng()
        self._sessions[session] = None
        while len(self._sessions) > MAX_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        return session

    def address_refusal(self, request: PageRequest) -> str:
        """Why nothing at all is answered to it, '' when something may be."""
        return "" if request.host in self._addresses else FOREIGN_ADDRESS

    def refusal(self, request: PageRequest) -> str:
        """Why a request is refused, '' when it is answered."""
        if wrong := self.address_refusal(request):
            return wrong
        if self._sessions.keys().isdisjoint(request.sessions):
            return NO_SESSION
        # Browsers say where a request comes from wherever it changes something, and with each WebSocket.
        if request.origin not in self._origins and (request.origin or request.is_action):
            return FOREIGN_PAGE
        return ""
