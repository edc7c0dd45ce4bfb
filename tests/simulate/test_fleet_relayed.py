"""A link breaks during a hop while other hosts connect its two ends: they agree on the holder."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import pytest

from lfield.mission.loader import load_mission
from lfield.replication.transfer.query_relay import MAX_PER_SECOND
from lfield.simulate.host_fleet import Fleet, FleetOptions, copies
from lfield.wire.coordinator_messages import CoordinatorState, TransferAccepted, TransferQuery
from lfield.wire.messages import LivenessCounter, RelayedMessage
from simulation_testing.invariants.host_taps import tap_calls

POST = """
resource Post {
    init(string[] arg) { }
    portal visit(int number) emit int {
        write("visit " + i2s(number) + "\\n");
        sleep(0.05);
        return number + 1;
    }
}
"""
#: A coordinator that hops between two hosts, in each of the possible ways.
WAYS = {
    "call": "number = posts[turn % 2].visit(turn);",
    "together": "together { number = posts[turn % 2].visit(turn); other = posts[(turn + 1) % 2].visit(-1); }",
    "reserve": "reserve (posts[turn % 2]) { number = posts[turn % 2].visit(turn); }",
}
WALKER = """
coordinator Walker {{
    init(string[] arg) {{
        {recovered}
        Post[] posts = new Post[2];
        posts[0] = findPost("b");
        posts[1] = findPost("a");
        int number = 0;
        int other = 0;
        sleep(1.0);
        for (int turn = 0; true; turn = turn + 1) {{
            try {{ {way} }}
            catch (UnreachableResourceException gone) {{ print("gone"); }}
            catch (RestartException gone) {{ print("again"); }}
            catch (ReservationLostException gone) {{ print("again"); }}
            sleep(0.2);
        }}
    }}
}}
"""
#: Seconds after the end of a link within which both hosts know where the coordinator is, and those within
#: which a silent link is given up.
KNOWN_WITHIN, NOTICED_WITHIN = 2.0, 6.0


class Team(Fleet):
    """Hosts a and b, and others that connect them: `path` has the names in between, which form a chain."""

    def __init__(
        self, folder: Path, way: str, path: str = "c", recovered: str = "", call_timeout: float = 10.0
    ) -> None:
        hosts = sorted({"a", "b", *path})
        lines = [f"//Post:{host}@{host}" for host in hosts] + ["//Walker:walker@a"]
        text = POST + WALKER.format(way=WAYS[way], recovered=recovered)
        (folder / "mission.L").write_text(text)
        (folder / "mission.dL").write_text("\n".join([*lines, ""]))
        self.row = ["a", *path, "b"]
        self.doubts: list[tuple[float, list[str]]] = []
        self.cut_at = float("inf")
        options = FleetOptions(unreachable_after=call_timeout)
        super().__init__(load_mission(folder / "mission.dL", simulate=True), 1, options=options)
        # A new start waits for links with all hosts.
        self.later(0.5, lambda: self._only_in_a_row(hosts))

    def _only_in_a_row(self, hosts: list[str]) -> None:
        for one, other in combinations(hosts, 2):
            if abs(self.place(one) - self.place(other)) > 1 and {one, other} != {"a", "b"}:
                self.cut(one, other)

    def place(self, host: str) -> int:
        return self.row.index(host)

    def break_link(self, ways: str) -> None:
        """Break the direct link of a and b: in 'both' directions with notice, or one direction is silent."""
        if self.cut_at < self.now:
            return
        self.cut_at = self.now
        for near, far in (("a", "b"), ("b", "a")):
            if ways in ("both", near + far):
                self.network.silence(near, far)
        if ways == "both":
            # Messages in flight are lost with it.
            self.later(0.0, lambda: self.network.reset("a", "b"))

    def known(self, host: str) -> CoordinatorState | None:
        """The newest start that a host knows."""
        rows = self.runs[host].core.mobility.known_states()
        return max(rows, key=lambda row: row.generation, default=None)

    def waiting(self) -> list[str]:
        """The hosts of the two in doubt about the coordinator."""
        rows = [(host, self.known(host)) for host in ("a", "b")]
        return [host for host, row in rows if row and row.state in ("PREPARED", "IN DOUBT")]

    def watch_for(self, seconds: float) -> None:
        """Advance time; assert that the two are not both in doubt."""
        end = self.now + seconds
        while self.now < end:
            self.run(0.1)
            in_doubt = [host for host in ("a", "b") if (row := self.known(host)) and row.state == "IN DOUBT"]
            assert len(in_doubt) < 2, f"both hosts are in doubt at {self.now:.1f} s"
            assert max(map(len, copies(self).values()), default=0) <= 1


def at_the_offer(team: Team, strike: Callable[[], None]) -> None:
    """The link breaks before anything is sent."""
    tap(team, "a", "depart", strike, before=True)


def when_it_is_sent(team: Team, strike: Callable[[], None]) -> None:
    """The transfer is lost."""

    def send_transfer(go: Callable[..., None], *given: object) -> None:
        strike()
        go(*given)

    tap_calls(team.runs["a"].host.peers, send_transfer)


def when_it_has_arrived(team: Team, strike: Callable[[], None]) -> None:
    """The transfer has arrived, and is not durable."""
    tap(team, "b", "on_transfer", strike, before=False)


def when_it_is_acknowledged(team: Team, strike: Callable[[], None]) -> None:
    """The answer is lost."""

    def send(go: Callable[..., None], host: str, message: object) -> None:
        if isinstance(message, TransferAccepted) and host == "a":
            strike()
        go(host, message)

    tap_calls(team.runs["b"].host.peers, send)


def when_it_comes_back(team: Team, strike: Callable[[], None]) -> None:
    """The coordinator returns from b; its transfer and all acknowledgements of b are lost."""

    def send(go: Callable[..., None], host: str, message: object) -> None:
        if not isinstance(message, TransferAccepted):
            go(host, message)

    def send_transfer(go: Callable[..., None], *given: object) -> None:
        strike()
        go(*given)

    for tapped in (send, send_transfer):
        tap_calls(team.runs["b"].host.peers, tapped)


def tap(team: Team, host: str, name: str, strike: Callable[[], None], *, before: bool) -> None:
    """Call `strike` before or after the first call of a method of a host's core, or of its mobility."""
    core = team.runs[host].core

    def tapped(go: Callable[..., object], *given: object) -> object:
        if before:
            strike()
        result = go(*given)
        if not before:
            strike()
        return result

    tapped.__name__ = name
    tap_calls(core if hasattr(core, name) else core.mobility, tapped)


PHASES = [at_the_offer, when_it_is_sent, when_it_has_arrived, when_it_is_acknowledged, when_it_comes_back]
by_phase = pytest.mark.parametrize("phase", PHASES, ids=lambda phase: phase.__name__)


def judged(team: Team, phase: Callable[[Team, Callable[[], None]], None], ways: str) -> None:
    """Break the link in a phase: both hosts agree soon, and the coordinator continues without the link."""
    team.later(0.5, lambda: phase(team, lambda: team.break_link(ways)))
    team.watch_for(2.5)
    assert team.cut_at < team.now
    noticed = team.cut_at + (0.1 if ways == "both" else NOTICED_WITHIN)
    team.watch_for(noticed + KNOWN_WITHIN - team.now)
    assert team.waiting() == [], f"{[team.known(host) for host in ('a', 'b')]}"
    visit_count = sum("visit" in text for _, _, text in team.log)
    team.watch_for(16.0)
    assert team.waiting() == []
    assert sum("visit" in text for _, _, text in team.log) > visit_count
    visit_lines = [text for _, _, text in team.log if text.startswith("visit ") and "-1" not in text]
    assert len(visit_lines) == len(set(visit_lines)), "a portal was called twice"


@pytest.mark.few(5)
@by_phase
@pytest.mark.parametrize("way", WAYS)
def test_a_third_host_relays_the_query_and_the_answer(tmp_path, phase, way):
    judged(Team(tmp_path, way), phase, "both")


@by_phase
@pytest.mark.parametrize("ways", ["ab", "ba"])
@pytest.mark.few(3)
def test_one_silent_direction_leads_to_agreement(tmp_path, phase, ways):
    judged(Team(tmp_path, "call"), phase, ways)


@by_phase
@pytest.mark.parametrize("ways", ["ab", "ba"])
@pytest.mark.few(3)
def test_a_short_call_time_out_makes_no_doubt_before_the_silent_link_is_closed(tmp_path, phase, ways):
    judged(Team(tmp_path, "call", call_timeout=0.5), phase, ways)


@by_phase
@pytest.mark.few(2)
def test_a_chain_of_hosts_relays_query_and_answer(tmp_path, phase):
    judged(Team(tmp_path, "call", path="cdef"), phase, "both")


@by_phase
@pytest.mark.few(2)
def test_under_leases_a_broken_link_causes_no_recovery(tmp_path, phase):
    team = Team(tmp_path, "call", recovered="heartbeatInterval(-1);")
    judged(team, phase, "both")
    assert not any("recovered on this host" in text for _, _, text in team.log)


CHAIN = """
coordinator Walker {
    init(string[] arg) {
        sleep(1.0);
        findPost("z").visit(1);
        findPost("y").visit(2);
        findPost("w").visit(3);
    }
}
"""


def test_any_host_with_proof_ends_a_doubt_about_a_lost_host(tmp_path):
    """Both the sender to such a host and the last holder, which sent it to another one, would be in doubt."""
    (tmp_path / "mission.L").write_text(POST + CHAIN)
    (tmp_path / "mission.dL").write_text("".join(f"//Post:{h}@{h}\n" for h in "awyz") + "//Walker:walker@a\n")
    fleet = Fleet(
        load_mission(tmp_path / "mission.dL", simulate=True), 1, options=FleetOptions(unreachable_after=2.0)
    )

    def send(go: Callable[..., None], host: str, message: object) -> None:
        if not (isinstance(message, TransferAccepted) and host == "a"):
            go(host, message)

    def send_transfer(go: Callable[..., None], *given: object) -> None:
        fleet.later(0.0, lambda: [fleet.crash(name) for name in "wz"])
        go(*given)

    tap_calls(fleet.runs["z"].host.peers, send)
    tap_calls(fleet.runs["y"].host.peers, send_transfer)
    fleet.run(16.0)
    assert set(fleet.runs) == {"a", "y"}
    states = [fleet.runs[name].core.mobility.known_states()[0].state for name in "ay"]
    assert states == ["MOVED", "IN DOUBT"]


def test_the_relayed_messages_of_one_sender_are_limited(tmp_path):
    team = Team(tmp_path, "call")
    team.run(0.5)
    core, sent = team.runs["c"].core, []
    core.drain_effects()
    for count in range(1, 3 * MAX_PER_SECOND):
        question = TransferQuery("walker", 1, 9, 1)
        core.on_message("a", RelayedMessage(LivenessCounter(0, 7, count), 1, question))
        core.on_message("a", RelayedMessage(LivenessCounter(0, 7, count), 1, question))
        sent += [
            effect
            for effect in core.drain_effects()
            if isinstance(getattr(effect, "message", None), RelayedMessage)
        ]
    assert [effect.host for effect in sent] == ["b"] * MAX_PER_SECOND
    core.on_message("a", RelayedMessage(LivenessCounter(99, 7, 1), 1, question))
    core.on_message("a", RelayedMessage(LivenessCounter(1, 7, 1), 99, question))
    core.on_message("a", RelayedMessage(LivenessCounter(2, 7, 1), 1, question))
    assert not [
        effect
        for effect in core.drain_effects()
        if isinstance(getattr(effect, "message", None), RelayedMessage)
    ]
