"""Robots with services on an emulated radio, and a desk; with keys, an inventory and a mission."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from emulator.radio import Radio

from lfield.testing.keyring import Keyring

HOSTS, DESK = ("alpha", "bravo"), "desk"
PROGRAM = """
resource Post {{
    init(string[] arg) {{ }}
    portal table() {{ {table} }}
}}
"""
TEAM = "//Post:one@alpha\n//Post:two@bravo\n"


class RadioFleet:
    """Services in the namespaces of a radio, which is perfect at first."""

    def __init__(self, radio: Radio, folder: Path) -> None:
        self.radio, self.folder = radio, folder
        config = folder / "config" / "lfield"
        Keyring(config / "keys").give(*HOSTS)
        hosts = "".join(f"  {host}: {{addresses: [{radio[host].address}]}}\n" for host in HOSTS)
        (config / "inventory.yaml").write_text(f"hosts:\n{hosts}")
        self.services: dict[str, subprocess.Popen[Any]] = {}
        self._environment = {**os.environ, "XDG_CONFIG_HOME": str(folder / "config"), "LFIELD_RUNS": "here"}

    def up(self, *hosts: str) -> None:
        """Start the services of some hosts, by default of all, and wait until all answer."""
        for host in hosts or HOSTS:
            arguments = ["service", "--host", host, "--state", str(self.folder / f"state-{host}")]
            self.services[host] = self._start(
                host, *arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
        end = time.monotonic() + 60
        while self.desk("status").wait(60):
            assert time.monotonic() < end

    def mission(self, lines: int, last: str = "") -> Path:
        """Write a mission with texts that cannot be compressed; `last` changes its last one."""
        texts = [hashlib.sha256(bytes([n % 251, n // 251])).hexdigest() for n in range(lines)]
        table = "".join(f'write("{text}");\n' for text in [*texts, last])
        (self.folder / "mission.L").write_text(PROGRAM.format(table=table))
        (self.folder / "mission.dL").write_text(TEAM)
        return self.folder / "mission.dL"

    def desk(self, *arguments: object) -> subprocess.Popen[Any]:
        """Start a command at the desk."""
        return self._start(
            DESK, *map(str, arguments), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def _start(self, host: str, *arguments: str, **options: Any) -> subprocess.Popen[Any]:
        runtime = self.folder / f"run-{host}"
        runtime.mkdir(mode=0o700, exist_ok=True)
        environment = {
            **self._environment,
            "XDG_RUNTIME_DIR": str(runtime),
            "LFIELD_INVENTORY": str(self.folder / "config" / "lfield" / "inventory.yaml"),
        }
        command = [sys.executable, "-m", "lfield", *arguments]
        return self.radio[host].start(command, env=environment, cwd=self.folder, **options)


def result_of(process: subprocess.Popen[Any], seconds: float) -> dict[str, Any]:
    """The JSON object that a command prints."""
    out, _ = process.communicate(timeout=seconds)
    found: dict[str, Any] = json.loads(out)
    return found
