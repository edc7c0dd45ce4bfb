"""When each host of a team last gave a sign of life, to this host or to anybody who could tell it. Pure.

While nobody is missed nothing is told. Whoever misses a host asks for signs of it, up to a count; that goes
from neighbour to neighbour, each passing on what is new to it. A host that is asked for gives one sign a
second up to that count, and those go round the same way. A count that grows is a sign of life, however many
hosts it came through and however long that took; one that is only repeated is none. So no rumour feeds
itself, no clocks are compared, and of a host that is dead nothing more is told than that it was asked for.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence

from lfield.mobility.fates import Absent
from lfield.mobility.neighbours import Neighbourhood
from lfield.wire.messages import Heard, SignOfLife

#: Seconds between two signs of a host that is asked for, and at least between two tellings.
SIGN_EVERY, TELL_EVERY = 1.0, 0.1
#: A shorter silence than this says nothing: the question and the sign may be as long on their way.
LEAST = 3.0
#: So many signs are asked for at once; when half of them have come, for as many more.
AHEAD = 10
#: How many lives of a host are told apart; an older one's count is news again, once.
MOST_LIVES = 64
#: How many signs one message has, and as many questions, at most: the rest is told in the next.
MOST_SIGNS = 64


class HighestCounts:
    """Of each host the highest count of each of its lives, and what was news of it last."""

    def __init__(self) -> None:
        self._counts: dict[int, dict[int, int]] = {}
        self.newest: dict[int, SignOfLife] = {}

    def of(self, host: int, life: int) -> int:
        """The count of a life; 0 for none."""
        return self._counts.get(host, {}).get(life, 0)

    def take(self, sign: SignOfLife) -> bool:
        """Whether it is news."""
        if sign.count <= self.of(sign.host, sign.incarnation):
            return False
        counts = self._counts.setdefault(sign.host, {})
        counts[sign.incarnation] = sign.count
        if len(counts) > MOST_LIVES:
            del counts[next(iter(counts))]
        self.newest[sign.host] = sign
        return True


class Hearsay:
    """What one host has heard of the others; all times are in seconds of its monotonic clock.

    `hosts` are the deployment's, `here` this host's number, `incarnation` its life, `now` when that began;
    `neighbours` are those that it always has links with, and tells.
    """

    def __init__(
        self,
        hosts: Sequence[str],
        here: int,
        incarnation: int,
        now: float,
        neighbours: Neighbourhood,
    ) -> None:
        self._hosts, self._here, self._incarnation = hosts, here, incarnation
        self._others = [host for number, host in enumerate(hosts) if number != here]
        self._numbers = {host: number for number, host in enumerate(hosts)}
        self._neighbours, self.near = neighbours, neighbours.near
        #: The signs of this host, and up to which count it was asked for them.
        self._count = self._promised = 0
        self._signs, self._questions = HighestCounts(), HighestCounts()
        #: What was news, numbered, the latest last: the sign of a host, or the question for one of its lives,
        #: of which none may hide another. Up to which number each host was told.
        self._news: dict[tuple[bool, int, int], int] = {}
        self._number = 0
        self._told: dict[str, int] = {}
        #: Those that tell this host something: it is a neighbour to them.
        self._tellers: set[str] = set()
        #: The questions of which the signs have not come yet.
        self._owed: dict[str, SignOfLife] = {}
        #: When anything came last from a host in any way, when it was first missed, and those linked.
        self._heard: dict[str, float] = {}
        self._since = dict.fromkeys(neighbours.near, now)
        self._linked: set[str] = set()
        self._began, self._next_sign, self._next_telling = now, now, now
        #: The hosts that have ended for certain, and those of which more than one life was heard of.
        self.gone: set[str] = set()
        self.restarted: set[str] = set()
        #: The last life of each that was linked, and the first that was heard of.
        self._lives: dict[str, int] = {}
        self._first_lives: dict[str, int] = {}
        #: The hosts that did not answer when they were last asked for what they know.
        self.missed: set[str] = set()
        #: When `tell` is due; None when there is nobody to tell of.
        self.due: float | None = now if len(hosts) > 2 else None

    # --- links ----------------------------------------------------------------------------------------

    def is_linked(self, host: str) -> bool:
        """Whether a host can be talked to."""
        return host in self._linked

    @property
    def links(self) -> list[str]:
        """The hosts that can be talked to, in the order of the deployment."""
        return sorted(self._linked, key=self._numbers.__getitem__)

    def wanted(self, now: float) -> frozenset[str]:
        """The hosts to have links with, so that what one host is told goes round."""
        return self._neighbours.wanted(now)

    def linked(self, host: str, incarnation: int) -> bool:
        """A host can be talked to; whether it was restarted since it was last linked."""
        self._linked.add(host)
        self._neighbours.linked(host)
        self._told.pop(host, None)
        self._owed.pop(host, None)
        restarted = self._lives.get(host, incarnation) != incarnation
        if restarted:
            self._pass_on_restart(host, self._lives[host])
        self._lives[host] = incarnation
        self._met(host, incarnation)
        return restarted

    def unlinked(self, host: str, now: float) -> None:
        """It cannot any more."""
        self._linked.discard(host)
        self._neighbours.unlinked(host)
        self._tellers.discard(host)
        self._heard[host] = now
        self._hurry(now)

    def _pass_on_restart(self, host: str, before: int) -> None:
        """All hear of the earlier life so, and of the later one by the sign that answers."""
        number = self._numbers[host]
        self._ask(SignOfLife(number, before, self._signs.of(number, before) + 1))

    def _met(self, host: str, incarnation: int) -> None:
        if self._first_lives.setdefault(host, incarnation) != incarnation:
            self.restarted.add(host)

    # --- what is told ---------------------------------------------------------------------------------

    def tell(self, now: float) -> list[tuple[str, Heard]]:
        """What each neighbour is told now: what is news to it."""
        if now >= self._next_sign:
            self._next_sign = now + SIGN_EVERY
            if self._count < self._promised:
                self._count += 1
                self._add(SignOfLife(self._here, self._incarnation, self._count))
            self._ask_for(self._missing(now))
        listeners = self._listeners() if self._news else []
        told = [(host, news) for host in listeners if (news := self._news_for(host))]
        if told:
            self._next_telling = now + TELL_EVERY
        behind = any(self._told.get(host, 0) < self._number for host in listeners)
        self.due = min(self._next_sign, self._next_telling) if behind else self._next_sign
        return told

    def _listeners(self) -> list[str]:
        to = self._neighbours.chosen | self._tellers
        return [host for host in self._others if host in to and host in self._linked]

    def told(self, host: str, message: Heard, now: float) -> None:
        """Another host tells."""
        self._tellers.add(host)
        before = self._number
        for question in self._known(message.asked):
            self._asked(question, now)
        for sign in self._known(message.signs):
            if sign.host != self._here and self._add(sign):
                self._heard[self._hosts[sign.host]] = now
        if self._number > before and self.due is not None:
            self.due = min(self.due, max(now, self._next_telling))

    def _known(self, signs: Iterable[SignOfLife]) -> list[SignOfLife]:
        return [sign for sign in signs if sign.host < len(self._hosts)]

    def _news_for(self, host: str) -> Heard | None:
        since = self._told.get(host, 0)
        fresh = []
        for key in reversed(self._news):
            if self._news[key] <= since:
                break
            fresh.append(key)
        part = fresh[: -MOST_SIGNS - 1 : -1]
        if not part:
            return None
        self._told[host] = self._news[part[-1]]
        signs = [self._signs.newest[number] for question, number, _ in part if not question]
        asked = [
            SignOfLife(number, life, self._questions.of(number, life))
            for question, number, life in part
            if question
        ]
        return Heard(signs, asked)

    def _note(self, key: tuple[bool, int, int]) -> None:
        self._number += 1
        self._news.pop(key, None)
        self._news[key] = self._number

    def _hurry(self, now: float) -> None:
        """Do at once what is done once a second."""
        self._next_sign = now
        if self.due is not None:
            self.due = now

    # --- signs and questions --------------------------------------------------------------------------

    def _add(self, sign: SignOfLife) -> bool:
        """A sign of life came, or is given; whether it is news."""
        if not self._signs.take(sign):
            return False
        self._note((False, sign.host, 0))
        host = self._hosts[sign.host]
        self._met(host, sign.incarnation)
        owed = self._owed.get(host)
        if owed and (sign.incarnation != owed.incarnation or sign.count >= owed.count):
            del self._owed[host]
        return True

    def _asked(self, question: SignOfLife, now: float) -> None:
        """Somebody misses a host."""
        if not self._ask(question):
            return
        host = self._hosts[question.host]
        if question.host == self._here:
            idle = self._count >= self._promised
            own = question.incarnation == self._incarnation
            wanted = question.count if own else self._count + 1
            self._promised = max(self._promised, min(wanted, self._count + AHEAD))
            if idle:
                self._hurry(now)
        elif question.incarnation:
            # Whoever asks had met it.
            self._heard.setdefault(host, now)

    def _ask(self, question: SignOfLife) -> bool:
        """A question is passed on; whether it is news."""
        if not self._questions.take(question):
            return False
        self._note((True, question.host, question.incarnation))
        if question.host == self._here:
            return True
        host = self._hosts[question.host]
        if question.incarnation:
            self._met(host, question.incarnation)
        if host not in self._linked and self._signs.of(question.host, question.incarnation) < question.count:
            self._owed[host] = question
        return True

    def _missing(self, now: float) -> list[str]:
        """The neighbours that are not there, at first only if they were, and all that did not answer."""
        young = now - self._began < LEAST
        near = {host for host in self.near if host in self._lives or not young}
        return sorted((near | self.missed) - self._linked - self.gone, key=self._numbers.__getitem__)

    def _ask_for(self, hosts: Iterable[str]) -> None:
        for host in hosts:
            number = self._numbers[host]
            newest = self._signs.newest.get(number)
            life = newest.incarnation if newest else self._lives.get(host, 0)
            count = newest.count if newest else 0
            if count + AHEAD // 2 >= self._questions.of(number, life):
                self._ask(SignOfLife(number, life, count + AHEAD))

    # --- who is missing -------------------------------------------------------------------------------

    def whole(self, now: float) -> bool:
        """Whether nobody is missing, and nobody was restarted: then everybody tells of endings.

        In a team too large for links between all, a host that has just started takes nobody for missing yet.
        """
        if now - self._began < LEAST and len(self.near) < len(self._others):
            return True
        return (
            not self.restarted
            and self.near <= self._linked
            and all(now - self._heard.get(host, self._began) < LEAST for host in self._owed)
        )

    def absent(self, answered: Container[str], now: float, lost_after: float, unmet: float) -> Absent:
        """The hosts that did not answer, by what is known of them. From now on they are asked for.

        One is unheard when nobody has heard it for `lost_after` seconds; one of which no sign ever came here,
        for `unmet` seconds.
        """
        unheard, elsewhere = {}, []
        silent_hosts = [host for host in self._others if host not in answered and host not in self.gone]
        self.missed = set(silent_hosts) - self._linked
        for host in silent_hosts:
            last = now if host in self._linked else self._heard.get(host)
            silent = now - (self._since.setdefault(host, now) if last is None else last)
            if silent >= (unmet if last is None else max(lost_after, LEAST)):
                unheard[host] = silent
            else:
                elsewhere.append(host)
        return Absent(self.gone, unheard, elsewhere, self._lives)
