"""An update of lfield for a team with a robot that must not be updated: real ssh, users, processes."""

from __future__ import annotations

from pathlib import Path

import pytest
from robot_bench.robots import BenchRobot

from lfield import __version__, exit_status

CURRENT = Path("/opt/lfield/current")
#: Another version of lfield for provision: an environment with another name.
OTHER = "0.3.9-earlier"
OUTDATED = f"cp -a $(readlink -f {CURRENT}) /opt/lfield/{OTHER}; ln -sfn {OTHER} {CURRENT}"
STATE = f"/var/lib/lfield/lfield-{__version__}"
#: A coordinator whose host was killed: it is suspended in the journal.
SUSPENDED = f"""
cd /tmp
export RUNTIME_DIRECTORY=/run/lfield HOME=/var/lib/lfield
echo 'coordinator Wait {{ init(string[] arg) {{ while (true) {{ sleep(1.0); }} }} }}' >wait.L
echo '//Wait:tom@NAME' >wait.dL
runuser -u lfield -- {CURRENT}/bin/lfield up --deploy wait.dL --all --state {STATE} >up.log 2>&1 &
pid=$!
until {CURRENT}/bin/lfield ps | grep -q tom; do kill -0 $pid || {{ cat up.log; exit 1; }}; sleep 0.2; done
pkill -9 -u lfield -f '[l]field up'
while pgrep -u lfield -f '[l]field up' >/dev/null; do sleep 0.1; done
"""


def version(robot: BenchRobot) -> str:
    """The active environment."""
    return robot.run(f"readlink {CURRENT}").strip()


@pytest.mark.few(0)
def test_no_robot_is_updated_while_one_has_an_active_coordinator(trial) -> None:
    robots = [trial.bench.add(name) for name in ("papa", "quebec")]
    trial.write_inventory(*robots)
    assert trial.provision().status == exit_status.DONE
    present = version(robots[0])
    for robot in robots:
        robot.run(OUTDATED)
    robots[1].run(SUSPENDED.replace("NAME", "quebec"))

    refused = trial.provision()
    assert refused.status == exit_status.UNAVAILABLE
    assert refused.states("quebec")["mission"] == "refused"
    assert "tom" in str(refused.last("quebec")["message"])
    # The other robot also keeps its version, and names the robot that is the reason.
    assert [version(robot) for robot in robots] == [OTHER, OTHER]
    assert "quebec" in str(refused.last("papa")["message"])

    robots[1].run(f"rm -rf {STATE}/wait@quebec")
    assert trial.provision().status == exit_status.DONE
    assert [version(robot) for robot in robots] == [present, present]
