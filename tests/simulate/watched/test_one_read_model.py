"""A snapshot and a sequence of events give the same state of a host."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from secrets import token_bytes

import pytest
from event_watcher import EventWatcher, fleet_of, watch

from lfield.operator.team_model.host_model import host_states
from lfield.operator.team_model.team_contents import TeamContents
from lfield.operator.team_model.team_state import HostState
from lfield.operator.team_model.team_view import TeamView
from lfield.simulate.host_fleet import Fleet
from lfield.wire.observer_messages import EmergencyStop, Pause
from lfield.wire.subscription_messages import EventBatch, Subscribe


def followed(batches: Sequence[EventBatch]) -> HostState:
    """alpha after all batches of a subscription."""
    view = TeamView(TeamContents("team", ("alpha", "beta")))
    for batch in batches:
        view.feed("alpha", batch, batch.up, batch.now)
    return view.snapshot(batches[-1].up).hosts["alpha"]


def asked(fleet: Fleet) -> HostState:
    """alpha after the answer to one request."""
    command = watch(fleet, "alpha", Subscribe(once=True))
    fleet.run(0.2)
    (batch,) = command.batches
    assert (batch.events, batch.after) == ([], batch.latest)
    return host_states({"alpha": batch})["alpha"]


def comparable_state(host: HostState) -> dict[str, object]:
    """The parts of a state that events change."""
    held = {name: (each.latched, each.confirmed, each.moving) for name, each in host.devices.items()}
    known = "linked", "stopped", "paused", "waits_for", "start_held", "refused", "bundle", "end_reason"
    return {
        **{name: getattr(host, name) for name in known},
        "links": sorted(host.links),
        "away": sorted(host.unreachable_for),
        "devices": held,
    }


def stop(fleet: Fleet, watcher: EventWatcher) -> None:
    watcher.order(EmergencyStop(token_bytes(16), "people on the field"))


def lift(fleet: Fleet, watcher: EventWatcher) -> None:
    watcher.order(EmergencyStop(token_bytes(16), "", lift=True))


def pause(fleet: Fleet, watcher: EventWatcher) -> None:
    watcher.order(Pause(token_bytes(16)))


def crash(fleet: Fleet, watcher: EventWatcher) -> None:
    fleet.crash("beta")


def boot(fleet: Fleet, watcher: EventWatcher) -> None:
    fleet.boot("beta")


@pytest.mark.few(1)
@pytest.mark.parametrize("steps", [(stop, lift), (pause, stop), (crash, boot)])
def test_events_lead_to_the_state_of_a_snapshot(
    tmp_path: Path, steps: Sequence[Callable[[Fleet, EventWatcher], None]]
) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    watcher, states = watch(fleet, "alpha", Subscribe(telemetry=5.0)), []
    for step in steps:
        step(fleet, watcher)
        fleet.run(6.0)
        states.append(comparable_state(asked(fleet)))
        assert comparable_state(followed(watcher.batches)) == states[-1]
    assert states[0] != states[1]


def test_a_request_for_a_snapshot_is_no_subscription(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path, 8.0)
    host = fleet.runs["alpha"].host
    assert asked(fleet).linked
    fleet.run(5.0)
    assert host.core.machine.hooks.observer is None
    assert not host.recorder.detailed
