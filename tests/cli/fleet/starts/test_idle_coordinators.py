"""`lfield start` and `status` with running hosts and no running coordinator."""

from __future__ import annotations

import base64
import json

import pytest
from robots import told

pytestmark = pytest.mark.process


@pytest.mark.few(0)
def test_a_start_without_the_home_of_the_only_coordinator_reports_idle(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission()
    assert told(here("push", "mission.dL", "--json"))["outcome"] == "activated"
    started = here("start", "--without", "alpha", "--json")
    assert (started.status, told(started)["started"]) == (1, False)
    assert "tom" in told(started)["waits"]["alpha"]
    # The remedy of the message.
    here("start", status=0)


@pytest.mark.few(0)
def test_a_start_with_a_parked_coordinator_reports_idle_and_the_remedy(lfield, here, robots) -> None:
    team = robots("alpha", "bravo")
    team.up()
    team.mission(rounds=100, pause=1.0)
    old = told(here("push", "mission.dL", "--json"))["bundle"]
    here("start", status=0)
    here("stop", status=0)
    # No vote activates another bundle, but a service state that was restored from a backup does.
    team.mission(text="call")
    new = told(here("push", "mission.dL", "--stage", "--json"))["bundle"]
    for host in team.hosts:
        team.kill(host)
        (file,) = lfield.folder.glob(f"state-{host}/lfield-*/service/state.json")
        file.write_text(json.dumps(team.state(host)).replace(encoded(old), encoded(new)))
    team.up()
    started = here("start", "--json")
    assert (started.status, told(started)["started"], told(started)["continues"]) == (1, False, [])
    (host,) = told(started)["waits"]
    assert "tom" in told(started)["waits"][host]
    assert any(line.startswith(f"{host}: coordinator tom is parked") for line in here("status").out)
    here("stop", "--discard", status=0)
    here("start", status=0)


def encoded(digest: str) -> str:
    """A digest in the form of the state file."""
    return base64.b64encode(bytes.fromhex(digest)).decode()
