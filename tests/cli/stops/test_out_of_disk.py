"""A full disk for the log, the dumps or the runtime folder: the copter continues to fly."""

from __future__ import annotations

import resource
import signal

import pytest
from copter_flight import DEPLOYMENT, PROGRAM, copter, devices
from mavlink_observer import MavlinkObserver

pytestmark = pytest.mark.process

#: Two agents that fail, the second after the disk is full.
DYING = (
    PROGRAM
    + """
coordinator Careless { init(string[] arg) { sleep(s2f(arg[1])); print(i2s(1 / (arg.length() - 2))); } }
"""
)
AGENTS = "//Careless:tom@alpha?10.0\n"


def fill(pid: int) -> None:
    """Make every disk full for a running process; Python ignores the signal of the limit."""
    _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, hard))


def full_from_the_start() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))


def flies(witness: MavlinkObserver) -> bool:
    return witness.armed and witness.mode == "GUIDED" and witness.height > 2.0


@pytest.mark.few(0)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_full_disk_under_log_and_output_ends_no_flight_and_delays_no_stop(flight, number):
    with open("/dev/full", "wb") as full:
        flown = flight(stdout=full, stderr=full)
    assert flies(flown.witness)
    answer = flown.ask("ps")
    assert "lead.fc" in answer.said
    flown.host.signal(number)
    assert flown.host.wait() == 0
    flown.is_down()


@pytest.mark.few(0)
def test_a_dump_on_a_full_disk_is_reported_and_the_flight_continues(lfield, flight):
    arguments = ("--dump", "dumps")
    flown = flight(program=DYING, deployment=DEPLOYMENT + AGENTS, options=arguments)
    fill(flown.host.pid)
    flown.host.wait_for("^tom not dumped to dumps/tom.block: cannot write dumps/tom.block: File too large")
    assert flies(flown.witness)
    assert list((lfield.folder / "dumps").iterdir()) == [], "a partial file is left"
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said
    flown.is_down()


@pytest.mark.few(0)
@pytest.mark.parametrize("options", [(), ("--volatile",)])
def test_a_team_that_cannot_store_its_manifest_does_not_fly(lfield, alone, options):
    """No command could find such a team to stop it."""
    endpoint = copter(lfield, alone)
    file = lfield.mission(PROGRAM, DEPLOYMENT.format(stay="1000"), devices({"lead": endpoint}, 60.0))
    lfield("build", file, status=0)
    arguments = ("up", file.with_suffix(".lfm"), "--all", *options)
    refused = lfield(*arguments, env=alone, preexec_fn=full_from_the_start, status=73)
    assert "File too large; no command could find what runs, to stop it" in refused.said


@pytest.mark.few(0)
def test_a_mission_that_cannot_be_built_on_a_full_disk_is_one_sentence(lfield, alone):
    file = lfield.mission(PROGRAM + "\n", "//Copter:lead@alpha\n")
    arguments = ("up", "--deploy", file, "--sim", "--host", "alpha", *lfield.maps(["alpha"]))
    refused = lfield(*arguments, env=alone, preexec_fn=full_from_the_start)
    assert lfield.status(refused) in (73, 74), refused.said
    assert "File too large" in refused.said
    assert "a bug in lfield" not in refused.said
