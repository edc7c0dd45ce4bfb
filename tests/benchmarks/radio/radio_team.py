"""A team of lfield hosts on an emulated radio, each a process in its own namespace, and a desk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from emulator.radio import Radio
from harness.checkout import Checkout
from harness.processes import Child, Processes

from lfield.testing.keyring import Keyring

DESK = "desk"
PORT = 8181
#: The port for peers of a Zenoh fabric.
FABRIC_PORT = 7447
#: Seconds for the end of a host.
TIMEOUT = 10.0
_CONFIG = Path("lfield") / "keys"


class Prepared:
    """A built and signed mission with the keys of its hosts and the desk, for teams on many radios."""

    def __init__(
        self, checkout: Checkout, processes: Processes, program: str, agents: Sequence[str], devices: str = ""
    ) -> None:
        self.checkout, self.processes, self.simulated = checkout, processes, bool(devices)
        self.hosts = list(dict.fromkeys(agent.partition("@")[2].partition("?")[0] for agent in agents))
        self.folder = processes.folder()
        self.bundle, deployment = self.folder / "mission.lfm", self.folder / "mission.dL"
        deployment.with_suffix(".L").write_text(program, encoding="utf-8")
        deployment.write_text("\n".join([*agents, ""]), encoding="utf-8")
        if devices:
            deployment.with_suffix(".devices.yaml").write_text(devices, encoding="utf-8")
        checkout.lfield(processes, "build", str(deployment), "-o", str(self.bundle)).wait()
        keyring = Keyring(self.folder / _CONFIG)
        keyring.give(*self.hosts)
        keyring.sign(self.bundle)


class RadioTeam:
    """The hosts of a mission and the desk, initially on a perfect radio.

    Without `kept` the hosts write no journal and do not wait for a disk. With `over_zenoh` the hosts are
    peers in a fabric without a router, so that their packets cross the radio once, as with TCP.
    """

    def __init__(self, prepared: Prepared, seed: int, *, kept: bool, over_zenoh: bool = False) -> None:
        self._prepared, self._kept, self._over_zenoh = prepared, kept, over_zenoh
        self.radio = prepared.processes.keep(Radio(*prepared.hosts, DESK, seed=seed))
        self._folder = prepared.processes.folder()
        self.children = {host: self._up(host) for host in prepared.hosts}
        prepared.processes.at_end(self._end)

    @property
    def mission(self) -> list[str]:
        """Arguments for a command: the bundle, and the addresses of the hosts."""
        addresses = {host: self.radio[host].address for host in self._prepared.hosts}
        maps = [argument for host, at in addresses.items() for argument in ("--map", f"{host}={at}:{PORT}")]
        return [str(self._prepared.bundle), *maps]

    def _network(self, host: str) -> list[str]:
        """The options of a host with the addresses of the other hosts."""
        if not self._over_zenoh:
            return self.mission[1:]
        hosts = self._prepared.hosts
        others = [other for other in hosts if hosts.index(other) < hosts.index(host)]
        connect = ", ".join(f"tcp/{self.radio[other].address}:{FABRIC_PORT}" for other in others)
        rows = "".join(f'  {each}: {{addresses: ["zenoh:{each}"]}}\n' for each in hosts)
        inventory = self._folder / f"{host}.inventory.yaml"
        listen = f"tcp/{self.radio[host].address}:{FABRIC_PORT}"
        text = f"zenoh: {{connect: [{connect}], listen: [{listen}]}}\nhosts:\n{rows}"
        inventory.write_text(text, encoding="utf-8")
        return ["--inventory", str(inventory)]

    def desk(self, *arguments: str) -> Child:
        """Start a Python command at the desk, which has keys with all rights."""
        return self._start(DESK, *arguments)

    def watch(self) -> Child:
        """Start `lfield watch` at the desk; the first output line with http has the link of the page."""
        return self.desk("-m", "lfield", "watch", *self.mission)

    def _end(self) -> None:
        """End the hosts by SIGTERM: the guard of a killed host continues to run."""
        for child in self.children.values():
            child.ask_to_end()
        for child in self.children.values():
            child.ended(TIMEOUT)

    def _up(self, host: str) -> Child:
        journal = "--state", str(self._folder / host / "kept")
        memory = journal if self._kept else self._prepared.checkout.keeping_nothing
        simulated = ("--sim",) if self._prepared.simulated else ()
        arguments = str(self._prepared.bundle), *self._network(host), "--host", host, *memory, *simulated
        return self._start(host, "-m", "lfield", "up", *arguments)

    def _start(self, name: str, *arguments: str) -> Child:
        own = self._folder / name
        own.mkdir(mode=0o700, exist_ok=True)
        checkout = self._prepared.checkout
        environment = checkout.environment | {
            "XDG_CONFIG_HOME": str(self._prepared.folder),
            "XDG_RUNTIME_DIR": str(own),
            "XDG_STATE_HOME": str(own),
            "PYTHONUNBUFFERED": "1",
        }
        line = self.radio[name].line((checkout.python, *arguments))
        start = self._prepared.processes.start
        return start(*line, environment=environment, folder=checkout.root, merged=True)
