"""`lfield setup`: writes the settings that `doctor`, `kit` and `up` report, and restores the old ones."""

from __future__ import annotations

import json
import signal

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Copter { Mavlink fc; init(string[] arg) { while (true) yield(); } }
coordinator Nobody { init(string[] arg) { } }
"""
DEPLOYMENT = "//Copter:lead@alpha\n//Nobody:one@alpha\n"
STOCK = "FS_GCS_ENABLE is 0 and must be 5"


@pytest.fixture
def endpoint(lfield):
    """A copter with factory settings."""
    arguments = ("--listen", "udp:127.0.0.1:0", "--until-stdin-closes", "--param", "WPNAV_SPEED=1000")
    return lfield.start("sim", "mavlink", *arguments, stdin=True).wait_for(r"^ready (\S+)")[1]


@pytest.fixture
def deployment(lfield, endpoint):
    copter = f"driver: mavlink, endpoint: '{endpoint}', ttl: 1.0, limits: {{speed: 3.0}}"
    return lfield.mission(
        PROGRAM, DEPLOYMENT, f"silence: 2.0\nagents:\n  lead: {{devices: {{fc: {{{copter}}}}}}}\n"
    )


@pytest.fixture
def setup(lfield, here):
    return lambda *words, state="state": here("setup", *words, "--state", lfield.folder / state)


def own(lines):
    """The lines of `setup` itself, without those of the autopilot."""
    return [line for line in lines if ": autopilot: " not in line]


@pytest.mark.few(0)
def test_missing_settings_are_reported_written_and_restored(lfield, here, setup, endpoint, deployment):
    command = f"lfield setup --deploy {deployment}"

    doctor = here("doctor", "--deploy", deployment, status=69)
    (number,) = [number for number, line in enumerate(doctor.out) if "lead.fc" in line]
    *details, cure = doctor.out[number + 1 :]
    problem = f"PROBLEM lead.fc: it is not set up for its binding: {STOCK}, and {len(details) - 1} more"
    assert doctor.out[number] == problem
    assert any(line.startswith("        setting MAV_GCS_SYSID is 255 and must be 128: ") for line in details)
    assert f"        setting {STOCK}: its action when this computer fails" in details
    assert "        setting WPNAV_SPEED is 1000 and must be 300: the speed limit of the binding" in details
    assert cure == f"        -> {command} (with a confirmation)"

    up = lfield("up", "--deploy", deployment, "--all", status=69)
    assert any(STOCK in line for line in up.err)
    assert any(line.endswith(f"to set it up: {command}") for line in up.err)
    assert (
        "alpha | lead.fc setting WPNAV_SPEED is 1000 and must be 300: the speed limit of the binding"
        in up.err
    )

    arguments = ("mavlink", "--endpoint", endpoint, "--set", "ttl=1.0")
    kit = here("kit", *arguments, "--silence", "2", "--yes", status=69)
    assert STOCK in kit.err[0]
    assert kit.err[1].endswith(f"to set it up: lfield setup {' '.join(arguments)}")

    # Without a terminal for consent nothing is changed.
    result = setup("--deploy", deployment)
    assert result.status == 64
    assert own(result.out)[1].split()[:4] == ["lead.fc", "FS_GCS_ENABLE", "0", "5"]
    assert result.err == ["lfield: nothing was written: no terminal to confirm on; confirm with --yes"]

    done = setup("--deploy", deployment, "--host", "alpha", "--yes")
    assert done.status == 0
    assert "lead.fc: WPNAV_SPEED was 1000 and is now 300" in done.out
    assert own(setup("--deploy", deployment).out) == [
        "nothing to do: every device keeps what its binding needs"
    ]
    here("doctor", "--deploy", deployment, status=0)

    file = lfield.folder / "state" / "setup-1.json"
    assert any(line.endswith(f"'lfield setup --apply {file}' restores them") for line in done.out)
    back = setup("--apply", file, "--yes")
    assert back.status == 0
    assert "lead.fc: WPNAV_SPEED was 300 and is 1000 again" in back.out
    assert "    nothing to write" in setup("--apply", file).out
    assert own(setup("--deploy", deployment).out) == own(result.out)


@pytest.mark.few(0)
def test_a_setting_changed_since_is_left_unchanged(lfield, setup, endpoint):
    arguments = ("mavlink", "--endpoint", endpoint, "--set", "ttl=1.0", "--yes")
    assert setup("--back").status == 0, "there is no file yet"
    assert setup(*arguments, "--set", "safe_state=land").status == 0
    assert setup(*arguments, "--set", "safe_state=return").status == 0
    first = lfield.folder / "state" / "setup-1.json"
    back = setup("--apply", first, "--yes")
    assert back.status == 69
    assert back.err[0].startswith("kit.device: FS_GCS_ENABLE is 1, ")
    # The old option restores the newest file.
    assert "kit.device: FS_GCS_ENABLE was 1 and is 5 again" in setup("--back", "--yes").out
    assert "kit.device: FS_GCS_ENABLE was 5 and is 0 again" in setup("--apply", first, "--yes").out


def test_settings_that_cannot_be_saved_are_not_written(lfield, setup, endpoint, monkeypatch):
    lfield.write("plain", "")
    arguments = ("mavlink", "--endpoint", endpoint, "--set", "ttl=1.0")
    done = setup(*arguments, "--yes", state="plain/state")
    assert done.status == 73, done.err
    assert not any("is kept in" in line or " is now " in line for line in done.out), done.out
    monkeypatch.setattr("lfield.cli.device.setup._confirmed", lambda: False)
    result = setup(*arguments)
    assert (result.status, result.out[-1]) == (1, "nothing was written")
    assert ["FS_GCS_ENABLE", "0", "5"] in [line.split()[1:4] for line in result.out]


@pytest.mark.few(0)
def test_ctrl_c_between_two_writes_loses_nothing(lfield, setup, endpoint):
    arguments = ("mavlink", "--endpoint", endpoint, "--set", "ttl=1.0", "--set", "limits={speed: 3.0}")
    backup = lfield.folder / "state" / "setup-1.json"
    # Delayed answers: the interrupt arrives between the writes.
    lfield("sim", "fault", "mavlink", "delay=0.4", status=0)
    writing = lfield.start("setup", *arguments, "--yes", "--state", "state")
    writing.wait_for("FS_GCS_ENABLE was 0 and is now 5")
    writing.signal(signal.SIGINT)
    assert writing.wait() == 130, writing.said
    assert not any("WPNAV_SPEED was" in line for line in writing.out), "it had ended before"
    assert '"WPNAV_SPEED"' in backup.read_text()
    lfield("sim", "fault", "mavlink", "delay=0", status=0)

    back = setup("--apply", backup, "--yes")
    assert back.status == 0, back
    assert "kit.device: FS_GCS_ENABLE was 5 and is 0 again" in back.out
    assert not any("WPNAV_SPEED was" in line for line in back.out), "it was never written"
    again = setup(*arguments)
    assert ["FS_GCS_ENABLE", "0", "5"] in [line.split()[1:4] for line in again.out]
    assert ["WPNAV_SPEED", "1000", "300"] in [line.split()[1:4] for line in again.out]


@pytest.mark.few(0)
def test_settings_of_one_vehicle_are_not_restored_to_another(lfield, setup):
    """Two vehicles with the same system id, used in sequence on one computer."""

    def there(where, *arguments):
        fake = lfield.start(
            "sim", "mavlink", "--until-stdin-closes", "--listen", where, *arguments, stdin=True
        )
        return fake, fake.wait_for(r"^ready (\S+)")[1]

    def gone(fake):
        fake.popen.stdin.close()
        assert fake.wait() == 0

    mine, endpoint = there("udp:127.0.0.1:0", "--board", "a1")
    words = ("mavlink", "--endpoint", endpoint, "--set", "ttl=1.0", "--set", "system=1", "--yes")
    assert setup(*words).status == 0
    file = lfield.folder / "state" / "setup-1.json"
    (entry,) = json.loads(file.read_text())["entries"]
    written = [f"--param={change['name']}={change['now']}" for change in entry["changes"]]
    gone(mine)
    other, _ = there(endpoint, *written)
    back = setup("--apply", file, "--yes")
    assert back.status == 69, back
    assert "not ArduPilot copter, system 1, uid 0000000000000000000000a1: nothing is written" in back.err[0]
    assert not any("FS_GCS_ENABLE" in line for line in back.out)
    gone(other)

    # A simulated vehicle does not store its parameters.
    there(endpoint, "--board", "a1", *written)
    result = setup("--apply", file)
    assert result.status == 64, result
    assert "    FS_GCS_ENABLE from 5 back to 0" in result.out
    back = setup("--apply", file, "--yes")
    assert (back.status, back.out[-1]) == (0, "done: all settings are as before")
    assert "kit.device: FS_GCS_ENABLE was 5 and is 0 again" in back.out


@pytest.mark.parametrize(
    ("words", "status", "sentence"),
    [
        ([], 64, "no devices given: give --deploy MISSION, or DRIVER --endpoint E"),
        (["mavlink"], 64, "no endpoint: give --endpoint"),
        (["mavlink", "--deploy", "mission.dL"], 64, "name a mission by --deploy, or a driver; not both"),
        (["mavlink", "--endpoint", "udp:127.0.0.1:1", "--sim"], 64, "name it by --deploy"),
        (["--deploy", "none.dL"], 66, "none"),
        (["--apply", "none.json"], 66, "none.json"),
        (["mavlink", "--endpoint", "udp:127.0.0.1:1", "--set", "connect=0.3"], 69, "no heartbeat"),
    ],
)
def test_an_invalid_command_line_of_setup_is_refused_with_a_sentence(setup, words, status, sentence):
    result = setup(*words)
    assert result.status == status, result
    assert sentence in "\n".join(result.err)
    assert result.out == []


def test_fakes_of_a_mission_are_set_up(setup, lfield):
    copter = "driver: mavlink, endpoint: 'udp:127.0.0.1:1', ttl: 1.0, limits: {speed: 3.0}, safe_state: hold"
    devices = f"agents:\n  lead: {{devices: {{fc: {{{copter}}}}}}}\n"
    looked = setup("--deploy", lfield.mission(PROGRAM, DEPLOYMENT, devices), "--sim")
    assert own(looked.out) == ["nothing to do: every device keeps what its binding needs"], looked
