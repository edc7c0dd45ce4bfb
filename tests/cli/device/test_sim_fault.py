"""`lfield sim fault`: shows and sets the faults of running fakes."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

pytestmark = pytest.mark.process


class Fakes:
    """Starts fakes and sets their faults."""

    def __init__(self, lfield, here, environment):
        self._lfield, self._here, self._environment = lfield, here, environment
        self.doors = Path(environment["XDG_RUNTIME_DIR"]) / "lfield" / "sims"

    def start(self, *vehicles):
        arguments = [argument for vehicle in vehicles for argument in ("--vehicle", vehicle)]
        where = ("--listen", "udp:127.0.0.1:0", "--until-stdin-closes")
        fake = self._lfield.start("sim", "mavlink", *where, *arguments, stdin=True, env=self._environment)
        fake.endpoint = fake.wait_for(r"^ready (\S+)")[1]
        return fake

    def fault(self, *arguments):
        return self._here("sim", "fault", *arguments)


@pytest.fixture
def fakes(alone, lfield, here, monkeypatch):
    for name, value in alone.items():
        monkeypatch.setenv(name, value)
    yield Fakes(lfield, here, alone)
    lfield.end()


def test_without_a_fake_there_is_nothing_to_show_or_set(fakes):
    output = fakes.fault()
    assert (output.status, output.out) == (0, ["no simulated device runs"])
    refused = fakes.fault("alpha.fc", "loss=0.1")
    assert refused.status == 64
    assert refused.err == ["lfield: no running simulated device is 'alpha.fc'; running: none"]


def test_faults_are_shown_and_set_for_a_fake_and_a_device(fakes):
    fake = fakes.start("1:copter:ardupilot:alpha.fc", "2:rover")
    output = fakes.fault()
    assert output.status == 0
    assert output.out[0] == f"mavlink at {fake.endpoint}: 1 (alpha.fc), 2"
    assert any(line.startswith("  loss = 0.0  (") for line in output.out)

    assert any(line.startswith("  loss = 0.25  (") for line in fakes.fault("mavlink", "loss=0.25").out)
    named = fakes.fault("alpha.fc", "silence=true", "delay=0.5")
    assert named.status == 0, named
    assert any(line.startswith("  silence = false @1=true  (") for line in named.out)
    assert any(line.startswith("  delay = 0.0 @1=0.5  (") for line in named.out)
    other = fakes.fault(fake.endpoint, "silence@2=true", "silence@alpha.fc=false")
    assert any(line.startswith("  silence = false @1=false @2=true  (") for line in other.out)


@pytest.mark.few(0)
def test_an_invalid_fault_is_refused_and_changes_nothing(fakes):
    fakes.start("1:copter:ardupilot:alpha.fc")
    for arguments, sentence in (
        (("alpha.fc", "gravity=0"), "there is no fault 'gravity'; there are: "),
        (("alpha.fc", "delay=0.5", "loss=2"), "loss is from 0 to 1, not 2"),
        (("alpha.fc", "silence=perhaps"), "silence is true or false, not 'perhaps'"),
        (("mavlink", "loss@9=0.1"), "there is no device '9'; there are: 1 (alpha.fc)"),
        (("mavlink", "loss"), "'loss' is not a fault; write NAME=VALUE or NAME@DEVICE=VALUE"),
        (("bravo.fc", "loss=0.1"), "no running simulated device is 'bravo.fc'; running: udp:127.0.0.1:"),
    ):
        refused = fakes.fault(*arguments)
        assert refused.status == 64, refused
        (line,) = refused.err
        assert sentence in line
    assert any(line.startswith("  delay = 0.0  (") for line in fakes.fault().out)


@pytest.mark.few(0)
def test_an_ambiguous_name_is_refused(fakes):
    first, second = fakes.start("1"), fakes.start("1")
    refused = fakes.fault("mavlink", "loss=0.1")
    assert refused.status == 64
    assert "2 simulated devices are 'mavlink'" in refused.err[0]
    assert first.endpoint in refused.err[0]
    assert second.endpoint in refused.err[0]


def test_the_socket_of_a_killed_fake_is_removed(fakes):
    fake = fakes.start("1")
    assert len(list(fakes.doors.iterdir())) == 1
    fake.signal(signal.SIGKILL)
    fake.popen.wait()
    assert fakes.fault().out == ["no simulated device runs"]
    assert list(fakes.doors.iterdir()) == []


@pytest.mark.few(0)
def test_devices_of_a_simulated_mission_have_the_names_of_their_bindings(alone, fakes, lfield):
    deployment = lfield.mission(
        """
        resource Copter {
            Mavlink fc;
            init(string[] arg) {
                write("up\\n");
                try { while (true) { fc.arm(); fc.disarm(); } }
                catch (DeviceException e) { write("refused: " + e.message() + "\\n"); }
            }
        }
        coordinator Nobody { init(string[] arg) { sleep(1000.0); } }
        """,
        "//Copter:lead@alpha\n//Nobody:one@alpha\n",
        "silence: 2.0\n"
        "agents: {lead: {devices: {fc: {driver: mavlink, endpoint: 'udp:127.0.0.1:14550', "
        "waivers: [device_watchdog]}}}}\n",
    )
    up = lfield.start("up", "--deploy", deployment, "--all", "--sim", env=alone)
    up.wait_for(r"\bup$")
    set_ = fakes.fault("lead.fc", "refuse_arming=the compass dreams")
    assert set_.status == 0, set_
    up.wait_for("refused: .*the compass dreams")
