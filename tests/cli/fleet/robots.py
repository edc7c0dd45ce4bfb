"""A team of robots on this computer: each has a service with an address, a state and a runtime directory."""

from __future__ import annotations

import json
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

#: A coordinator that visits a resource on the other host, and waits there for an order to end.
PROGRAM = """
resource Post {
    boolean done;
    init(string[] arg) { done = false; }
    portal table() { TABLE }
    portal visit(int n) { write("visit " + i2s(n) + "\\n"); }
}
coordinator Walker {
    init(string[] arg) {
        int n = 0;
        while (n < ROUNDS) {
            n = n + 1;
            try { findPost(arg[1]).visit(n); sleep(PAUSE); }
            catch (RestartException e) { print("restarted"); }
        }
        print("walked");
    }
}
"""
#: Constant text, so that a bundle has several pieces.
PADDING = "".join(f'write("{n * n:08d} {n**3:012d} {n**5:020d}");\n' for n in range(200))
TEAM = "//Walker:tom@alpha?post\n//Post:post@bravo\n"


def program(rounds: int = 1, pause: float = 0.0, text: str = "visit") -> str:
    """The program; `text` is what a post prints."""
    return (
        PROGRAM.replace("TABLE", PADDING)
        .replace("ROUNDS", str(rounds))
        .replace("PAUSE", f"{pause:.1f}")
        .replace("visit ", f"{text} ")
    )


class Robots:
    """The robots of one test, in the fabric of a `router` or on loopback. Commands of the desk run in
    `lfield.folder`."""

    def __init__(self, lfield, hosts: Sequence[str], runtime: str, router: str = "") -> None:
        self._lfield, self.hosts, self._runtime = lfield, hosts, Path(runtime)
        self.ports = dict(
            zip(hosts, zip(*[iter(lfield.ports.take(2 * len(hosts)))] * 2, strict=True), strict=True)
        )
        lfield.keys.give(*hosts)
        self.inventory = lfield.write(
            "config/lfield/inventory.yaml",
            (f"zenoh: {{connect: [{router}]}}\n" if router else "")
            + "hosts:\n"
            + "".join(
                f"  {host}: {{addresses: ['{f'zenoh:{host}' if router else '127.0.0.1'}:{mission}'], "
                f"service_port: {service}}}\n"
                for host, (mission, service) in self.ports.items()
            ),
        )
        self.services: dict[str, Any] = {}

    def up(self, *hosts: str, options: str = "") -> None:
        """Start the services of some hosts, by default of all, and wait until they listen."""
        for host in hosts or self.hosts:
            runtime = self._runtime / host
            runtime.mkdir(mode=0o700, exist_ok=True)
            arguments = ["service", "--host", host, "--state", f"state-{host}"]
            arguments += [f"--up-options={options}"] if options else []
            self.services[host] = self._lfield.start(*arguments, env={"XDG_RUNTIME_DIR": str(runtime)})
        for host in hosts or self.hosts:
            self.services[host].wait_for(f"^{host} service listening")

    def kill(self, host: str) -> None:
        """Kill the process of a service; its child processes continue."""
        self.services[host].signal(signal.SIGKILL)
        self.services[host].popen.wait()

    def state(self, host: str) -> dict[str, Any]:
        """The durable state of a service."""
        (file,) = self._lfield.folder.glob(f"state-{host}/lfield-*/service/state.json")
        return json.loads(file.read_text())

    def mission(self, **options: Any) -> None:
        """Write the program of `mission.dL`."""
        self._lfield.mission(program(**options), TEAM)


def told(said) -> dict[str, Any]:
    """The JSON object that a command has printed."""
    return json.loads("\n".join(said.out))
