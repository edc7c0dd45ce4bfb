"""Login by a one-time link and session cookies, with checks of Host and Origin.

Every user of a computer, and every web page that one of them has open, can reach its loopback addresses. So a
request must carry the cookie of a session, which the printed link creates. Its Host must be an address of
this page (against DNS rebinding), and its Origin this page (against cross-site requests).
"""

from __future__ import annotations

import hmac
from collections.abc import Callable, Collection

from msgspec import Struct

#: Maximum number of sessions; a further one ends the oldest.
MAX_SESSIONS = 32

NO_SESSION = "no session: open the newest link that 'lfield watch' has printed; each link opens one browser"
OLD_LINK = "this link has been used: open the newest one that 'lfield watch' has printed"
FOREIGN_ADDRESS = "this page is not served under that address: use the one that 'lfield watch' has printed"
FOREIGN_PAGE = "request refused: it comes from another web page than that of 'lfield watch'"


class PageRequest(Struct, frozen=True):
    """The headers of a request that authenticate it ('' for none), and whether it is an action.

    `sessions` are the values of all cookies with the page's name: another program on this address may have
    set one of that name, too.
    """

    host: str
    origin: str = ""
    sessions: tuple[str, ...] = ()
    is_action: bool = False


class PageSessions:
    """The sessions of browsers. `addresses` are those of the page in Host headers, `rng` makes secrets."""

    def __init__(self, addresses: Collection[str], rng: Callable[[], str], scheme: str = "http") -> None:
        self._addresses = frozenset(addresses)
        #: Whether the page is served over https.
        self.secure = scheme == "https"
        self._origins = frozenset(f"{scheme}://{address}" for address in addresses)
        self._rng = rng
        self._sessions: dict[str, None] = {}
        self.token = rng()

    def log_in(self, token: str) -> str | None:
        """A new session for the token of a link, which is then used up; None for a wrong token."""
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return None
        self.token = self._rng()
        session = self._rng()
        self._sessions[session] = None
        while len(self._sessions) > MAX_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        return session

    def address_refusal(self, request: PageRequest) -> str:
        """The reason why the address of a request is refused, '' for an address of this page."""
        return "" if request.host in self._addresses else FOREIGN_ADDRESS

    def refusal(self, request: PageRequest) -> str:
        """The reason why a request is refused, '' when it is accepted."""
        if problem := self.address_refusal(request):
            return problem
        if self._sessions.keys().isdisjoint(request.sessions):
            return NO_SESSION
        # Browsers send Origin with each request that is an action, and with each WebSocket.
        if request.origin not in self._origins and (request.origin or request.is_action):
            return FOREIGN_PAGE
        return ""
