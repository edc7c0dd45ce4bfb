"""Connection attempts at silent addresses: repeated attempts, and a new link beside a silent one."""

from __future__ import annotations

import asyncio
import socket

import pytest

from lfield import address_race
from lfield.address_race import (
    ATTEMPT_TIMEOUT,
    FIRST_PAUSE,
    FORGET_AFTER,
    LONGEST_PAUSE,
    RetryPace,
    first_connected,
    retry_pause,
)
from lfield.errors import AddressError
from lfield.net.connections.dialler import Dialler
from lfield.net.link_owner import RefusedHosts
from lfield.net.session import Session
from lfield.simulate.jumping_loop import LoopClock, run_jumping

PLACE = (socket.AF_INET, ("192.0.2.1", 7001))


class Path:
    """Connection attempts in place of sockets: an attempt that begins after `back` is answered 0.1 s later,
    an earlier one never."""

    def __init__(self, monkeypatch, back: float, *, refuses: bool = False) -> None:
        self.back, self.start, self.refuses = back, 0.0, refuses
        self.began: list[float] = []
        self.open = self.most = self.closed = 0
        monkeypatch.setattr(address_race, "_connect", self.connected)

    async def connected(self, family, address):
        loop = asyncio.get_running_loop()
        self.began.append(loop.time())
        self.open += 1
        self.most = max(self.most, self.open)
        try:
            if loop.time() < self.start + self.back:
                await asyncio.sleep(3600.0)
            await asyncio.sleep(0.1)
            if self.refuses:
                raise ConnectionRefusedError("refused")
            return self
        finally:
            self.open -= 1

    def close(self):
        self.closed += 1


def race(path: Path, *places, pause: float | None = FIRST_PAUSE):
    """Time until a socket was connected, the socket, its address, and the failures."""

    async def scenario():
        failures: dict = {}
        path.start = asyncio.get_running_loop().time()
        async with asyncio.timeout(60.0):
            made, at = await first_connected(places or (PLACE,), failures, retry_pause=pause)
        await asyncio.sleep(1.0)
        return asyncio.get_running_loop().time() - path.start - 1.0, made, at, failures

    return run_jumping(scenario())


@pytest.mark.parametrize("back", [0.0, 0.3, 5.0, 30.0])
def test_an_attempt_begins_at_most_half_a_second_after_the_path_is_back(monkeypatch, back):
    path = Path(monkeypatch, back)
    at, made, where, failures = race(path)
    assert at <= back + FIRST_PAUSE + 0.1 + 1e-6
    assert (made, where, failures) == (path, PLACE, {})
    assert path.open == 0


def test_few_attempts_are_pending_at_once(monkeypatch):
    path = Path(monkeypatch, 30.0)
    race(path)
    assert path.most <= ATTEMPT_TIMEOUT / FIRST_PAUSE + 1
    assert len(path.began) <= 30.0 / FIRST_PAUSE + 2


def test_the_pause_between_attempts_grows_with_the_silence():
    pace, now, count = RetryPace(), 0.0, 0
    assert pace.on_attempt("b:1", now) == FIRST_PAUSE
    while now < 3600.0:
        pause = pace.on_attempt("b:1", now)
        assert pause == retry_pause(now) <= max(FIRST_PAUSE, now / 10)
        now, count = now + pause, count + 1
    # Three packets of 60 bytes each: an absent robot costs less than an idle link (40 bytes per second).
    assert count * 180 / 3600.0 < 30.0
    assert pace.on_attempt("c:1", now) == FIRST_PAUSE
    pace.on_answer("b:1")
    assert pace.on_attempt("b:1", now) == FIRST_PAUSE


def test_an_address_that_was_unused_for_a_while_starts_with_the_first_pause():
    pace = RetryPace()
    for now in range(0, 300, 10):
        pause = pace.on_attempt("b:1", float(now))
    assert pause == LONGEST_PAUSE
    assert pace.on_attempt("b:1", 300.0 + FORGET_AFTER) == FIRST_PAUSE


def test_without_a_retry_pause_one_attempt_is_made(monkeypatch):
    path = Path(monkeypatch, 5.0)
    with pytest.raises(TimeoutError):
        race(path, pause=None)
    assert len(path.began) == 1


def test_an_address_that_refuses_is_not_retried(monkeypatch):
    path = Path(monkeypatch, 0.0, refuses=True)
    with pytest.raises(ConnectionRefusedError):
        race(path)
    assert len(path.began) == 1


def test_attempts_that_are_answered_too_late_are_closed(monkeypatch):
    """Two attempts are answered: one is used."""
    path = Path(monkeypatch, 0.0)
    other = (socket.AF_INET, ("192.0.2.2", 7001))
    monkeypatch.setattr(address_race, "ATTEMPT_DELAY", 0.0)
    _, made, _, _ = race(path, PLACE, other)
    assert made is path
    assert path.closed == len(path.began) - 1


class Silent:
    """Has a link with bravo that may become silent, and dials it; the dial fails after 0.2 s."""

    def __init__(self) -> None:
        self.link, self.calls, self.taken = Session(self, None), list[float](), list[str]()
        self.refusals = RefusedHosts(["bravo"])
        self.on_call = lambda: None

    def needs_link(self, host):
        return True

    def link_of(self, host):
        return self.link

    def ban_remaining(self, host):
        return 0.0

    def on_dialled(self, host):
        pass

    def now(self):
        return asyncio.get_running_loop().time()

    async def connect(self, address, handler, host=""):
        self.calls.append(self.now())
        await asyncio.sleep(0.2)
        self.on_call()
        raise AddressError(address, "no answer")


def test_a_silent_link_is_dialled_beside_until_it_recovers():
    async def scenario():
        owner = Silent()
        dialler = Dialler(owner, owner, LoopClock(), "bravo", "b:1", lambda text: None)
        await asyncio.sleep(10.0)
        assert owner.calls == []
        owner.link.suspect()
        await asyncio.sleep(5.0)
        assert len(owner.calls) >= 5.0 / FIRST_PAUSE - 1
        # A message arrives over it.
        owner.link.linked_at = 0.0
        owner.link._on_accepted(None)
        assert not owner.link.is_suspected
        count = len(owner.calls)
        await asyncio.sleep(5.0)
        assert len(owner.calls) <= count + 1
        dialler.cancel()

    run_jumping(scenario())


class Opened:
    """A connection that was made."""

    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize("recovers", [True, False])
def test_a_new_connection_is_used_unless_the_old_link_has_recovered(recovers):
    async def scenario():
        owner, opened, used = Silent(), Opened(), []

        async def connect(address, session, host=""):
            session.open = used.append
            await asyncio.sleep(0.2)
            if recovers:
                owner.link.is_suspected = False
            session.closed.set()
            return opened

        owner.connect = connect
        owner.link.suspect()
        dialler = Dialler(owner, owner, LoopClock(), "bravo", "b:1", lambda text: None)
        await asyncio.sleep(0.25)
        dialler.cancel()
        assert (opened.closed, used) == (recovers, [] if recovers else [opened])

    run_jumping(scenario())
