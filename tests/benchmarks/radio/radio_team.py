"""A team of lfield hosts on an emulated radio, a process each in a namespace of its own, and a desk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from emulator.radio import Radio
from harness.checkout import Checkout
from harness.processes import Child, Processes

from lfield.testing.keys import Keyring

DESK = "desk"
PORT = 8181
#: Seconds that a host has to end.
PATIENCE = 10.0
_CONFIG = Path("lfield") / "keys"


class RadioTeam:
    """Hosts that run one mission with keys of their own, and the desk; on a perfect radio at first."""

    def __init__(
        self,
        checkout: Checkout,
        processes: Processes,
        program: str,
        agents: Sequence[str],
        devices: str = "",
        *,
        seed: int = 1,
        kept: bool = True,
    ) -> None:
        self._checkout, self._processes, self._kept = checkout, processes, kept
        self.hosts = list(dict.fromkeys(agent.partition("@")[2].partition("?")[0] for agent in agents))
        self.radio = processes.keep(Radio(*self.hosts, DESK, seed=seed))
        self._folder = processes.folder()
        self.bundle = self._build(program, agents, devices)
        self.children = {host: self._up(host) for host in self.hosts}
        processes.at_end(self._end)

    @property
    def maps(self) -> list[str]:
        """The options that say where the hosts are."""
        return [
            word for host in self.hosts for word in ("--map", f"{host}={self.radio[host].address}:{PORT}")
        ]

    def desk(self, *words: str) -> Child:
        """Start a Python command at the desk, which has the keys of a person who may do everything."""
        return self._start(DESK, self._checkout.python, *words)

    def watch(self) -> Child:
        """Start `lfield watch` at the desk; its first line with http has the link of the page."""
        return self.desk("-m", "lfield", "watch", str(self.bundle), *self.maps)

    def _end(self) -> None:
        """End the hosts in order: the guard of one that is killed stays with its device."""
        for child in self.children.values():
            child.ask_to_end()
        for child in self.children.values():
            child.ended(PATIENCE)

    def _up(self, host: str) -> Child:
        journal = "--state", str(self._folder / host / "kept")
        memory = journal if self._kept else self._checkout.keeping_nothing
        simulated = ("--sim",) if self._simulated else ()
        words = "-m", "lfield", "up", str(self.bundle), "--host", host, *self.maps, *memory, *simulated
        return self._start(host, self._checkout.python, *words)

    def _start(self, name: str, *words: str) -> Child:
        own = self._folder / name
        own.mkdir(mode=0o700, exist_ok=True)
        environment = self._checkout.environment | {
            "XDG_CONFIG_HOME": str(self._folder),
            "XDG_RUNTIME_DIR": str(own),
            "XDG_STATE_HOME": str(own),
            "PYTHONUNBUFFERED": "1",
        }
        line = self.radio[name].line(words)
        return self._processes.start(*line, environment=environment, folder=self._checkout.root, merged=True)

    def _build(self, program: str, agents: Sequence[str], devices: str) -> Path:
        deployment, bundle = self._folder / "mission.dL", self._folder / "mission.lfm"
        (self._folder / "mission.L").write_text(program, encoding="utf-8")
        deployment.write_text("\n".join([*agents, ""]), encoding="utf-8")
        self._simulated = bool(devices)
        if devices:
            deployment.with_suffix(".devices.yaml").write_text(devices, encoding="utf-8")
        self._checkout.lfield(self._processes, "build", str(deployment), "-o", str(bundle)).wait()
        keyring = Keyring(self._folder / _CONFIG)
        keyring.give(*self.hosts)
        keyring.sign(bundle)
        return bundle
