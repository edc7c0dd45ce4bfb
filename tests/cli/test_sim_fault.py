"""`lfield sim fault`: what is wrong with the fakes that run, and making it so."""

from __future__ import annotations

import shutil
import signal
import tempfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.process


@pytest.fixture
def alone(lfield):
    """Commands that see no fakes but their own."""
    folder = tempfile.mkdtemp(prefix="lf-")
    environment = {"XDG_RUNTIME_DIR": folder}

    class Alone:
        doors = Path(folder) / "lfield-sims"

        def fake(self, *vehicles):
            words = [word for vehicle in vehicles for word in ("--vehicle", vehicle)]
            where = ("--listen", "udp:127.0.0.1:0", "--until-stdin-closes")
            fake = lfield.start("sim", "mavlink", *where, *words, stdin=True, env=environment)
            fake.endpoint = fake.wait_for(r"^ready (\S+)")[1]
            return fake

        def fault(self, *words):
            return lfield("sim", "fault", *words, env=environment)

        def start(self, *words):
            return lfield.start(*words, env=environment)

    yield Alone()
    lfield.end()
    shutil.rmtree(folder)


def test_without_a_fake_there_is_nothing_to_show_or_set(alone, lfield):
    shown = alone.fault()
    assert (lfield.status(shown), shown.out) == (0, ["no fake runs"])
    refused = alone.fault("alpha.fc", "loss=0.1")
    assert lfield.status(refused) == 64
    assert refused.err == ["lfield: no running fake is 'alpha.fc'; running: none"]


def test_faults_are_shown_and_set_for_a_fake_and_for_a_device(alone, lfield):
    fake = alone.fake("1:copter:ardupilot:alpha.fc", "2:rover")
    shown = alone.fault()
    assert lfield.status(shown) == 0
    assert shown.out[0] == f"mavlink at {fake.endpoint}: 1 (alpha.fc), 2"
    assert any(line.startswith("  loss = 0.0  (") for line in shown.out)

    assert any(line.startswith("  loss = 0.25  (") for line in alone.fault("mavlink", "loss=0.25").out)
    named = alone.fault("alpha.fc", "silence=true", "delay=0.5")
    assert lfield.status(named) == 0, named.said
    assert any(line.startswith("  silence = false @1=true  (") for line in named.out)
    assert any(line.startswith("  delay = 0.0 @1=0.5  (") for line in named.out)
    other = alone.fault(fake.endpoint, "silence@2=true", "silence@alpha.fc=false")
    assert any(line.startswith("  silence = false @1=false @2=true  (") for line in other.out)


def test_what_cannot_be_set_is_a_sentence_and_changes_nothing(alone, lfield):
    alone.fake("1:copter:ardupilot:alpha.fc")
    for words, sentence in (
        (("alpha.fc", "gravity=0"), "there is no fault 'gravity'; there are: "),
        (("alpha.fc", "delay=0.5", "loss=2"), "loss is from 0 to 1, not 2"),
        (("alpha.fc", "silence=perhaps"), "silence is true or false, not 'perhaps'"),
        (("mavlink", "loss@9=0.1"), "there is no device '9'; there are: 1 (alpha.fc)"),
        (("mavlink", "loss"), "'loss' is no fault; write NAME=VALUE or NAME@DEVICE=VALUE"),
        (("bravo.fc", "loss=0.1"), "no running fake is 'bravo.fc'; running: udp:127.0.0.1:"),
    ):
        refused = alone.fault(*words)
        assert lfield.status(refused) == 64, refused.said
        (line,) = refused.err
        assert sentence in line
    assert any(line.startswith("  delay = 0.0  (") for line in alone.fault().out)


def test_a_name_that_fits_two_fakes_is_refused(alone, lfield):
    first, second = alone.fake("1"), alone.fake("1")
    refused = alone.fault("mavlink", "loss=0.1")
    assert lfield.status(refused) == 64
    assert "2 fakes are 'mavlink'" in refused.err[0]
    assert first.endpoint in refused.err[0]
    assert second.endpoint in refused.err[0]


def test_the_door_of_a_fake_that_was_killed_is_cleared_away(alone):
    fake = alone.fake("1")
    assert len(list(alone.doors.iterdir())) == 1
    fake.signal(signal.SIGKILL)
    fake.popen.wait()
    assert alone.fault().out == ["no fake runs"]
    assert list(alone.doors.iterdir()) == []


def test_the_devices_of_a_simulated_mission_go_by_the_names_of_their_bindings(alone, lfield):
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
    up = alone.start("up", "--deploy", deployment, "--all", "--sim")
    up.wait_for(r"\bup$")
    set_ = alone.fault("lead.fc", "refuse_arming=the compass dreams")
    assert lfield.status(set_) == 0, set_.said
    up.wait_for("refused: .*the compass dreams")
