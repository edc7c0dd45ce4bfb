"""A checkout of lfield with its own .venv. Only its commands are used, so that it can be an older version."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Self

from harness.paced import Paced
from harness.processes import Child, Processes, free_port

from lfield.errors import BundleError
from lfield.testing.keyring import Keyring

#: Python keeps compiled modules here, as it does after the first start of an installed program.
_KEPT = tempfile.TemporaryDirectory(prefix="lfield-bench-")
#: The keys of listening hosts, in `XDG_CONFIG_HOME`.
_KEYS = Keyring(Path(_KEPT.name) / "lfield" / "keys")


def sign(bundle: Path) -> None:
    """Sign a bundle in place: hosts with keys reject unsigned ones. An older lfield has no keys."""
    with suppress(BundleError):
        _KEYS.sign(bundle)


class CheckoutError(Exception):
    """A folder that cannot be measured; the message is one sentence."""


@dataclass(frozen=True)
class Checkout:
    """The folder of a checkout, and the Python that runs it."""

    root: Path
    python: str

    @classmethod
    def own(cls) -> Self:
        """The checkout of this file."""
        return cls(Path(__file__).resolve().parents[3], sys.executable)

    @classmethod
    def at(cls, root: Path) -> Self:
        """Another checkout. Raises CheckoutError when it has no environment of its own."""
        checkout = cls(root.resolve(), str(root.resolve() / ".venv/bin/python"))
        if not Path(checkout.python).exists():
            raise CheckoutError(f"{root} has no .venv/bin/python: run 'make test' there first")
        command = (checkout.python, "-c", "import lfield; print(lfield.__file__)")
        found = subprocess.run(command, capture_output=True, text=True, cwd="/", env=checkout.environment)
        if not found.stdout.startswith(f"{checkout.root}/"):
            raise CheckoutError(
                f"the .venv of {root} has not lfield of that folder: run 'make test' there again"
            )
        return checkout

    @property
    def environment(self) -> dict[str, str]:
        """Environment of the processes: files go to a temporary folder, where no operator finds the hosts."""
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        kept_variables = ("PYTHONPYCACHEPREFIX", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_RUNTIME_DIR")
        return inherited | dict.fromkeys(kept_variables, _KEPT.name)

    @property
    def commit(self) -> str:
        """The short commit of the checkout."""
        command = ("git", "-C", str(self.root), "describe", "--always", "--dirty")
        try:
            return subprocess.run(command, capture_output=True, text=True).stdout.strip() or "unknown"
        except OSError:
            return "unknown"

    @property
    def keeping_nothing(self) -> tuple[str, ...]:
        """The options of `lfield up` for a host without a journal; none for versions without journals."""
        return ("--volatile",) if "--volatile" in self._options_of_up else ()

    @property
    def engines(self) -> Mapping[str, tuple[str, ...]]:
        """The engines of a host, and the options of `lfield up` for each."""
        found = re.search(r"--engine \{([\w,]+)\}", self._options_of_up)
        names = found[1].split(",") if found else []
        chosen = {name: ("--engine", name) for name in names if name != "auto"}
        return chosen or {"reference": ()}

    @cached_property
    def _options_of_up(self) -> str:
        command = (self.python, "-m", "lfield", "up", "--help")
        usage = subprocess.run(command, capture_output=True, text=True, cwd=self.root, env=self.environment)
        return usage.stdout

    def run(self, processes: Processes, *arguments: str, merged: bool = False) -> Child:
        """Start a Python command of the checkout, in its folder."""
        return processes.start(
            self.python, *arguments, environment=self.environment, folder=self.root, merged=merged
        )

    def lfield(self, processes: Processes, *arguments: str, merged: bool = False) -> Child:
        """Start an `lfield` command of the checkout."""
        return self.run(processes, "-m", "lfield", *arguments, merged=merged)

    def fake(self, processes: Processes, kind: str, *arguments: str) -> str:
        """Start a stand-alone fake; returns the endpoint that it listens on."""
        return self.run(processes, "-m", "lfield_sim", kind, *arguments).line().split()[1]


@dataclass(slots=True)
class Mission:
    """An L program and its deployment, written to a folder; `agents` are lines of the deployment file.

    Hosts write journals in that folder if `kept` is set, otherwise none. `options` are further options of
    `lfield up`.
    """

    folder: Path
    program: str
    agents: Sequence[str]
    devices: str = ""
    kept: bool = False
    options: Sequence[str] = ()
    addresses: Mapping[str, str] = field(init=False)

    def __post_init__(self) -> None:
        self.source.write_text(self.program, encoding="utf-8")
        self.deploy.write_text("\n".join([*self.agents, ""]), encoding="utf-8")
        if self.devices:
            self.deploy.with_suffix(".devices.yaml").write_text(self.devices, encoding="utf-8")
        hosts = dict.fromkeys(agent.partition("@")[2].partition("?")[0] for agent in self.agents)
        self.addresses = {host: f"127.0.0.1:{free_port()}" for host in hosts}
        _KEYS.give(*hosts)

    @property
    def source(self) -> Path:
        """The file with the L text."""
        return self.folder / "mission.L"

    @property
    def deploy(self) -> Path:
        """The deployment file."""
        return self.folder / "mission.dL"

    @property
    def arguments(self) -> tuple[str, ...]:
        """The options with the mission and the addresses of its hosts."""
        maps = [argument for host, at in self.addresses.items() for argument in ("--map", f"{host}={at}")]
        return "--deploy", str(self.deploy), *maps

    def up(self, checkout: Checkout, processes: Processes) -> list[Child]:
        """Start a process for each host."""
        return [self.host(checkout, processes, host) for host in self.addresses]

    def host(self, checkout: Checkout, processes: Processes, host: str, *, merged: bool = False) -> Child:
        """Start the process of one host; with `merged` its log can be read too."""
        memory = ("--state", str(self.folder / "state")) if self.kept else checkout.keeping_nothing
        words = *self.arguments, *memory, *self.options
        return checkout.lfield(processes, "up", *words, "--host", host, merged=merged)


def paced_mission(
    checkout: Checkout,
    processes: Processes,
    program: Path,
    agents: Sequence[str],
    devices: str = "",
    *,
    kept: bool = False,
    options: Sequence[str] = (),
) -> Paced:
    """Start a mission that measures itself in rounds; the first host writes the samples."""
    text = program.read_text(encoding="utf-8")
    mission = Mission(processes.folder(), text, agents, devices, kept, options)
    return Paced(mission.up(checkout, processes))
