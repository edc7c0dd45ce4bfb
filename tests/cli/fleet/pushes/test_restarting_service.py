"""A push while the service of a robot is restarted by its unit."""

from __future__ import annotations

import threading

import pytest
from robots import told

from lfield.cli.fleet import push
from lfield.operator.fleet import service_link

pytestmark = pytest.mark.process


def test_a_push_waits_for_a_service_that_restarts(lfield, here, robots, monkeypatch) -> None:
    """A service with the bundle is waited for; one without the bundle that does not listen counts as off."""
    team = robots("alpha", "bravo")
    team.up()
    team.mission()
    # Longer than any start of a process in this test.
    monkeypatch.setattr(service_link, "RESTART_TIME", 60.0)
    monkeypatch.setattr(push, "FIRST_CONTACT", 60.0)
    restart = threading.Timer(1.0, lambda: team.up("bravo"))
    upload = push._upload_all

    async def upload_and_kill(*arguments):
        results = await upload(*arguments)
        team.kill("bravo")
        restart.start()
        return results

    monkeypatch.setattr(push, "_upload_all", upload_and_kill)
    assert told(here("push", "mission.dL", "--json"))["outcome"] == "activated"
    restart.join()


def test_a_service_that_does_not_listen_is_named_at_the_end(lfield, here, robots, monkeypatch) -> None:
    team = robots("alpha", "bravo")
    team.up("alpha")
    team.mission()
    monkeypatch.setattr(service_link, "RESTART_TIME", 0.5)
    refused = here("push", "mission.dL", "--json")
    assert (refused.status, list(told(refused)["errors"])) == (69, ["bravo"])
