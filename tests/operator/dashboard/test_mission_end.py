"""The end of a mission as observed by a subscriber of its hosts."""

from __future__ import annotations

from dashboard_script import ScriptedHost, snapshot
from msgspec.structs import replace

from lfield.clock import ManualClock
from lfield.errors import AddressError
from lfield.operator.team_model.mission_end import LOST_QUERIES, QUERY_INTERVAL, SETTLE_TIME, MissionEnd
from lfield.wire import events
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.events import StateEvent
from lfield.wire.observer_messages import JournalStatus, LinkStatus, StartStatus, Status
from lfield.wire.subscription_messages import EventBatch

HOMES = {"boss": "alpha"}
LOST_AFTER = 15.0
JOURNAL = JournalStatus(0, "", [])


class Watched:
    """A team of alpha and beta, and the decision on the end of its mission."""

    def __init__(self, homes: dict[str, str] | None = HOMES, up: float = 100.0) -> None:
        self.clock = ManualClock()
        self.end = MissionEnd(["alpha", "beta"], homes, LOST_AFTER, self.clock)
        self.hosts = {"alpha": ScriptedHost(7), "beta": ScriptedHost(8)}
        self.up = up

    def batch(self, host: str, *whats: StateEvent, state: Status | None = None) -> EventBatch:
        return self.hosts[host].batch(self.up + self.clock.now - 1000.0, *whats, snapshot=state)

    def send(self, host: str, *whats: StateEvent, state: Status | None = None) -> Watched:
        """A batch of a host."""
        self.end.on_batch(host, self.batch(host, *whats, state=state), None)
        return self

    def link(self, **states: Status) -> Watched:
        """Both hosts answer for the first time."""
        for host in self.hosts:
            self.send(host, state=states.get(host, status(host)))
        return self

    def query(self, **states: Status | None) -> None:
        """All hosts are queried; None: no answer."""
        answers = {host: states.get(host, status(host)) for host in self.hosts}
        self.end.on_answers(
            {
                host: AddressError(host, "away") if state is None else self.batch(host, state=state)
                for host, state in answers.items()
            }
        )

    def restart(self, host: str) -> None:
        self.end.on_unlinked(host, "gone")
        self.hosts[host] = ScriptedHost(self.hosts[host].incarnation + 10)

    def wait(self, seconds: float) -> None:
        self.clock.advance(seconds)

    @property
    def ends(self) -> list[tuple[str, str]] | None:
        self.end.check()
        found = self.end.outcomes
        return None if found is None else [(each.agent, each.outcome) for each in found]


def status(host: str, *known: CoordinatorState, **changes: object) -> Status:
    return replace(snapshot(host), coordinators=list(known), **changes)


def copy(state: str, generation: int = 1, **fields: object) -> CoordinatorState:
    return replace(CoordinatorState("boss", generation, 1, 1, "RUN"), state=state, **fields)


def left(sequence: int, to: str) -> StateEvent:
    return events.MigrationStarted("boss", 1, sequence, to, "two", "go", 500)


def came(sequence: int, of: str) -> StateEvent:
    return events.MigrationArrived("boss", 1, sequence, of, 500)


def confirmed(sequence: int, to: str) -> StateEvent:
    return events.MigrationConfirmed("boss", 1, sequence, to, 0.01)


STARTED = events.AgentStarted("boss", 1)
DONE = events.AgentFinished("boss", 1, "done")


def test_mission_ends_with_its_last_coordinator():
    team = Watched({"boss": "alpha", "aide": "beta"}).link()
    team.send("alpha", STARTED).send("beta", events.AgentStarted("aide", 1))
    team.send("alpha", DONE)
    assert team.ends is None
    team.send("beta", events.AgentFinished("aide", 1, "died", "why"))
    assert team.ends == [("aide", "died"), ("boss", "done")]


def test_resources_that_start_and_die_are_not_coordinators():
    team = Watched().link().send("alpha", STARTED, events.AgentStarted("one", 1))
    team.send("alpha", events.AgentFinished("one", 1, "died"))
    assert team.ends is None
    assert team.send("alpha", DONE).ends == [("boss", "done")]


def test_an_ended_mission_is_known_from_the_snapshots():
    team = Watched().link(beta=status("beta", copy("EXITED", outcome="done", where="beta")))
    assert team.ends == [("boss", "done")]


def test_nothing_is_decided_before_a_host_has_answered():
    assert Watched({}).ends is None
    assert Watched({}).link().ends == []


def test_a_coordinator_in_transit_is_alive_in_any_order_of_reports():
    team = Watched().link().send("alpha", STARTED)
    team.send("alpha", left(1, "beta"))
    team.query(alpha=status("alpha", copy("PREPARED", where="beta")))
    assert team.ends is None
    # The sender confirms before the receiver's event arrives here.
    team.send("alpha", confirmed(1, "beta"))
    assert team.ends is None
    team.query(alpha=status("alpha", copy("MOVED", where="beta")))
    assert team.ends is None
    team.send("beta", came(1, "alpha"))
    team.query(alpha=status("alpha", copy("MOVED", where="beta")), beta=status("beta", copy("RUN")))
    for _ in range(LOST_QUERIES):
        team.query(alpha=status("alpha", copy("MOVED", where="beta")), beta=status("beta", copy("RUN")))
    assert team.ends is None
    assert team.send("beta", DONE).ends == [("boss", "done")]


def test_a_late_confirmation_does_not_move_a_coordinator_that_returned():
    team = Watched().link().send("alpha", STARTED, left(1, "beta"))
    team.send("alpha", came(2, "beta"), confirmed(1, "beta"))
    for _ in range(LOST_QUERIES + 1):
        team.query(alpha=status("alpha", copy("RUN")))
    assert team.ends is None


def test_a_coordinator_on_no_host_is_lost_after_two_queries_of_all():
    team = Watched().link().send("alpha", STARTED, left(1, "beta"))
    team.send("beta", came(1, "alpha")).send("alpha", confirmed(1, "beta"))
    team.restart("beta")
    team.send("beta", state=status("beta"))
    moved = status("alpha", copy("MOVED", where="beta"))
    assert team.end.is_query_due
    team.query(alpha=moved, beta=None)
    assert team.ends is None
    team.query(alpha=moved)
    assert team.ends is None
    team.query(alpha=moved)
    assert team.ends == [("boss", "lost")]


def test_a_restarted_home_without_a_journal_starts_its_coordinator_again():
    team = Watched().link().send("alpha", STARTED)
    team.restart("alpha")
    team.send("alpha", state=status("alpha"))
    for _ in range(LOST_QUERIES):
        team.query()
    assert team.ends is None
    team.send("alpha", STARTED)
    assert team.send("alpha", DONE).ends == [("boss", "done")]


def test_a_host_that_restarts_with_its_journal_is_followed():
    team = Watched().link().send("alpha", STARTED)
    team.restart("alpha")
    team.wait(LOST_AFTER - 1.0)
    assert team.ends is None
    team.send("alpha", state=status("alpha", copy("RUN"), journal=JOURNAL))
    team.wait(LOST_AFTER)
    assert team.ends is None
    assert team.send("alpha", DONE).ends == [("boss", "done")]


def test_an_end_in_a_journal_counts_if_the_home_has_not_started_again():
    team = Watched(up=1.0)
    ended = status("alpha", copy("EXITED", outcome="done", where="alpha"), journal=JOURNAL)
    team.link(alpha=ended)
    assert team.ends is None
    team.send("alpha", events.AgentStarted("boss", 2))
    team.wait(SETTLE_TIME)
    assert team.ends is None
    later = Watched(up=1.0).link(alpha=ended)
    later.wait(SETTLE_TIME)
    later.send("alpha")
    assert later.ends == [("boss", "done")]


def test_a_delayed_start_is_waited_for():
    waiting = StartStatus(["boss"], ["beta"])
    ended = copy("EXITED", outcome="done", where="alpha")
    team = Watched().link(alpha=status("alpha", ended, journal=JOURNAL, start=waiting))
    team.wait(100.0)
    team.send("alpha").send("beta")
    assert team.ends is None
    assert team.send("alpha", events.StartDelayed("", "")).ends == [("boss", "done")]


def test_an_unreachable_host_is_waited_for_while_another_host_reaches_it():
    team = Watched().link().send("beta", events.AgentStarted("boss", 1))
    team.end.on_unlinked("beta", "gone")
    team.wait(10 * LOST_AFTER)
    team.send("alpha")
    assert team.ends is None
    team.send("alpha", events.LinkDown("beta"))
    assert team.ends == [("boss", "unknown")]


def test_an_unreachable_host_that_returns_in_time_has_its_coordinator():
    team = Watched().link().send("beta", STARTED).send("alpha", events.LinkDown("beta"))
    team.end.on_unlinked("beta", "gone")
    team.wait(LOST_AFTER - 0.1)
    assert team.ends is None
    assert team.send("beta", DONE).ends == [("boss", "done")]


def test_an_unreachable_host_does_not_matter_when_all_have_ended():
    team = Watched().link().send("alpha", STARTED, DONE)
    team.end.on_unlinked("beta", "gone")
    assert team.ends == [("boss", "done")]


def test_a_coordinator_in_doubt_may_continue_at_its_sender():
    team = Watched().link().send("alpha", STARTED, left(1, "beta"))
    team.send("alpha", events.MigrationInDoubt("boss", 1, "beta", "no link"))
    in_doubt = status("alpha", copy("IN DOUBT", where="beta"))
    for _ in range(LOST_QUERIES + 1):
        team.query(alpha=in_doubt)
    assert team.ends is None
    team.send("alpha", events.MigrationFailed("boss", 1, 1, "beta", "Unreachable", "never arrived"))
    assert team.send("alpha", DONE).ends == [("boss", "done")]


def test_a_proven_loss_counts_also_when_its_hosts_leave():
    lost = events.AgentFinished("boss", 1, "lost", "its host has ended")
    team = Watched().link().send("beta", STARTED).send("alpha", lost, events.LinkDown("beta"))
    for host in team.hosts:
        team.end.on_unlinked(host, "gone")
    assert team.ends is None
    team.wait(LOST_AFTER)
    assert team.ends == [("boss", "lost")]


def test_a_recovery_outranks_the_loss_of_the_earlier_start():
    team = Watched().link().send("beta", STARTED)
    team.restart("beta")
    team.send("beta", state=status("beta"))
    team.send("alpha", events.AgentFinished("boss", 1, "lost"), events.CoordinatorRecovered("boss", 1001))
    for _ in range(LOST_QUERIES + 1):
        team.query(alpha=status("alpha", copy("RUN", 1001)))
    assert team.ends is None
    team.send("alpha", events.AgentFinished("boss", 1001, "done"))
    assert team.ends == [("boss", "done")]


def test_a_superseded_start_is_not_an_end():
    team = Watched().link().send("alpha", STARTED).send("beta", events.AgentStarted("boss", 2))
    team.send("beta", events.CoordinatorSuperseded("boss", 2, "start 1 is alive"))
    assert team.ends is None
    assert team.send("alpha", DONE).ends == [("boss", "done")]


def test_unrecorded_hops_are_found_by_the_next_query():
    team = Watched().link().send("alpha", STARTED)
    team.wait(QUERY_INTERVAL)
    assert team.end.is_query_due
    moved = status("alpha", copy("MOVED", where="beta"))
    team.query(alpha=moved, beta=status("beta", copy("RUN")))
    team.end.on_unlinked("beta", "gone")
    team.send("alpha", events.LinkDown("beta"))
    team.wait(LOST_AFTER)
    assert team.ends == [("boss", "unknown")]


def test_events_that_a_snapshot_includes_change_nothing():
    team = Watched().link()
    batch = team.batch("alpha", STARTED)
    team.query(alpha=status("alpha", copy("EXITED", outcome="died", where="alpha")))
    team.end.on_batch("alpha", batch, None)
    assert team.ends == [("boss", "died")]


def test_without_files_the_coordinators_are_known_from_the_hosts():
    team = Watched(None)
    team.send("alpha", state=status("alpha", copy("EXITED", outcome="done", where="alpha")))
    assert team.ends is None
    aide = CoordinatorState("aide", 1, 0, 0, "RUN")
    team.send("beta", state=status("beta", aide))
    assert team.ends is None
    team.send("beta", events.AgentFinished("aide", 1, "done"))
    assert team.ends == [("aide", "done"), ("boss", "done")]


def test_without_any_answer_the_end_is_unknown():
    team = Watched()
    team.wait(LOST_AFTER - 0.1)
    assert team.ends is None
    team.wait(0.1)
    assert team.ends == [("boss", "unknown")]


def test_a_host_never_reached_is_waited_for():
    team = Watched()
    team.send("alpha", state=status("alpha", links=[LinkStatus("beta", 3.0)]))
    team.send("alpha", STARTED, left(1, "beta"), confirmed(1, "beta"))
    team.wait(LOST_AFTER - 0.1)
    assert team.ends is None
    team.wait(0.1)
    assert team.ends == [("boss", "unknown")]
