"""A mission test has no access to this computer's devices, network and processes, by any way."""

from __future__ import annotations

import asyncio
import ctypes
import multiprocessing
import os
import signal
import socket
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from lfield.errors import MissionTestError, RealEndpoint
from lfield.testing.mission.mission_team import MissionTeam

PROGRAM = "coordinator Boss { init(string[] arg) { while (true) sleep(1.0); } }"


@pytest.fixture
def still(tmp_path, lfield_mission) -> MissionTeam:
    """A team without actions."""
    (tmp_path / "still.L").write_text(PROGRAM)
    (tmp_path / "still.dL").write_text("//Boss:boss@alpha\n")
    team: MissionTeam = lfield_mission(tmp_path / "still.dL")
    return team


@pytest.fixture
def connected():
    """A socket that was connected before the team existed."""
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        door.listen()
        with socket.create_connection(door.getsockname()) as one:
            one.setblocking(False)
            yield one


@pytest.fixture
def accepted(tmp_path):
    """A Unix socket connection that was accepted before the team existed."""
    with socket.socket(socket.AF_UNIX) as door, socket.socket(socket.AF_UNIX) as caller:
        door.bind(str(tmp_path / "door"))
        door.listen()
        caller.connect(str(tmp_path / "door"))
        one, _ = door.accept()
        caller.send(b"x")
        with one:
            yield one


@pytest.fixture
def sleeper():
    """A process in its own group that was started before the team existed."""
    with subprocess.Popen(["/bin/sleep", "60"], start_new_session=True) as one:
        yield one
        one.kill()


def open_device(path: str) -> None:
    Path(path).open("rb").close()


def by_a_link() -> None:
    os.symlink("/dev/tty1", "serial")
    open_device("serial")


def from_a_folder() -> None:
    root = os.open("/", os.O_RDONLY)
    os.open("dev/tty1", os.O_RDONLY, dir_fd=root)


def listening() -> None:
    with socket.socket() as door:
        door.listen()


def bound() -> None:
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))


def by_a_process_of_python() -> None:
    multiprocessing.get_context("spawn").Process(target=print).start()


def by_a_fork_of_python() -> None:
    multiprocessing.get_context("fork").Process(target=print).start()


def by_a_pipe() -> None:
    os.mkfifo("pipe")
    os.open("pipe", os.O_RDWR)


def by_a_pair_that_says_where_to() -> None:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with one, other:
        one.sendto(b"x", "/run/nobody")


def by_a_pair_that_leads_elsewhere() -> None:
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with one, other:
        one.connect("/run/nobody")


DEEDS: dict[str, tuple[Callable[[], object], str]] = {
    "name": (lambda: socket.create_connection(("127.0.0.1", 9), timeout=0.1), "reach 127.0.0.1:9"),
    "host": (lambda: socket.gethostbyname("localhost"), "reach localhost"),
    "address": (lambda: socket.gethostbyaddr("127.0.0.1"), "reach 127.0.0.1"),
    "listen": (listening, "use a socket"),
    "bind": (bound, "listen at"),
    "device": (lambda: os.open("/dev/ttyS0", os.O_RDONLY), "open /dev/ttyS0"),
    "none": (lambda: open_device("/dev/ttyUSB77"), "open /dev/ttyUSB77"),
    "slashes": (lambda: os.open("//dev//tty1", os.O_RDONLY), "open //dev//tty1"),
    "bytes": (lambda: os.open(b"/dev/tty1", os.O_RDONLY), "open /dev/tty1"),
    "root": (lambda: os.open("/proc/self/root/dev/tty1", os.O_RDONLY), "open /proc/self/root/dev/tty1"),
    "link": (by_a_link, "open serial"),
    "folder": (from_a_folder, "open dev/tty1"),
    "pipe": (by_a_pipe, "open pipe"),
    "terminal": (lambda: os.openpty(), "open a terminal"),
    "pair_to": (by_a_pair_that_says_where_to, "send to /run/nobody"),
    "pair_away": (by_a_pair_that_leads_elsewhere, "connect to /run/nobody"),
    "fork": (os.fork, "start a process"),
    "system": (lambda: os.system("true"), "start "),
    "spawn": (lambda: os.spawnv(os.P_WAIT, "/bin/true", ["true"]), "start a process"),
    "posix_spawn": (lambda: os.posix_spawn("/bin/true", ["true"], {}), "start /bin/true"),
    "run": (lambda: subprocess.run(["/bin/true"]), "start /bin/true"),
    "python": (by_a_process_of_python, "start "),
    "python_fork": (by_a_fork_of_python, "start a process"),
    "library": (lambda: ctypes.CDLL("libm.so.6"), "load libm.so.6"),
    "itself": (lambda: ctypes.PyDLL(None).system, ".* by ctypes"),
}


@pytest.mark.few(10)
@pytest.mark.parametrize("name", DEEDS)
def test_real_access_is_refused_also_if_the_code_suppresses_the_error(still, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    operation, text = DEEDS[name]
    received = []

    def silently() -> None:
        try:
            received.append(operation())
        except Exception:
            return

    still.at(0.5, silently)
    with pytest.raises(RealEndpoint, match=f"it tried to {text}"):
        still.run(1.0)
    assert not received


def test_a_socket_connected_before_is_refused(connected, still):
    for operation in (
        lambda: connected.send(b"x"),
        lambda: connected.sendall(b"x"),
        lambda: connected.recv(1),
        lambda: connected.recvfrom_into(bytearray(1)),
        lambda: connected.recvmsg(1),
        lambda: connected.recvmsg_into([bytearray(1)]),
    ):
        still.at(still.now + 0.5, operation)
        with pytest.raises(RealEndpoint, match="it tried to use a socket"):
            still.run(1.0)
    for operation in (lambda: connected.sendto(b"x", ("", 1)), lambda: connected.sendmsg([b"x"])):
        still.at(still.now + 0.5, operation)
        with pytest.raises(RealEndpoint, match="it tried to send to"):
            still.run(1.0)


def test_a_socket_accepted_before_is_refused(accepted, still):
    for operation in (lambda: accepted.send(b"x"), lambda: accepted.recv(1), lambda: accepted.recvmsg(1)):
        still.at(still.now + 0.5, operation)
        with pytest.raises(RealEndpoint, match="it tried to use a socket"):
            still.run(1.0)
    still.at(still.now + 0.5, lambda: accepted.sendmsg([b"x"]))
    with pytest.raises(RealEndpoint, match="it tried to send to"):
        still.run(1.0)


def test_a_process_started_before_cannot_be_ended(sleeper, still):
    descriptor = os.pidfd_open(sleeper.pid)
    for operation in (
        sleeper.terminate,
        lambda: os.kill(sleeper.pid, signal.SIGKILL),
        lambda: os.killpg(sleeper.pid, signal.SIGKILL),
        lambda: signal.pidfd_send_signal(descriptor, signal.SIGKILL),
    ):
        still.at(still.now + 0.5, operation)
        with pytest.raises(RealEndpoint, match="it tried to send a signal to"):
            still.run(1.0)
    os.close(descriptor)
    still.close()
    assert sleeper.poll() is None


@pytest.mark.parametrize(
    ("deed", "said"),
    [
        (lambda: asyncio.open_connection("127.0.0.1", 9), "connect to 127.0.0.1:9"),
        (lambda: asyncio.open_unix_connection("/run/nobody"), "connect to a Unix socket"),
        (lambda: asyncio.start_unix_server(print, "/run/nobody"), "listen at a Unix socket"),
        (lambda: asyncio.create_subprocess_exec("true"), "start true"),
        (lambda: asyncio.create_subprocess_shell("true"), "run a command in a shell"),
        (lambda: asyncio.get_running_loop().sock_recv(None, 1), "use a socket"),
        (
            lambda: asyncio.get_running_loop().create_connection(asyncio.Protocol, sock=object()),
            "use a socket",
        ),
        (lambda: asyncio.get_running_loop().add_reader(0, print), "wait for a descriptor"),
        (
            lambda: asyncio.get_running_loop().create_datagram_endpoint(asyncio.DatagramProtocol),
            "open a datagram socket",
        ),
    ],
)
def test_real_access_by_a_drivers_event_loop_is_refused(still, deed, said):
    async def silently() -> None:
        try:
            await deed()
        except Exception:
            return

    (life,) = still._fleet.runs.values()
    still.at(0.5, lambda: life.process.loop.enter(lambda: life.process.loop.create_task(silently())))
    with pytest.raises(RealEndpoint, match=f"it tried to {said}"):
        still.run(1.0)


@pytest.fixture
def door():
    """A listening socket from before the team; connections are accepted immediately."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        one.listen()
        one.setblocking(False)
        yield one


def has_been_knocked_at(address: socket.socket) -> bool:
    try:
        address.accept()[0].close()
    except BlockingIOError:
        return False
    return True


REACHES_OUT = """
import socket
try:
    socket.create_connection(("127.0.0.1", {port})).close()
except Exception:
    pass
"""


def test_real_access_while_a_driver_package_is_imported_is_refused(
    door, tmp_path, monkeypatch, lfield_mission
):
    (tmp_path / "eager_driver.py").write_text(REACHES_OUT.format(port=door.getsockname()[1]))
    metadata = tmp_path / "eager-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: eager\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[lfield.drivers.v1]\neager = eager_driver:PLUGIN\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "still.L").write_text(PROGRAM)
    (tmp_path / "still.dL").write_text("//Boss:boss@alpha\n")
    with pytest.raises(pytest.fail.Exception, match="it tried to reach"):
        lfield_mission(tmp_path / "still.dL")
    assert not has_been_knocked_at(door)


def test_real_access_while_a_double_is_inspected_is_refused(door, tmp_path, lfield_mission):
    class Eager:
        @property
        def live_attributes(self) -> dict[str, object]:
            socket.create_connection(door.getsockname()).close()
            return {}

    (tmp_path / "post.L").write_text("resource Post { init(string[] arg) { } }\n" + PROGRAM)
    (tmp_path / "post.dL").write_text("//Post:post@alpha\n//Boss:boss@alpha\n")
    with pytest.raises(pytest.fail.Exception, match="it tried to reach"):
        lfield_mission(tmp_path / "post.dL", doubles={"post": Eager()})
    assert not has_been_knocked_at(door)
    bound()


def test_real_access_by_a_team_closed_meanwhile_is_refused(still):
    still.at(0.5, still.close)
    with pytest.raises(MissionTestError, match="cannot close it"):
        still.run(1.0)
    with pytest.raises(RealEndpoint):
        bound()


def test_real_access_by_the_test_its_conditions_and_threads_is_refused(still):
    with pytest.raises(RealEndpoint, match="it tried to listen at"):
        bound()
    # It was reported once, and the test continues.
    still.run(1.0)
    with pytest.raises(RealEndpoint, match="it tried to reach"):
        still.run(until=lambda: bool(socket.gethostbyname("localhost")))
    lines: list[str] = []

    def reach_out() -> None:
        try:
            socket.gethostbyname("localhost")
        except RealEndpoint as error:
            lines.append(str(error))

    for end in (lambda: still.run(1.0), still.close):
        thread = threading.Thread(target=reach_out)
        thread.start()
        thread.join()
        with pytest.raises(RealEndpoint, match="it tried to reach"):
            end()
    assert len(lines) == 2


def test_a_thread_of_another_owner_is_not_restricted(tmp_path, lfield_mission):
    begin, done = threading.Event(), threading.Event()
    names = []

    def debugger() -> None:
        begin.wait()
        names.append(socket.gethostbyname("localhost"))
        done.set()

    threading.Thread(target=debugger, daemon=True).start()
    (tmp_path / "still.L").write_text(PROGRAM)
    (tmp_path / "still.dL").write_text("//Boss:boss@alpha\n")
    team = lfield_mission(tmp_path / "still.dL")
    begin.set()
    assert done.wait(10.0)
    team.run(1.0)
    assert names


def test_harmless_paths_and_socket_pairs_are_allowed(still):
    for path in ("/dev/null", "/dev/urandom", "/dev/zero"):
        Path(path).open("rb").close()
    one, other = socket.socketpair()
    one.sendall(b"x")
    assert other.recv(1) == b"x"
    one.sendmsg([b"y"])
    assert other.recvmsg(1)[0] == b"y"
    one.close()
    other.close()
    asyncio.run(asyncio.sleep(0))


def test_without_a_team_a_test_is_not_restricted(connected, still):
    send, opened = socket.socket.send, os.open
    still.close()
    assert socket.socket.send is not send
    assert os.open is not opened
    assert "send" not in vars(socket.socket)
    connected.send(b"x")
    bound()
