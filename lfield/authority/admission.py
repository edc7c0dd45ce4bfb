"""Whom one host lets in now: its own keys, what time it believes it is, and whose certificates count no more.

A core: it is asked and told, and does nothing itself. `lfield.authority.judge` decides; here is what it
must know. Where there are no keys nobody is judged: then links are between simulated hosts, or lead to a
command of this computer, whom the kernel knows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING

from msgspec.structs import replace

from lfield.authority.judge import ALL_IS_WELL, NOBODY, Verdict, judged

if TYPE_CHECKING:
    from lfield.authority.believed import BelievedTime
    from lfield.authority.identity import Identity, Right
    from lfield.authority.judge import Known, Revoked
    from lfield.authority.keys import Keys
    from lfield.wire.messages import Hello


#: So many certificates of a list are named in a line.
_NAMED = 8


class Admission:
    """Nobody is judged."""

    #: The own revocation list as it travels, and its number; empty and 0 where there is none.
    list, number = b"", 0
    #: Why the own list may be lost with this process, and what that means, in a sentence; '' when it is kept.
    unkept = ""

    def __init__(self) -> None:
        #: Whether the mission of this host goes on; and what keeps a new list for its next life.
        self.flies: Callable[[], bool] = lambda: False
        self.keep: Callable[[bytes], None] = lambda data: None
        #: Where lines for the log go.
        self.note: Callable[[str], None] = lambda line: None
        #: What the mission takes of somebody's rights, and by which rule, in a sentence.
        self.barred: Callable[[Identity], Mapping[Right, str]] = lambda who: {}

    def serve(
        self,
        flies: Callable[[], bool],
        barred: Callable[[Identity], Mapping[Right, str]],
        note: Callable[[str], None],
    ) -> None:
        """Whom it is asked for."""
        self.flies, self.barred, self.note = flies, barred, note

    def verdict(self, who: Identity, *, linked: bool = False, expected: str = "") -> Verdict:
        """What somebody is good for now; `linked`: by a link of a host. `expected` is who was called."""
        return ALL_IS_WELL

    def signed(self, hello: Hello) -> Hello:
        """The greeting with what others must know of this host's time and list."""
        return hello

    def greeted(self, who: Identity, hello: Hello) -> None:
        """Somebody was let in, and says so."""

    def news(self, data: bytes) -> str:
        """Take a revocation list: what to tell of it, in a line; '' when nothing in it is new.

        Raises KeysError for a bad one.
        """
        return ""

    def line(self) -> str:
        """What to tell of the time, once: '' when this computer's clock is believed."""
        return ""


class Judged(Admission):
    """Whoever has a certificate is judged by it. `own` is this host.

    `revoked` is the own list as it was read, `data` as it travels.
    """

    def __init__(
        self,
        keys: Keys,
        own: Identity,
        time: BelievedTime,
        revoked: Revoked = NOBODY,
        data: bytes = b"",
    ) -> None:
        super().__init__()
        self._authority, self.own, self.time = keys.authority, own, time
        self.revoked, self.list, self.number = revoked, data, revoked.number
        #: The digests of the authority's lists that held nothing new: nothing in them ever will be.
        self._old: set[bytes] = set()
        #: Those who have greeted in this mission, by the numbers of their certificates.
        self._greeted: dict[str, str] = {}
        time.proven(own.begins, f"the certificate of {own}")
        time.proven(revoked.at, f"revocation list {revoked.number}")

    def verdict(self, who: Identity, *, linked: bool = False, expected: str = "") -> Verdict:
        known: Known = "linked" if linked else "greeted" if who.serial in self._greeted else "new"
        if who.authority == self.own.authority:
            # The authority writes no time that is yet to come.
            self.time.proven(who.begins, f"the certificate of {who}")
        judge = partial(
            judged,
            who,
            at=self.time.now(),
            authority=self.own.authority,
            revoked=self.revoked,
            known=known,
            expected=expected,
        )
        # Every link is judged every second, and mostly it does not matter whether anything flies.
        found = judge(flies=False)
        if found.extent != "all" and known != "new":
            found = judge(flies=self.flies())
        barred = self.barred(who)
        return Verdict(found.extent, found.why, barred) if barred else found

    def signed(self, hello: Hello) -> Hello:
        return replace(hello, time=self.time.to_say(), revoked=self.number)

    def greeted(self, who: Identity, hello: Hello) -> None:
        self.time.told(hello.time, who)
        self._greeted[who.serial] = str(who)

    def news(self, data: bytes) -> str:
        if data == self.list or (digest := sha256(data).digest()) in self._old:
            return ""
        # Large, and of no use to whoever has no keys.
        from lfield.authority.reading import revoked_in

        own, read = self.revoked, revoked_in(data, self._authority)
        newer = read.number > own.number
        if not newer and read.serials <= own.serials:
            self._old.add(digest)
            return ""
        # Nothing that the authority has ever revoked is good again.
        self.revoked = own.united(read)
        if newer:
            self.list, self.number = data, read.number
            self.time.proven(read.at, f"revocation list {read.number}")
            self.keep(data)
        return f"revocation list {read.number} has come" + (_lost(own, read) if newer else _lost(read, own))

    def kept(self, why: str) -> None:
        """The own list is kept for the next life of this host, or `why` it is not."""
        if why:
            known = {self._greeted[serial] for serial in self.revoked.serials & self._greeted.keys()}
            names = f" ({', '.join(sorted(known))})" if known else ""
            why = (
                f"revocation list {self.number} is not kept: {why}. After a restart this host would let in "
                f"whom it revokes{names}: make room, or copy the list to its keys"
            )
        if why != self.unkept:
            self.note(why or f"revocation list {self.number} is kept now")
        self.unkept = why

    def line(self) -> str:
        return self.time.line()


def _lost(older: Revoked, newest: Revoked) -> str:
    """What a list does not revoke that another one does, and what to do; '' where there is nothing."""
    lost = sorted(older.serials - newest.serials)
    if not lost:
        return ""
    named, more = ", ".join(lost[:_NAMED]), f" and {len(lost) - _NAMED} more" if len(lost) > _NAMED else ""
    other = "another one of that number" if older.number == newest.number else f"list {older.number}"
    return (
        f"; list {newest.number} does not revoke {named}{more}, which {other} does: an older copy of the "
        f"authority was put back. This host believes none of these until it ends; revoke them again: 'lfield "
        f"keys revoke serial {lost[0]}'"
    )
