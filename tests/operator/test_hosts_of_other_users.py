"""Requests to hosts that other users claim: limited in number and time, without a delay for own hosts."""

from __future__ import annotations

import asyncio
import gc
import socket
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from lfield.errors import AddressError, NoListener
from lfield.net.tcp_transport import TcpTransport
from lfield.net.transport import is_number
from lfield.operator import client
from lfield.operator.client import SNAPSHOT, ask_all, ask_in_turn, unanswered_by_name
from lfield.operator.observer_link import Request
from lfield.operator.runs import Run, RunManifest
from lfield.operator.targets import HostRef, TargetTeam
from lfield.simulate.jumping_loop import run_jumping
from lfield.wire.subscription_messages import EventBatch


class Doors:
    """Sockets without answers: refused if `listens` is false, else silent. Counts concurrent requests."""

    def __init__(self, listens: Callable[[str], bool]) -> None:
        self._listens = listens
        self.asked: list[str] = []
        self.now, self.most = 0, 0

    async def connect(self, address, handler, host=""):
        self.asked.append(address)
        self.now += 1
        self.most = max(self.most, self.now)
        try:
            if self._listens(address):
                await asyncio.Event().wait()
            raise NoListener(address)
        finally:
            self.now -= 1

    async def listen(self, address, on_link):
        raise NotImplementedError


def own(count: int) -> dict[HostRef, str]:
    return {HostRef("tour-1", f"h{number}"): f"unix:/own/{number}" for number in range(count)}


def claimed(count: int, user: str = "mallory") -> dict[HostRef, str]:
    return {
        HostRef(f"{user}/tour-1", f"h{number}", user): f"unix:/{user}/{number}" for number in range(count)
    }


def answers(doors: Doors, places: Mapping[HostRef, str]) -> tuple[float, dict[HostRef, object]]:
    """The answers, and the time they take (s)."""

    async def main():
        started = asyncio.get_running_loop().time()
        found = await ask_all(doors, places, SNAPSHOT)
        return asyncio.get_running_loop().time() - started, found

    return run_jumping(main())


def mute(address: str) -> bool:
    return "mallory" in address


def test_thousands_of_silent_claimed_hosts_cost_one_timeout():
    doors = Doors(mute)
    took, found = answers(doors, claimed(4000) | own(3))
    assert took == pytest.approx(SNAPSHOT.timeout)
    assert doors.most <= client.MAX_FOREIGN + 3
    assert len(doors.asked) <= client.MAX_FOREIGN + 3
    assert [type(found[place]) for place in own(3)] == [NoListener] * 3
    assert "no answer of the runs of other users within 2 s" in str(
        found[HostRef("mallory/tour-1", "h9", "mallory")]
    )


def test_trusted_hosts_are_asked_first():
    doors = Doors(mute)
    answers(doors, claimed(5) | own(3))
    assert doors.asked[:3] == list(own(3).values())


def test_claims_of_one_user_do_not_delay_those_of_another():
    doors = Doors(mute)
    _, found = answers(doors, claimed(4000) | claimed(3, "ann"))
    assert [type(found[place]) for place in claimed(3, "ann")] == [NoListener] * 3
    assert doors.most <= client.MAX_FOREIGN


def test_a_large_team_is_asked_a_limited_number_of_hosts_at_a_time():
    doors = Doors(lambda _: False)
    _, found = answers(doors, own(client.MAX_AT_ONCE + 100))
    assert len(found) == client.MAX_AT_ONCE + 100
    assert doors.most <= client.MAX_AT_ONCE


def test_no_name_of_another_user_is_resolved():
    doors = Doors(lambda _: False)
    named, numbered = HostRef("mallory/tour-1", "a", "mallory"), HostRef("mallory/tour-1", "b", "mallory")
    _, found = answers(doors, {named: "slow.example:1", numbered: "10.0.0.2:1"})
    assert doors.asked == ["10.0.0.2:1"]
    assert "name the run with --run to use it" in str(found[named])
    assert [is_number(text) for text in ("[fe80::1]:7", "10.0.0.2", "robot:1", "[", "")] == [
        True,
        True,
        False,
        False,
        False,
    ]


def test_claimed_hosts_of_one_user_are_one_line():
    names = {place: f"{place.run}/{place.host}" for place in (*claimed(9), *own(9), *claimed(2, "ann"))}
    found = {place: NoListener("x") for place in names}
    lines = list(unanswered_by_name(found, names))
    assert lines == [
        "9 hosts of mallory/tour-1",
        *(f"tour-1/h{number}" for number in range(9)),
        "ann/tour-1/h0",
        "ann/tour-1/h1",
    ]


# --- with real sockets ---------------------------------------------------------------------------


@pytest.fixture
def doors():
    """A folder with a socket of a manifest that listens and does not accept connections."""
    with tempfile.TemporaryDirectory(prefix="lf-") as path, socket.socket(socket.AF_UNIX) as listening:
        listening.bind(f"{path}/x.sock")
        listening.listen(4096)
        yield Path(path)


def run_in(folder: Path, count: int, **whose) -> TargetTeam:
    hosts = [f"h{number}" for number in range(count)]
    note = RunManifest("m.dL", "d" * 64, 1, 0.0, 1.0, dict.fromkeys(hosts, "127.0.0.1:1"), {})
    run = Run(folder, note, **whose)
    return TargetTeam((run,), dict.fromkeys(hosts, f"unix:{folder}/x.sock"))


def test_trusted_answers_come_before_those_of_other_users(doors, tmp_path):
    quick = Request(SNAPSHOT.message, EventBatch, 0.3)
    parties = [run_in(doors, 600, owner="mallory", is_foreign=True), run_in(tmp_path, 2)]
    turns = ask_in_turn(parties, quick)
    first = next(turns)
    assert [type(answer) for answer in first.values()] == [NoListener] * 2
    (rest,) = turns
    assert len(rest) == 600
    assert all(isinstance(answer, AddressError) for answer in rest.values())


def test_answers_are_reported_while_another_host_is_still_asked(doors, monkeypatch):
    monkeypatch.setattr(client, "REPORT_AFTER", 0.05)
    target = run_in(doors, 2)
    unreachable = dict.fromkeys(["h1"], f"unix:{doors}/closed.sock")
    target = TargetTeam(target.runs, {**target.addresses, **unreachable})
    turns = ask_in_turn([target], Request(SNAPSHOT.message, EventBatch, 0.5))
    first = next(turns)
    assert [(place.host, type(answer)) for place, answer in first.items()] == [("h1", NoListener)]
    (rest,) = turns
    assert [(place.host, type(answer)) for place, answer in rest.items()] == [("h0", AddressError)]


@pytest.mark.few(0)
async def test_links_that_end_while_connecting_leave_no_pending_futures(doors):
    """Python itself prints a future with an unread exception on stderr."""
    lines: list[str] = []

    class Ending(TcpTransport):
        async def connect(self, address, handler, host=""):
            handler.on_closed(None, NoListener(address))
            raise AddressError(address, "no answer within 2 s")

    asyncio.get_running_loop().set_exception_handler(lambda _, context: lines.append(context["message"]))
    found = await ask_all(Ending(1 << 20), {"a": f"unix:{doors}/x.sock"}, SNAPSHOT)
    # An error keeps its traceback.
    kinds = [type(answer) for answer in found.values()]
    del found
    gc.collect()
    assert kinds == [AddressError]
    assert lines == []
