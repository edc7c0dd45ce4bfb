"""`lfield up --all`: every host of a mission as a process, on free ports or at the addresses of --map.

All hosts run the same bundle; no host compiles.

Each child inherits its listening socket, so that no other process takes the port. Its stdin is a supervision
pipe: a line reports a sibling that has exited, and at EOF the child stops in order, its devices in their safe
states.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import socket
import sys
from asyncio.subprocess import PIPE, Process
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TextIO

from msgspec.structs import replace

from lfield import exit_status
from lfield.cli.mission_argument import mission_path, setup_command
from lfield.cli.run.host_keys import ephemeral_keys
from lfield.cli.run.record_options import passed_on
from lfield.cli.run.run_summary import summary
from lfield.clock import SystemClock
from lfield.driver.binding import longest_rest
from lfield.host.process import parent_pipe
from lfield.host.process.operator_terminal import read_standard_input
from lfield.host.process.run_result import RunResult, read_result
from lfield.host.process.shutdown_signals import REPEAT_WINDOW, ShutdownSignals, install_signal_handlers
from lfield.mission.team import parse_maps
from lfield.net.local_addresses import open_listening_socket
from lfield.operator.runs import ControlSockets, publish_run, run_manifest
from lfield.text import log_messages
from lfield.text.log_messages import json_line
from lfield.text.terminal_escape import escape, escape_line

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from lfield.cli.views.live_view import LiveView
    from lfield.mission.mission import Mission
    from lfield.text.log_messages import LogLine

#: Time-out of a silent host under --all, in seconds: such a host hangs, so the time is shorter than in the
#: field.
DEFAULT_LOST_AFTER = 3.0
#: The address of a host without --map.
ANY_FREE_PORT = "127.0.0.1:0"
#: Time for hosts to exit, in seconds, after their devices have come to rest.
KILL_GRACE = 10.0
#: Time to read the last output of the hosts, in seconds.
OUTPUT_TIMEOUT = 3.0
#: Time for the guards of a killed host to confirm their safe states, in seconds.
CONFIRMATION_TIMEOUT = 1.0
#: The longest line that is forwarded whole, in bytes.
MAX_LINE = 1 << 20
#: The exit statuses of a host that has run; any other means that it could not start, or failed.
HOST_STATUSES = (exit_status.DONE, exit_status.FAILED, exit_status.UNSAFE, exit_status.UNKNOWN_OUTCOME)


def run_all(mission: Mission, file: Path, args: argparse.Namespace, report: Callable[[str], None]) -> int:
    """Run every host of a mission until all have ended; returns the exit status.

    `report` prints the commands that would not find the run. Raises OutputFileError when none would.
    """
    mapped = parse_maps(args.map, mission.team)
    reserved = {host: open_listening_socket(mapped.get(host, ANY_FREE_PORT)) for host in mission.team.hosts}
    addresses = {host: address for host, (_, address) in reserved.items()}
    named = mission_path(args)
    with publish_run(
        run_manifest(mission.at(mission.team.at(addresses)), named, addresses), report
    ) as sockets:
        return asyncio.run(_HostProcesses(mission, file, args, reserved, addresses, sockets).run())


def with_host(text: str, host: str) -> str:
    """A JSON line of a host; an error that its process printed names no host."""
    with suppress(json.JSONDecodeError):
        found = json.loads(text)
        if isinstance(found, dict) and "host" not in found:
            return json.dumps({"host": host, **found})
    return text


def guard_report(text: str, host: str) -> dict[str, Any] | None:
    """The JSON log line of a guard whose host has ended; None for any other line of stderr."""
    with suppress(json.JSONDecodeError):
        found = json.loads(text)
        if (
            isinstance(found, dict)
            and found.get("host") == host
            and {"code", "level", "text"} <= found.keys()
        ):
            return found
    return None


class _HostProcesses:
    def __init__(
        self,
        mission: Mission,
        file: Path,
        args: argparse.Namespace,
        reserved: dict[str, tuple[socket.socket, str]],
        addresses: dict[str, str],
        control_sockets: ControlSockets,
    ) -> None:
        self.mission, self.file, self.args, self.control_sockets = mission, file, args, control_sockets
        self.reserved, self.addresses = reserved, addresses
        self.keys = ephemeral_keys(addresses, mission.release)
        self.children: dict[str, Process] = {}
        self.pipes: list[asyncio.ReadTransport] = []
        #: Pipes to which the hosts write their results.
        self.results: dict[str, int] = {}
        #: Safe states that the guards of hosts have confirmed after the end of the host, by host and device.
        self.confirmed: dict[str, dict[str, str]] = {host: {} for host in addresses}
        #: Set by each report of a guard whose host has ended.
        self.guard_reported = asyncio.Event()
        #: The reasons why hosts were killed.
        self.killed: dict[str, str] = {}
        self.width = max(len(host) for host in addresses)
        self.stop_signals = ShutdownSignals(SystemClock(), self.stop_again)
        #: Set when the remaining hosts must stop.
        self.stop_event = asyncio.Event()
        #: The exit status of the first host that could not start.
        self.refused = 0
        self.view: LiveView | None = None
        #: The hosts that read the operator's input.
        self.readers = mission.reading_hosts

    async def run(self) -> int:
        started = asyncio.get_running_loop().time()
        install_signal_handlers(self.stop_signals)
        # The table would disable the echo of a typed line.
        if sys.stderr.isatty() and not self.args.json and not self.readers:
            from lfield.cli.views.live_view import LiveView

            self.view = LiveView(self.mission, self.control_sockets.addresses)
        readers = [task for host in self.addresses for task in await self.start(host)]
        if self.readers:
            read_standard_input(self.on_typed)
        watcher = asyncio.create_task(self.stop_on_signal())
        if self.view:
            self.view.start()
        statuses = await asyncio.gather(*(self.wait(host) for host in self.addresses))
        watcher.cancel()
        # The guard of a killed host holds the pipe open until its vehicle has landed.
        _, late = await asyncio.wait(readers, timeout=OUTPUT_TIMEOUT)
        for reader in late:
            reader.cancel()
        for pipe in self.pipes:
            pipe.close()
        if self.view:
            await self.view.stop()
        if self.stop_signals.first_requested.is_set():
            status = exit_status.most_severe(
                [exit_status.INTERRUPTED, *(s for s in statuses if s == exit_status.UNSAFE)]
            )
        else:
            status = exit_status.most_severe([self.refused, *statuses])
        seconds = asyncio.get_running_loop().time() - started
        ended = dict(zip(self.addresses, statuses, strict=True))
        self.print(summary(self.killed_first(ended), status, seconds, self.read_results()))
        return status

    def killed_first(self, statuses: Mapping[str, int]) -> dict[str, int]:
        """The exit statuses, first those of killed hosts: they are the cause of the others."""
        return {host: statuses[host] for host in [*self.killed, *statuses]}

    def read_results(self) -> dict[str, RunResult]:
        """The results of all hosts."""
        read = {host: read_result(pipe) for host, pipe in self.results.items()}
        return read | {host: replace(read[host], reason=reason) for host, reason in self.killed.items()}

    async def start(self, host: str) -> list[asyncio.Task[None]]:
        """Start the process of a host; returns the tasks that forward its output."""
        listening = self.reserved[host][0]
        (out, stdout), (err, stderr) = await self.pipe(), await self.pipe()
        result, written = os.pipe()
        self.results[host] = result
        child = await asyncio.create_subprocess_exec(
            *self.command(host, listening.fileno(), self.keys[host]),
            f"--result-fd={written}",
            stdin=PIPE,
            stdout=stdout,
            stderr=stderr,
            # The lock marks the run as alive until its last host has exited.
            pass_fds=[listening.fileno(), self.keys[host], self.control_sockets.lock, written],
            # A Ctrl-C of the terminal goes to this process only; it stops the hosts in order.
            start_new_session=True,
        )
        listening.close()
        for descriptor in (self.keys[host], stdout, stderr, written):
            os.close(descriptor)
        self.children[host] = child
        return [
            asyncio.create_task(self.pass_on(host, out, sys.stdout)),
            asyncio.create_task(self.pass_on(host, err, sys.stderr)),
        ]

    async def pipe(self) -> tuple[asyncio.StreamReader, int]:
        """A reader, and the descriptor that a child writes to.

        Not the pipes of asyncio: a child would count as running while its guard holds them open.
        """
        reading, writing = os.pipe()
        reader = asyncio.StreamReader(MAX_LINE)
        connected = asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(reading, "rb", 0)
        )
        self.pipes.append((await connected)[0])
        return reader, writing

    def command(self, host: str, listening: int, keys: int) -> list[str]:
        args = self.args
        command = [sys.executable, "-P", "-m", "lfield", "up", str(self.file), f"--host={host}"]
        # As one argument each: a value that begins with a dash would be taken for an option.
        command += ["--parent-pipe", "--listen-fd", str(listening), "--keys-fd", str(keys)]
        command += ["--engine", args.engine] if args.engine else []
        command.append(f"--control-socket={self.control_sockets.addresses[host]}")
        # For all hosts: the first with a device that is not set up stops the others.
        command.append(f"--setup={setup_command(mission_path(args), devices=args.devices)}")
        for name, address in self.addresses.items():
            command.append(f"--map={name}={address}")
        for option in ("dump", "unreachable_after", "state"):
            if getattr(args, option) is not None:
                command += [f"--{option.replace('_', '-')}", str(getattr(args, option))]
        command += [f"--{option}" for option in ("sim", "volatile", "json") if getattr(args, option)]
        command += passed_on(args)
        if args.until_done:
            command += ["--until-done", "--lost-after", str(min(args.lost_after, DEFAULT_LOST_AFTER))]
        return command

    async def pass_on(self, host: str, source: asyncio.StreamReader, target: TextIO) -> None:
        """Forward the lines of a host, each with its name in front."""
        while line := await self.line(source):
            text = line.decode(errors="replace").removesuffix("\n")
            if self.args.json and target is sys.stdout:
                text = with_host(text, host)
                target.write(text + "\n")
            elif target is sys.stderr and (report := guard_report(text, host)):
                self.on_guard_report(host, text, report)
            else:
                self.show(host, text, target)

    def on_guard_report(self, host: str, text: str, report: dict[str, Any]) -> None:
        """Forward a log line of a guard whose host has ended; record a confirmed safe state."""
        if self.args.json:
            sys.stdout.write(text + "\n")
        else:
            self.show(host, escape_line(str(report["text"])), sys.stderr)
        fields = report.get("fields")
        if report["code"] == log_messages.DEVICE_SAFE.code and isinstance(fields, dict):
            self.confirmed[host][str(fields.get("device"))] = str(report["text"])
            self.guard_reported.set()

    def note(self, host: str, line: LogLine) -> None:
        """Print a log line about a host that has ended."""
        if self.args.json:
            sys.stdout.write(json_line(SystemClock().time(), host, line))
        else:
            self.show(host, line, sys.stderr)

    def print(self, line: LogLine) -> None:
        """Print a log line about the run."""
        if self.args.json:
            sys.stdout.write(json_line(SystemClock().time(), "", line))
        else:
            print(line, file=sys.stderr)

    def show(self, host: str, text: str, target: TextIO) -> None:
        """Print a line with the name of its host in front, above the table if there is one.

        On a terminal control characters are escaped; elsewhere the line is unchanged.
        """
        line = f"{host:<{self.width}} | {text}"
        if not target.isatty():
            target.write(line + "\n")
        elif self.view:
            self.view.print(escape(line))
        else:
            target.write(escape(line) + "\n")

    async def line(self, source: asyncio.StreamReader) -> bytes:
        try:
            return await source.readline()
        except ValueError:
            # A line over the limit: print a part of it.
            return await source.read(1 << 16)

    async def wait(self, host: str) -> int:
        """The exit status of a host. One that cannot start, or lost another, stops the others."""
        status = await self.children[host].wait()
        if status:
            self.on_exit(host)
        if status < 0:
            return await self.signal_status(signal.Signals(-status), host)
        if status not in HOST_STATUSES and not self.stop_signals.first_requested.is_set():
            self.refused = self.refused or status
        if status not in HOST_STATUSES or status == exit_status.UNKNOWN_OUTCOME:
            # A host that hangs would be waited for forever.
            self.stop_event.set()
        return status

    def on_exit(self, exited: str) -> None:
        """Report the exit of a host to the others: unlike silence it is proof of its end."""
        for host, child in self.children.items():
            if host != exited and child.returncode is None and child.stdin and not child.stdin.is_closing():
                child.stdin.write(parent_pipe.exit_line(exited))

    def on_typed(self, line: str) -> None:
        """Handle a line of the operator's input: `HOST: TEXT`, or for the only host that reads."""
        name, colon, text = line.partition(":")
        host = name.strip() if colon else ""
        if host in self.children:
            line = text.removeprefix(" ")
        elif len(self.readers) == 1:
            host = self.readers[0]
        if host not in self.readers:
            self.print(log_messages.INPUT_UNADDRESSED.line(hosts=" or ".join(self.readers)))
            return
        child = self.children[host]
        if child.returncode is None and child.stdin and not child.stdin.is_closing():
            child.stdin.write(parent_pipe.typed_line(line))

    async def signal_status(self, number: signal.Signals, host: str) -> int:
        """The status of a host that a signal ended.

        The status is unsafe if the host has a device that acts: a confirmed safe state does not prove rest.
        """
        killed = log_messages.HOST_KILLED.line(host=host, signal=number.name)
        self.note(host, killed)
        devices = [device.name for device in self.mission.devices_of(host) if not device.is_sensor]
        await self.confirmation(host, devices)
        reasons: list[str] = [killed]
        for device in devices:
            if device in self.confirmed[host]:
                reasons.append(self.confirmed[host][device])
                continue
            reasons.append(line := log_messages.DEVICE_UNCONFIRMED.line(device=device, signal=number.name))
            self.note(host, line)
        self.killed[host] = "; ".join(reasons)
        return exit_status.UNSAFE if devices else exit_status.FAILED

    async def confirmation(self, host: str, devices: Sequence[str]) -> None:
        """Wait until the guards have confirmed the safe states of the devices, up to a time-out."""
        with suppress(TimeoutError):
            async with asyncio.timeout(CONFIRMATION_TIMEOUT):
                while not self.confirmed[host].keys() >= set(devices):
                    self.guard_reported.clear()
                    await self.guard_reported.wait()

    async def stop_on_signal(self) -> None:
        """Stop all hosts in order after a signal, and by force after a time-out."""
        waiting = asyncio.create_task(self.stop_signals.first_requested.wait())
        waiting.add_done_callback(lambda _: self.stop_event.set())
        await self.stop_event.wait()
        self.release()
        running = [host for host, child in self.children.items() if child.returncode is None]
        devices = [device for host in running for device in self.mission.devices_of(host)]
        seconds = longest_rest(devices) + KILL_GRACE
        await asyncio.sleep(seconds)
        for host in running:
            if self.children[host].returncode is None:
                self.note(host, log_messages.HOST_STUCK.line(host=host, seconds=seconds))
                self.children[host].kill()

    def stop_again(self) -> None:
        """Send the second stop signal to every host; the first was EOF on its supervision pipe.

        The signal is repeated, since a host that saw EOF late takes the first one for an echo.
        """
        self.terminate()
        asyncio.get_running_loop().call_later(REPEAT_WINDOW, self.terminate)

    def terminate(self) -> None:
        """Send SIGTERM to every host that runs."""
        for child in self.children.values():
            if child.returncode is None:
                child.terminate()

    def release(self) -> None:
        """Close the supervision pipes."""
        for child in self.children.values():
            assert child.stdin
            child.stdin.close()
