"""The picture of `lfield up --all`, from what its hosts tell."""

from __future__ import annotations

from rich.console import Console
from sight_script import Teller, device, resource, roll, snapshot

from lfield.cli.views.seen_view import table
from lfield.operator.sight.picture.team_picture import Picture
from lfield.wire.events import Confirmed, Finished, Latched, Left, Moving, Standing, Started


def lines(picture: Picture, now: float) -> list[str]:
    console = Console(width=160, record=True, markup=False, highlight=False, file=None, force_terminal=False)
    with console.capture() as shown:
        console.print(table(picture.seen(now)))
    return [line.rstrip() for line in shown.get().splitlines()]


def test_agents_stand_at_their_lines_and_dead_hosts_are_as_they_were_last() -> None:
    picture, alpha, beta = Picture(roll()), Teller(), Teller(8)
    one = device("one.fc", battery=0.5)
    picture.told(
        "alpha", alpha.batch(5.0, snapshot=snapshot("alpha", one, agents=[resource("one")])), 5.0, 0.0
    )
    at = Standing("boss", "in a portal", "mission.L", 12, "two.lift")
    picture.told("alpha", alpha.batch(5.0, Started("boss", 1), at), 5.0, 0.0)
    picture.told("beta", beta.batch(5.0, Latched("two.fc", "land", "x")), 5.0, 0.0)
    picture.unlinked("beta", "nobody listens there")
    shown = lines(picture, 15.0)
    assert [line.split() for line in shown if " boss " in line] == [
        ["alpha", "boss", "Boss", "in", "a", "portal", "mission.L:12,", "waits", "for", "two.lift", "0"]
    ]
    assert any("last heard 10 s ago: nobody listens there" in line for line in shown)
    assert any("two.fc" in line and "safe state not confirmed" in line for line in shown)


def test_what_becomes_of_agents_and_devices_is_a_word() -> None:
    picture, alpha = Picture(roll()), Teller()

    def told(*whats: object) -> str:
        picture.told("alpha", alpha.batch(5.0, *whats), 5.0, 0.0)  # type: ignore[arg-type]
        return "\n".join(lines(picture, 5.0))

    assert "on its way to beta" in told(Started("boss", 1), Left("boss", 1, 2, "beta", "two", "lift", 9))
    assert "died: DeviceException: no" in told(Finished("boss", 1, "died", "DeviceException: no\n  at x"))
    assert "safe: 3 m high" in told(
        Latched("one.fc", "land", "x"), Confirmed("one.fc", "land", "x"), Moving("one.fc", "3 m high")
    )
    assert "safe, at rest" in told(Moving("one.fc", ""))
