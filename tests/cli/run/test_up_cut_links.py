"""Messages and exit statuses of real processes with cut links, killed processes, or missing records."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Post {
    string id;
    init(string[] arg) { id = arg[0]; }
    portal stay(real seconds) { write(id + " receives\\n"); sleep(seconds); write(id + " lets go\\n"); }
}
coordinator Walker {
    init(string[] arg) { findPost(arg[1]).stay(s2f(arg[2])); }
}
"""
HOSTS = ["alpha", "bravo", "carol"]
POSTS = "//Post:a@alpha\n//Post:b@bravo\n//Post:c@carol\n"


class Proxy:
    """Forwards TCP to a port until it is cut: then open connections break, and new ones fail."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._door = socket.create_server(("127.0.0.1", 0))
        self._open: list[socket.socket] = []
        self._cut = False
        self._threads: list[threading.Thread] = []
        self._go_on(self._serve)

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self._door.getsockname()[1]}"

    def cut(self) -> None:
        self._cut = True
        for end in self._open:
            self._break(end)

    def close(self) -> None:
        self.cut()
        self._break(self._door)
        for thread in self._threads:
            thread.join()
        for end in (self._door, *self._open):
            end.close()

    def _go_on(self, work: Callable[..., None], *args: socket.socket) -> None:
        thread = threading.Thread(target=work, args=args, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _serve(self) -> None:
        while True:
            try:
                near, _ = self._door.accept()
            except OSError:
                return
            try:
                far = None if self._cut else socket.create_connection(("127.0.0.1", self._target))
            except OSError:
                far = None
            if far is None:
                near.close()
                continue
            self._open += [near, far]
            for source, target in ((near, far), (far, near)):
                self._go_on(self._forward, source, target)

    def _forward(self, source: socket.socket, target: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                if self._cut:
                    break
                target.sendall(data)
        except OSError:
            pass
        for end in (source, target):
            self._break(end)

    def _break(self, end: socket.socket) -> None:
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def proxies() -> Iterator[list[Proxy]]:
    made: list[Proxy] = []
    yield made
    for proxy in made:
        proxy.close()


@pytest.mark.few(0)
def test_a_cut_link_to_a_live_coordinator_is_no_loss(lfield, proxies):
    """In a triangle of hosts alpha connects to carol through a proxy, and the walker is on carol."""
    deployment = lfield.mission(PROGRAM, POSTS + "//Walker:walker@alpha?c&12\n")
    ports = dict(zip(HOSTS, lfield.ports.take(3), strict=True))
    proxies.append(proxy := Proxy(ports["carol"]))
    lfield.keys.give(*HOSTS)
    hosts = {}
    for host in HOSTS:
        at = {name: f"127.0.0.1:{port}" for name, port in ports.items()}
        if host == "alpha":
            at["carol"] = proxy.address
        maps = [argument for name, address in at.items() for argument in ("--map", f"{name}={address}")]
        arguments = ("up", "--deploy", deployment, "--host", host, *maps, "--until-done", "--lost-after", "4")
        hosts[host] = lfield.start(*arguments)
    hosts["carol"].wait_for("c receives")
    proxy.cut()
    hosts["alpha"].wait_for("link to carol lost")
    assert [hosts[host].wait() for host in HOSTS] == [0, 0, 0], "\n".join(p.said for p in hosts.values())
    assert hosts["carol"].out == ["c receives", "c lets go"]
    for host in HOSTS:
        assert "walker lost: " not in hosts[host].said


@pytest.mark.few(0)
def test_a_reaped_child_of_all_proves_a_loss(lfield):
    deployment = lfield.mission(PROGRAM, POSTS + "//Walker:walker@alpha?c&1000\n")
    team = lfield.start("up", "--deploy", deployment, "--all", "--until-done")
    team.wait_for(r"carol \| c receives")
    os.kill(lfield.child("carol"), signal.SIGKILL)
    assert team.wait() == 1
    for host in ("alpha", "bravo"):
        assert f"{host} | walker lost: its last host carol has ended" in team.err


@pytest.mark.few(0)
def test_a_hanging_child_of_all_is_unreachable(lfield):
    deployment = lfield.mission(PROGRAM, POSTS + "//Walker:walker@alpha?c&15\n")
    team = lfield.start("up", "--deploy", deployment, "--all", "--until-done")
    team.wait_for(r"carol \| c receives")
    hung = lfield.child("carol")
    os.kill(hung, signal.SIGSTOP)
    # The first host that detects the loss reports it and ends the team, so the other may not report it.
    team.wait_for(
        r"(alpha|bravo) \| walker unreachable, .*: it moved to carol \(transfer 1\), and carol has been "
    )
    assert team.wait() == 4
    assert any(line.startswith("carol | carol killed: it did not stop within ") for line in team.err)
    assert "walker lost: " not in team.said


#: A new start does not wait for bravo, which has no resources.
ONE_AWAY = "//Post:a@alpha\n//Walker:walker@alpha?a&0.01\n//@bravo\n"


@pytest.mark.few(0)
def test_a_first_start_waits_for_all_hosts_and_the_next_one_does_not(lfield):
    deployment = lfield.mission(PROGRAM, ONE_AWAY)
    maps = lfield.maps(["alpha", "bravo"])
    arguments = ("up", "--deploy", deployment, *maps, "--state", lfield.folder / "disk", "--until-done")
    alpha = lfield.start(*arguments, "--host", "alpha")
    alpha.wait_for(
        "walker not started: this host has no record of earlier starts, and bravo has to answer first"
    )
    assert alpha.out == []
    bravo = lfield.start(*arguments, "--host", "bravo")
    assert (alpha.wait(), bravo.wait()) == (0, 0)
    journal = lfield.folder / "disk" / "mission@alpha" / "host.journal"
    assert "walker, start 1: EXITED" in "\n".join(lfield("inspect", journal).out)
    again = lfield(*arguments, "--host", "alpha")
    assert again.out == ["a receives", "a lets go"]
    assert "walker, start 2: EXITED" in "\n".join(lfield("inspect", journal).out)


def test_the_first_start_option_skips_the_wait(lfield):
    deployment = lfield.mission(PROGRAM, ONE_AWAY)
    maps = lfield.maps(["alpha", "bravo"])
    first = lfield(
        "up", "--deploy", deployment, *maps, "--host", "alpha", "--until-done", "--first-start", status=0
    )
    assert first.out == ["a receives", "a lets go"]


@pytest.mark.few(0)
def test_all_keeps_no_journal_without_devices_unless_a_folder_is_named(lfield):
    deployment = lfield.mission(PROGRAM, ONE_AWAY)
    refused = lfield("up", "--deploy", deployment, "--all", "--first-start", status=64)
    assert refused.err[-1].startswith("lfield: --first-start is for a single host")
    arguments = ("up", "--deploy", deployment, "--all", "--until-done")
    lfield(*arguments, status=0)
    assert not list(lfield.folder.rglob("host.journal"))
    lfield(*arguments, "--state", "here", status=0)
    assert len(list(lfield.folder.rglob("host.journal"))) == 2
