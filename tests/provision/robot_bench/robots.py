"""A desk and robots as namespaces of this computer: private files, processes and networks, and a real sshd.

The root of a robot is an overlay of this computer's root, in memory: installed files disappear
with the robot. The desk and the robots are on one bridge without any route, so neither has internet access.
There is no systemd: `systemctl` is a script that logs its arguments and restarts the service like the unit.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from robot_bench.desk import BASE_PYTHON, PYTHON

TOOLS = ("unshare", "nsenter", "ip", "ssh", "ssh-keygen", "sudo", "useradd", "flock", "runuser")
SSHD = Path("/usr/sbin/sshd")
NETWORK = "10.77.0"
USER = "pi"

_SYSTEMCTL = """#!/bin/sh
echo "$*" >>/var/log/systemctl.calls
case "$1" in
  enable) touch /etc/bench-enabled ;;
  restart)
    service=$(cat /run/bench-service 2>/dev/null)
    # An ended process has no program, also before its parent has waited for it.
    [ ! -e "/proc/${service:-none}/exe" ] || kill "$service"
    while [ -e "/proc/${service:-none}/exe" ]; do sleep 0.05; done
    install -d -o lfield -g lfield -m 700 /var/lib/lfield /var/cache/lfield
    install -d -o lfield -g lfield -m 750 /run/lfield
    set -a; . /etc/lfield/service.env; [ ! -e /etc/lfield/local.env ] || . /etc/lfield/local.env
    cd /
    export RUNTIME_DIRECTORY=/run/lfield STATE_DIRECTORY=/var/lib/lfield CACHE_DIRECTORY=/var/cache/lfield
    export XDG_CACHE_HOME=/var/cache HOME=/var/lib/lfield
    setsid setpriv --reuid lfield --regid lfield --init-groups \
      /opt/lfield/current/bin/lfield service --host "$LFIELD_HOST" </dev/null >/var/log/lfield.log 2>&1 &
    echo $! >/run/bench-service ;;
  is-enabled) if [ -e /etc/bench-enabled ]; then echo enabled; else echo disabled; exit 1; fi ;;
  is-active)
    service=$(cat /run/bench-service || echo none)
    if [ -e "/proc/$service/exe" ]; then echo active; else echo inactive; exit 3; fi ;;
esac
"""
_SSHD_CONFIG = """
HostKey /etc/ssh/bench_key
UsePAM no
PermitRootLogin prohibit-password
AuthorizedKeysFile /etc/ssh/bench_authorized
PasswordAuthentication yes
MaxStartups 100
PidFile /run/bench-sshd.pid
"""
#: Makes the root of a robot, prints `ready`, and waits for its network before it becomes sshd.
_ROBOT = r"""
set -eu
mount --make-rprivate /
mount -t tmpfs -o mode=755 tmpfs "$BASE"
mkdir "$BASE/upper" "$BASE/work" "$BASE/root"
mount -t overlay overlay -o "lowerdir=/,upperdir=$BASE/upper,workdir=$BASE/work" "$BASE/root"
cd "$BASE/root"
rm -rf opt/lfield etc/lfield etc/systemd/system/lfield.service
mount -t tmpfs -o mode=755 tmpfs run
mount -t tmpfs -o mode=1777 tmpfs tmp
mount -t proc proc proc
mount --rbind /dev dev
[ -z "$OPT_SIZE" ] || mount -t tmpfs -o "mode=755,size=$OPT_SIZE" tmpfs opt
chmod o+x root
mkdir -p run/sshd run/systemd etc/ssh etc/sudoers.d var/log
[ "$SYSTEMD" = no ] || mkdir run/systemd/system
cat >usr/bin/systemctl.new <<'END'
@SYSTEMCTL@
END
chmod 755 usr/bin/systemctl.new; mv usr/bin/systemctl.new usr/bin/systemctl
cat >etc/ssh/bench_config <<'END'
@SSHD@
END
cp "$KEYS/host_key" etc/ssh/bench_key; chmod 600 etc/ssh/bench_key
cp "$KEYS/$AUTHORIZED.pub" etc/ssh/bench_authorized; chmod 644 etc/ssh/bench_authorized
chroot . /bin/sh -eu <<'END'
hostname "$NAME"; echo "127.0.1.1 $NAME" >>/etc/hosts
! id lfield >/dev/null 2>&1 || userdel lfield
! getent group lfield >/dev/null || groupdel lfield
id pi >/dev/null 2>&1 || useradd --create-home --shell /bin/bash --password '*' pi
# The wheels are for the Python of the tests.
python3 -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$PYTHON_TAG')" ||
  ln -sf "$PYTHON" /usr/bin/python3
rm -f /etc/sudoers.d/*
[ "$SUDO" = password ] || echo 'pi ALL=(root) NOPASSWD: ALL' >/etc/sudoers.d/pi
eval "$SETUP"
END
echo ready
read go
ip link set lo up
exec chroot . /usr/sbin/sshd -D -e -f /etc/ssh/bench_config
"""
#: The namespaces of the desk: a bridge, and its own settings of ssh.
_DESK = """
set -eu
mount --make-rprivate /
mount --bind "$KEYS/ssh_config" /etc/ssh/ssh_config
ip link set lo up
ip link add br0 type bridge
ip addr add {network}.1/24 dev br0
ip link set br0 up
echo ready
exec cat
"""


def missing() -> str:
    """The reason why a bench is impossible on this computer; empty if a bench is possible."""
    if os.geteuid() != 0:
        return "lfield provision on robots with sshd; needs root"
    tools = [tool for tool in TOOLS if not shutil.which(tool)] + ([] if SSHD.exists() else ["sshd"])
    if tools:
        needed = f"sudo apt-get install openssh-server sudo ({', '.join(tools)})"
        return f"lfield provision on robots with sshd; {needed}"
    tried = subprocess.run(["unshare", "--mount", "--net", "true"], capture_output=True, check=False)
    return "" if tried.returncode == 0 else "lfield provision on robots with sshd; needs namespaces"


@dataclass(frozen=True)
class RobotKind:
    """The differences of a robot from one that can be provisioned."""

    #: The request of sudo: `none` or `password`.
    sudo: str = "none"
    #: The key that sshd accepts: that of the `desk`, or `other`.
    authorized: str = "desk"
    has_systemd: bool = True
    #: The size of the file system of /opt, such as 20m; empty: that of the robot.
    opt_size: str = ""
    #: Commands of sh on the robot before it is reachable.
    setup: str = ""


class BenchRobot:
    """A running robot."""

    def __init__(self, name: str, number: int, pid: int) -> None:
        self.name, self.address, self.pid = name, f"{NETWORK}.{number}", pid

    def path(self, path: str) -> Path:
        """A file of the robot."""
        return Path(f"/proc/{self.pid}/root{path}")

    def read(self, path: str) -> str:
        """The text of a file of the robot, empty if there is none."""
        place = self.path(path)
        return place.read_text(encoding="utf-8") if place.exists() else ""

    def run(self, script: str) -> str:
        """The output of a script that root runs on the robot."""
        words = ["nsenter", "-t", str(self.pid), "-m", "-n", "-p", "-u", "-r", "-w", "sh", "-c", script]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 0, done
        return done.stdout


class RobotBench:
    """A desk with robots, as a context manager; `folder` has the keys and logs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.robots: dict[str, BenchRobot] = {}
        self._stack = ExitStack()
        self._desk: subprocess.Popen[str]

    def __enter__(self) -> RobotBench:
        for name in ("host_key", "desk", "other"):
            command = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(self.folder / name)]
            subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
        (self.folder / "known_hosts").touch()
        lines = (
            *("Host *", f"IdentityFile {self.folder}/desk", "IdentitiesOnly yes", "IdentityAgent none"),
            *(f"UserKnownHostsFile {self.folder}/known_hosts", f"User {USER}"),
        )
        (self.folder / "ssh_config").write_text("\n".join(lines) + "\n")
        script = _DESK.format(network=NETWORK)
        self._desk = self._start(["unshare", "--mount", "--net"], script, {})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _start(self, prefix: list[str], script: str, values: Mapping[str, str]) -> subprocess.Popen[str]:
        environment = {"PATH": os.environ["PATH"], "KEYS": str(self.folder), **values}
        with (self.folder / "bench.log").open("a") as log:
            process = subprocess.Popen(
                [*prefix, "sh", "-c", script],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env=environment,
            )
        # Its pipes are closed after it is killed.
        self._stack.enter_context(process)
        self._stack.callback(process.kill)
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line == "ready\n", (self.folder / "bench.log").read_text()
        return process

    def add(self, name: str, kind: RobotKind = RobotKind(), *, is_known: bool = True) -> BenchRobot:
        """Starts a robot; the desk knows its host key if `is_known`."""
        number = len(self.robots) + 11
        base = self.folder / f"robot-{number}"
        base.mkdir()
        script = _ROBOT.replace("@SYSTEMCTL@", _SYSTEMCTL).replace("@SSHD@", _SSHD_CONFIG)
        values = {
            "BASE": str(base),
            "NAME": name,
            "OPT_SIZE": kind.opt_size,
            "SUDO": kind.sudo,
            "SYSTEMD": "yes" if kind.has_systemd else "no",
            "AUTHORIZED": kind.authorized,
            "SETUP": kind.setup,
            "PYTHON": str(BASE_PYTHON),
            "PYTHON_TAG": PYTHON,
        }
        spaces = ["unshare", "--mount", "--net", "--uts", "--pid", "--fork", "--kill-child"]
        process = self._start(spaces, script, values)
        (child,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        robot = BenchRobot(name, number, int(child))
        self._connect(robot)
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
        if is_known:
            self.learn_host_key(robot)
        self.robots[name] = robot
        self.wait_for(robot)
        return robot

    def _connect(self, robot: BenchRobot) -> None:
        number = robot.address.rpartition(".")[2]
        desk = ["nsenter", "-t", str(self._desk.pid), "-n", "ip"]
        there = ["nsenter", "-t", str(robot.pid), "-n", "ip"]
        for command in (
            [
                *desk,
                "link",
                "add",
                f"v{number}",
                "type",
                "veth",
                "peer",
                "name",
                "eth0",
                "netns",
                str(robot.pid),
            ],
            [*desk, "link", "set", f"v{number}", "master", "br0", "up"],
            [*there, "addr", "add", f"{robot.address}/24", "dev", "eth0"],
            [*there, "link", "set", "eth0", "up"],
        ):
            subprocess.run(command, check=True)

    def learn_host_key(self, robot: BenchRobot) -> None:
        """Adds the host key of a robot to the known hosts of the desk."""
        key = " ".join((self.folder / "host_key.pub").read_text().split()[:2])
        with (self.folder / "known_hosts").open("a") as known:
            known.write(f"{robot.address} {key}\n")

    def wait_for(self, robot: BenchRobot) -> None:
        """Waits until its sshd accepts connections."""
        script = f"until exec 3<>/dev/tcp/{robot.address}/22; do sleep 0.05; done 2>/dev/null"
        self.run(["bash", "-c", script])

    def command(self, words: Iterable[object]) -> list[str]:
        """A command line that runs on the desk."""
        return ["nsenter", "-t", str(self._desk.pid), "-n", "-m", "--", *map(str, words)]

    def run(
        self, words: Iterable[object], environment: Mapping[str, str] | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Runs a command on the desk, without a terminal."""
        return subprocess.run(
            self.command(words),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
            env=None if environment is None else {**environment},
        )
