"""The table of `lfield up --all`, from the events of its hosts."""

from __future__ import annotations

from dashboard_script import ScriptedHost, device, inventory, resource, snapshot
from rich.console import Console

from lfield.cli.views.team_state_view import table
from lfield.operator.team_model.team_view import TeamView
from lfield.wire.events import (
    AgentActivity,
    AgentFinished,
    AgentStarted,
    DeviceLatched,
    DeviceMoving,
    MigrationStarted,
    SafeStateConfirmed,
)


def lines(picture: TeamView, now: float) -> list[str]:
    console = Console(width=160, record=True, markup=False, highlight=False, file=None, force_terminal=False)
    with console.capture() as output:
        console.print(table(picture.snapshot(now)))
    return [line.rstrip() for line in output.get().splitlines()]


def test_table_shows_lines_of_agents_and_last_states_of_dead_hosts() -> None:
    picture, alpha, beta = TeamView(inventory()), ScriptedHost(), ScriptedHost(8)
    one = device("one.fc", battery=0.5)
    picture.feed(
        "alpha", alpha.batch(5.0, snapshot=snapshot("alpha", one, agents=[resource("one")])), 5.0, 0.0
    )
    at = AgentActivity("boss", "in a portal", "mission.L", 12, "two.lift")
    picture.feed("alpha", alpha.batch(5.0, AgentStarted("boss", 1), at), 5.0, 0.0)
    picture.feed("beta", beta.batch(5.0, DeviceLatched("two.fc", "land", "x")), 5.0, 0.0)
    picture.on_unlinked("beta", "no program listens there")
    output = lines(picture, 15.0)
    assert [line.split() for line in output if " boss " in line] == [
        ["alpha", "boss", "Boss", "in", "a", "portal", "mission.L:12,", "waits", "for", "two.lift", "0"]
    ]
    assert any("no answer for 10 s" in line for line in output)
    assert any("two.fc" in line and "safe state not confirmed" in line for line in output)


def test_changes_of_agents_and_devices_are_shown_in_words() -> None:
    picture, alpha = TeamView(inventory()), ScriptedHost()

    def told(*whats: object) -> str:
        picture.feed("alpha", alpha.batch(5.0, *whats), 5.0, 0.0)  # type: ignore[arg-type]
        return "\n".join(lines(picture, 5.0))

    assert "migrating to beta" in told(
        AgentStarted("boss", 1), MigrationStarted("boss", 1, 2, "beta", "two", "lift", 9)
    )
    assert "died: DeviceException: no" in told(
        AgentFinished("boss", 1, "died", "DeviceException: no\n  at x")
    )
    assert "safe: 3 m high" in told(
        DeviceLatched("one.fc", "land", "x"),
        SafeStateConfirmed("one.fc", "land", "x"),
        DeviceMoving("one.fc", "3 m high"),
    )
    assert "safe, at rest" in told(DeviceMoving("one.fc", ""))
