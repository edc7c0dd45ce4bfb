"""New addresses of restarted hosts."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from lfield.errors import AddressError, NoMissionRunning
from lfield.operator.dashboard.event_stream.host_locator import NOT_RUNNING, REFRESH_INTERVAL, HostLocator
from lfield.operator.runs import Run, RunManifest
from lfield.operator.targets import TargetTeam
from lfield.simulate.jumping_loop import run_jumping


def party(name: str, mission: str, *hosts: str) -> TargetTeam:
    addresses = {host: f"unix:/run/{name}/{host}.sock" for host in hosts}
    note = RunManifest("m.dL", mission * 64, 1, 0.0, 1.0, {host: f"{host}:1" for host in hosts}, {})
    return TargetTeam((Run(Path("/run") / name, note),), addresses)


def unstarted(*hosts: str) -> TargetTeam:
    """A named mission that does not run here: at the addresses of its deployment."""
    return TargetTeam((), {host: f"{host}:8181" for host in hosts})


def found(reach: HostLocator, host: str = "alpha", *, after: float = 0.0) -> str:
    async def main() -> str:
        await reach("alpha")
        await asyncio.sleep(after)
        return await reach(host)

    return run_jumping(main())


@pytest.fixture(autouse=True)
def _no_threads(monkeypatch) -> None:
    async def at_once(work, *args):
        return work(*args)

    monkeypatch.setattr(asyncio, "to_thread", at_once)


def test_a_run_found_a_moment_ago_is_not_searched_again() -> None:
    reach = HostLocator(party("m-1", "a", "alpha"), lambda: [party("m-2", "a", "alpha")])
    assert found(reach, after=REFRESH_INTERVAL / 2) == "unix:/run/m-1/alpha.sock"


def test_hosts_are_found_in_another_run_of_the_mission() -> None:
    others = [party("n-1", "b", "alpha"), party("m-2", "a", "alpha"), party("m-3", "a", "alpha")]
    reach = HostLocator(party("m-1", "a", "alpha"), lambda: others)
    assert found(reach, after=REFRESH_INTERVAL) == "unix:/run/m-3/alpha.sock"


def test_the_followed_run_is_kept_while_it_is_alive() -> None:
    both = [party("m-1", "a", "alpha"), party("m-2", "a", "alpha")]
    assert found(HostLocator(both[0], lambda: both), after=REFRESH_INTERVAL) == "unix:/run/m-1/alpha.sock"


def test_without_any_run_the_last_address_is_kept() -> None:
    def look() -> list[TargetTeam]:
        raise NoMissionRunning("no mission runs here")

    reach = HostLocator(party("m-1", "a", "alpha"), look)
    assert found(reach, after=REFRESH_INTERVAL) == "unix:/run/m-1/alpha.sock"


def test_a_host_that_the_mission_no_longer_has_is_reported() -> None:
    reach = HostLocator(party("m-1", "a", "alpha"), lambda: [])
    with pytest.raises(AddressError, match="no longer has such a host"):
        found(reach, "gamma")


def test_a_mission_started_later_and_its_next_run_are_found() -> None:
    now: list[TargetTeam] = [unstarted("alpha")]
    reach = HostLocator(unstarted("alpha"), lambda: now)

    async def main() -> list[str]:
        addresses = [await reach("alpha")]
        for run in ("m-1", "m-2"):
            now[:] = [party(run, "a", "alpha")]
            await asyncio.sleep(REFRESH_INTERVAL)
            addresses.append(await reach("alpha"))
        now[:] = [unstarted("alpha")]
        await asyncio.sleep(REFRESH_INTERVAL)
        return [*addresses, await reach("alpha")]

    m1, m2 = "unix:/run/m-1/alpha.sock", "unix:/run/m-2/alpha.sock"
    assert run_jumping(main()) == ["alpha:8181", m1, m2, m2]
    assert reach.addresses == {"alpha": m2}


def test_the_hint_reports_if_the_mission_runs_here_after_a_search() -> None:
    now: list[TargetTeam] = [unstarted("alpha")]
    reach = HostLocator(unstarted("alpha"), lambda: now)
    assert reach.hint() == NOT_RUNNING
    now[:] = [party("m-1", "a", "alpha")]
    assert found(reach, after=REFRESH_INTERVAL) == "unix:/run/m-1/alpha.sock"
    assert reach.hint() == ""
