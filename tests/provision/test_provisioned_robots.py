"""`lfield provision` on robots with a real sshd, real users and sudo.

systemctl is a script that records its calls. Robots and desk have no route to other networks. Each robot
has its own root in memory (robot_bench).
"""

from __future__ import annotations

import shutil
import signal
import stat
from pathlib import Path

import pytest
from robot_bench.desk import LFIELD, NAMES, Desk, make_wheels
from robot_bench.robots import RobotKind, missing

from lfield import exit_status

pytestmark = [
    pytest.mark.skipif(bool(why := missing()), reason=why),
    pytest.mark.process,
    pytest.mark.long,
]

ROOT = Path(__file__).parents[2]
#: Additional packages of simulated autopilots.
SIMULATED = ("geographiclib", "lxml", "pymavlink", "pyserial", "wasmtime")
#: All steps that change a robot.
STEPS = ["user", "wheels", "environment", "keys", "settings", "unit", "version", "service"]
#: The login shell of the user prints a greeting before the output of each command.
NOISY_SHELL = "printf 'echo WELCOME; printf hi\\n' >/home/pi/.bashrc"
SERVICE_ENV = "/etc/lfield/service.env"
#: A user who may run one command as root.
PARTIAL_SUDO = "echo 'pi ALL=(root) NOPASSWD: /bin/true, /usr/bin/true' >/etc/sudoers.d/pi"
#: A full disk under /var/lib, so that the service cannot store its state.
FULL_STATE_DISK = "mount -t tmpfs -o size=64k tmpfs /var/lib; head -c 1000000 /dev/zero >/var/lib/x || true"


@pytest.fixture(scope="module")
def alpha(trial):
    """A bare robot after its first provisioning, which was killed at two steps and then completed."""
    robot = trial.bench.add("alpha", RobotKind(setup=NOISY_SHELL))
    trial.write_inventory(robot)
    dry = trial.provision("--dry-run")
    assert dry.status == exit_status.DONE, dry
    assert {step for step, state in dry.states("alpha").items() if state == "todo"} == set(STEPS)
    assert not robot.path("/opt/lfield").exists()
    assert not (trial.desk.home / ".config/lfield/authority/hosts").exists()
    for step in ("wheels", "environment"):
        trial.kill_at(step)
    done = trial.provision()
    assert done.status == exit_status.DONE, done
    changed = {step for step, state in done.states("alpha").items() if state == "changed"}
    assert changed >= set(STEPS) - {"user", "wheels"}
    return robot


@pytest.mark.few(0)
def test_interrupted_provisioning_of_a_bare_robot_is_completed(trial, alpha):
    assert "Python" in alpha.run("/opt/lfield/current/bin/python --version")
    assert alpha.run("runuser -u lfield -- /opt/lfield/current/bin/lfield --version").startswith("lfield ")
    assert set(alpha.run("id -nG lfield").split()) == {"lfield", "dialout"}
    assert "lfield" in alpha.run("id -nG pi").split()
    assert alpha.read(SERVICE_ENV) == "LFIELD_HOST=alpha\n"
    assert alpha.read("/etc/lfield/inventory.yaml") == trial.desk.inventory.read_text()
    calls = [line for line in alpha.read("/var/log/systemctl.calls").splitlines() if "is-" not in line]
    assert calls == ["daemon-reload", "enable --quiet lfield.service", "restart lfield.service"]
    keys = alpha.path("/etc/lfield/keys/alpha")
    assert stat.S_IMODE(keys.stat().st_mode) == 0o700
    assert stat.S_IMODE((keys / "host.key").stat().st_mode) == 0o600
    output = alpha.run("runuser -u lfield -- /opt/lfield/current/bin/lfield keys show /etc/lfield/keys/alpha")
    assert "alpha" in output
    assert alpha.run("ip route show default") == ""
    assert not list(alpha.path("/opt/lfield").glob(".stage.*"))


@pytest.mark.few(0)
def test_second_run_changes_nothing(trial, alpha):
    listing = "find /opt/lfield /etc/lfield /etc/systemd/system/lfield.service -printf '%p %T@\\n' | sort"
    before = alpha.run(listing)
    second_run = trial.provision()
    assert second_run.status == exit_status.DONE
    assert {step: state for step, state in second_run.states("alpha").items() if state != "done"} == {}
    assert alpha.run(listing) == before
    (doctor,) = [
        report for report in second_run.reports if (report["step"], report["state"]) == ("doctor", "done")
    ]
    assert {finding["code"] for finding in doctor["findings"]} >= {"python"}


@pytest.mark.few(0)
def test_manual_changes_are_repaired_only_without_a_running_mission(trial, alpha):
    alpha.path("/tmp/wait.L").write_text(
        "coordinator Wait { init(string[] arg) { while (true) { sleep(1.0); } } }\n"
    )
    alpha.path("/tmp/wait.dL").write_text("//Wait:tom@alpha\n")
    alpha.path("/etc/systemd/system/lfield.service").write_text("[Unit]\n")
    alpha.path(SERVICE_ENV).write_text("LFIELD_HOST=bravo\n")
    # The host runs as the user of the service, at an address that the service does not use.
    alpha.run(
        "cd /tmp; export RUNTIME_DIRECTORY=/run/lfield HOME=/tmp; "
        "runuser -u lfield -- /opt/lfield/current/bin/lfield up --deploy wait.dL --all >up.log 2>&1 & "
        "echo $! >/tmp/up.pid; "
        "until /opt/lfield/current/bin/lfield ps; do "
        "kill -0 $(cat /tmp/up.pid) || { cat /tmp/up.log; exit 1; }; sleep 0.1; done"
    )
    running = trial.provision()
    assert running.status == exit_status.UNAVAILABLE
    assert running.last("alpha")["step"] == "mission"
    assert alpha.read("/etc/systemd/system/lfield.service") == "[Unit]\n"
    service = alpha.read("/run/bench-service")
    alpha.run("kill $(cat /tmp/up.pid); while pgrep -f '[l]field up' >/dev/null; do sleep 0.1; done")
    stopped = trial.provision()
    assert stopped.status == exit_status.DONE
    changed = {step for step, state in stopped.states("alpha").items() if state == "changed"}
    assert changed == {"unit", "service"}
    assert alpha.read(SERVICE_ENV) == "LFIELD_HOST=alpha\n"
    assert alpha.read("/run/bench-service") != service


REFUSALS = {
    "password": (RobotKind(sudo="password"), "failed", "NOPASSWD: ALL"),
    "partial": (RobotKind(sudo="password", setup=PARTIAL_SUDO), "failed", "NOPASSWD: ALL"),
    "unauthorized": (RobotKind(authorized="other"), "failed", "ssh-copy-id"),
    "unknown": (RobotKind(), "failed", "ssh 10.77.0."),
    "full": (RobotKind(opt_size="20m"), "disk", "free disk space"),
    "foreign": (RobotKind(), "system", "`arch`"),
    "bare": (RobotKind(setup="groupdel dialout"), "user", "groups"),
}


@pytest.mark.few(0)
def test_missing_requirements_are_reported_with_the_remedy(trial):
    """Each host gets a remedy, without a password prompt or a partial installation."""
    robots = [
        trial.bench.add(name, kind, is_known=name != "unknown") for name, (kind, *_) in REFUSALS.items()
    ]
    trial.write_inventory(*robots)
    text = trial.desk.inventory.read_text()
    lines = (
        text.replace("  foreign:\n", "  foreign:\n    arch: armv7l\n")
        + "  away:\n    addresses: [10.77.0.250]\n"
    )
    trial.desk.inventory.write_text(lines)
    done = trial.provision()
    assert done.status == exit_status.UNAVAILABLE
    found = {name: (done.last(name)["step"], str(done.last(name).get("hint"))) for name in REFUSALS}
    for name, (_, step, remedy) in REFUSALS.items():
        assert found[name][0] == step, found
        assert remedy in found[name][1], found
    assert "unreachable" in str(done.last("away")["message"])
    for robot in robots:
        assert not list(robot.path("/opt").glob("lfield/*"))
        assert not robot.path("/etc/lfield").exists()


@pytest.mark.few(0)
def test_provisioning_killed_at_every_step_is_continued(trial):
    """The command is killed at each step, then interrupted by Ctrl-C; the next run completes all steps."""
    robot = trial.bench.add("killed", RobotKind(has_systemd=False))
    trial.write_inventory(robot)
    for step in STEPS[: STEPS.index("environment")]:
        trial.kill_at(step)
    # All processes of the robot are killed while pip runs, as by a reboot.
    restart = "until pgrep -f '[p]ip-.*whl/pip'; do sleep 0.05; done; kill -9 -1; true"
    report = trial.provision_until(
        "environment", lambda process: robot.run(restart), signum=exit_status.UNAVAILABLE
    )
    assert report["step"] == "failed"
    for step in STEPS[STEPS.index("environment") : -1]:
        trial.kill_at(step)
    trial.provision_until(
        "doctor", lambda process: process.send_signal(signal.SIGINT), signum=exit_status.INTERRUPTED
    )
    done = trial.provision()
    assert done.status == exit_status.DONE, done
    second_run = trial.provision("--dry-run")
    assert set(second_run.states(robot.name).values()) <= {"done", "note"}


@pytest.mark.few(0)
def test_too_old_python_is_replaced(trial, wheels):
    script = "#!/bin/sh\\nprintf '3.10.12\\\\tyes\\\\n'\\n"
    old = f'rm -f /usr/bin/python3*; printf "{script}" >/usr/bin/python3; chmod 755 /usr/bin/python3'
    robot = trial.bench.add("jetson", RobotKind(setup=old))
    trial.write_inventory(robot)
    trial.desk.collect_wheels(wheels, python="3.12")
    trial.desk.collect_python("3.12.99")
    done = trial.provision()
    assert done.status == exit_status.DONE, done
    assert done.states("jetson")["python"] == "changed"
    assert robot.run("readlink -f /opt/lfield/current/bin/python").startswith("/opt/lfield/python/3.12.99/")
    assert set(trial.provision().states("jetson").values()) == {"done"}


@pytest.mark.few(0)
def test_five_robots_are_provisioned_in_parallel(trial):
    robots = [trial.bench.add(name) for name in ("one", "two", "three", "four", "five")]
    trial.write_inventory(*robots)
    done = trial.provision()
    assert done.status == exit_status.DONE, done
    running = [report["host"] for report in done.reports if report["step"] == "environment"]
    assert set(running[:5]) == {robot.name for robot in robots}


@pytest.mark.few(0)
def test_disk_that_fills_during_the_run_is_reported(trial):
    robot = trial.bench.add("filling", RobotKind(opt_size="200m"))
    trial.write_inventory(robot)
    fill_disk = "fallocate -l $(($(stat -f -c '%a*%S' /opt) - 8000000)) /opt/ballast"
    full = trial.provision_until(
        "environment", lambda process: robot.run(fill_disk), signum=exit_status.UNAVAILABLE
    )
    assert "free disk space" in str(full["hint"])
    robot.path("/opt/ballast").unlink()
    assert trial.provision().status == exit_status.DONE


@pytest.mark.few(0)
def test_service_that_ends_at_once_is_reported(trial):
    """`lfield doctor` succeeds without the service, and systemd restarts the service repeatedly."""
    robot = trial.bench.add("crashing", RobotKind(setup=FULL_STATE_DISK))
    trial.write_inventory(robot)
    done = trial.provision()
    assert done.status == exit_status.UNAVAILABLE
    assert (done.last("crashing")["step"], done.last("crashing")["state"]) == ("service", "failed")
    robot.run("rm /var/lib/x; systemctl restart lfield.service")
    assert trial.provision().status == exit_status.DONE


@pytest.mark.few(0)
def test_four_commands_deploy_and_start_a_team_on_bare_robots(trial, wheels, tmp_path):
    """The devices on the robots are simulated; the wheels of the drivers are built from this environment."""
    robots = [trial.bench.add(name) for name in ("alpha2", "bravo2")]
    desk = Desk(tmp_path)
    simulated = "    options: [--sim]\n"
    desk.write_inventory({"alpha": robots[0].address, "bravo": robots[1].address}, simulated)
    drivers = tmp_path / "wheels"
    drivers.mkdir()
    make_wheels(drivers, (*NAMES, *SIMULATED))
    desk.collect_wheels(drivers)
    shutil.copy(ROOT / "examples/01-first-flight/mission.L", tmp_path)
    for file in (ROOT / "deploy/two-copters").iterdir():
        shutil.copy(file, tmp_path)
    environment = {**desk.environment, "LFIELD_INVENTORY": str(desk.inventory)}
    for command in (
        ("keys", "init", "--person", "anna"),
        ("provision",),
        ("push", tmp_path / "mission.dL"),
        ("start",),
    ):
        done = trial.bench.run([LFIELD, *command], environment)
        assert done.returncode == 0, done
    robots[0].run("timeout 50 sh -c \"until grep 'lead: landed' /var/log/lfield.log; do sleep 0.2; done\"")
