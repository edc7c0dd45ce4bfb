"""`lfield up --all`: every host of a mission as a process of its own, on free ports or as --map says.

All run one bundle; none of them compiles anything.

Each child inherits its listening socket, so no port is taken by somebody else in between, and holds the
other end of a pipe to this process: when it closes, the child stops in order, its devices made safe. A line
on it tells of another child that was reaped.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import socket
import sys
from asyncio.subprocess import PIPE, Process
from typing import TYPE_CHECKING, TextIO

from lfield import exits
from lfield.cli.mission_argument import mission_path, setup_command
from lfield.cli.run.own_keys import minted
from lfield.clock import SystemClock
from lfield.driver.binding import longest_rest
from lfield.host.process import leash
from lfield.host.process.stop_words import ECHO, StopWords, hear_signals
from lfield.mission.team import parse_maps
from lfield.net.local import reserve
from lfield.operator.runs import Doors, begun, running
from lfield.text.visible import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from lfield.cli.views.live import LiveView
    from lfield.mission.mission import Mission

#: A host that is silent under --all hangs: it is waited for for less long than in the field.
LOST_AFTER = 3.0
#: Where a host listens that no --map names: on a free port.
FREE = "127.0.0.1:0"
#: How long hosts may take to end, in seconds, beyond the time that their devices have to come to rest.
PATIENCE = 10.0
#: Seconds for what the hosts have said last to come through.
LAST_WORDS = 3.0
#: The longest line that is passed on whole, in bytes.
LONGEST = 1 << 20
#: The statuses of a host that has run; one with any other could not start, or has failed.
RAN = (exits.DONE, exits.FAILED, exits.UNSAFE, exits.UNHEARD)


def run_all(mission: Mission, file: Path, args: argparse.Namespace, tell: Callable[[str], None]) -> int:
    """Run every host of the mission in a bundle until all have ended: 0 if all did so normally.

    `tell` hears which commands would not find it; raises OutputFileError where none would.
    """
    mapped = parse_maps(args.map, mission.team)
    reserved = {host: reserve(mapped.get(host, FREE)) for host in mission.team.hosts}
    addresses = {host: address for host, (_, address) in reserved.items()}
    named = mission_path(args)
    with running(begun(mission.at(mission.team.at(addresses)), named, addresses), tell) as doors:
        return asyncio.run(_Team(mission, file, args, reserved, addresses, doors).run())


def summary(statuses: Mapping[str, int], status: int, seconds: float) -> str:
    """The last line of a run of so many `seconds`: mission completed, or which hosts failed and how."""
    end = f"after {seconds:.0f} s; exit status {status}"
    if status == exits.DONE:
        return f"mission completed {end}"
    failed = [host for host, each in statuses.items() if each and each == status]
    where = f" on {', '.join(failed)}" if failed else ""
    how = "stopped" if status == exits.INTERRUPTED else "failed"
    meaning = exits.MEANINGS.get(status, "a host was killed").partition(";")[0]
    return f"mission {how}{where} {end}: {meaning.removeprefix('the mission failed: ')}"


class _Team:
    def __init__(
        self,
        mission: Mission,
        file: Path,
        args: argparse.Namespace,
        reserved: dict[str, tuple[socket.socket, str]],
        addresses: dict[str, str],
        doors: Doors,
    ) -> None:
        self.mission, self.file, self.args, self.doors = mission, file, args, doors
        self.reserved, self.addresses = reserved, addresses
        self.keys = minted(addresses, mission.release)
        self.children: dict[str, Process] = {}
        self.pipes: list[asyncio.ReadTransport] = []
        self.width = max(len(host) for host in addresses)
        self.words = StopWords(SystemClock())
        #: Set when the hosts that still run are to end.
        self.ending = asyncio.Event()
        #: The exit status of the first host that could not start.
        self.refused = 0
        self.view: LiveView | None = None

    async def run(self) -> int:
        started = asyncio.get_running_loop().time()
        hear_signals(self.words)
        self.words.on_second = self.hurry
        if sys.stderr.isatty():
            from lfield.cli.views.live import LiveView

            self.view = LiveView(self.mission, self.doors.addresses)
        readers = [task for host in self.addresses for task in await self.start(host)]
        watcher = asyncio.create_task(self.watch())
        if self.view:
            self.view.start()
        statuses = await asyncio.gather(*(self.wait(host) for host in self.addresses))
        watcher.cancel()
        # A guard whose host was killed has the other end too, and stays until its vehicle is down.
        _, late = await asyncio.wait(readers, timeout=LAST_WORDS)
        for reader in late:
            reader.cancel()
        for pipe in self.pipes:
            pipe.close()
        if self.view:
            await self.view.stop()
        if self.words.first.is_set():
            status = exits.worst([exits.INTERRUPTED, *(s for s in statuses if s == exits.UNSAFE)])
        else:
            status = exits.worst([self.refused, *statuses])
        seconds = asyncio.get_running_loop().time() - started
        print(summary(dict(zip(self.addresses, statuses, strict=True)), status, seconds), file=sys.stderr)
        return status

    async def start(self, host: str) -> list[asyncio.Task[None]]:
        """Start the process of a host; returns the tasks that pass its lines on."""
        listening = self.reserved[host][0]
        (out, stdout), (err, stderr) = await self.pipe(), await self.pipe()
        child = await asyncio.create_subprocess_exec(
            *self.command(host, listening.fileno(), self.keys[host]),
            stdin=PIPE,
            stdout=stdout,
            stderr=stderr,
            # With the lock the run lives, for those who look, until its last host has ended.
            pass_fds=[listening.fileno(), self.keys[host], self.doors.lock],
            # A Ctrl-C of the terminal is for this process; it stops the hosts in order.
            start_new_session=True,
        )
        listening.close()
        os.close(self.keys[host])
        os.close(stdout)
        os.close(stderr)
        self.children[host] = child
        return [
            asyncio.create_task(self.pass_on(host, out, sys.stdout)),
            asyncio.create_task(self.pass_on(host, err, sys.stderr)),
        ]

    async def pipe(self) -> tuple[asyncio.StreamReader, int]:
        """What is read of a child, and the end that it writes to.

        Not asyncio's own: they would have to end before a child counts as ended, and a guard that outlives
        its host keeps them open.
        """
        reading, writing = os.pipe()
        reader = asyncio.StreamReader(LONGEST)
        connected = asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(reading, "rb", 0)
        )
        self.pipes.append((await connected)[0])
        return reader, writing

    def command(self, host: str, listening: int, keys: int) -> list[str]:
        args = self.args
        words = [sys.executable, "-P", "-m", "lfield", "up", str(self.file), f"--host={host}", "--leash"]
        # One word each: what begins with a dash would be taken for another option.
        words += ["--listen-fd", str(listening), "--keys-fd", str(keys)]
        words += ["--engine", args.engine] if args.engine else []
        words.append(f"--door={self.doors.addresses[host]}")
        # Of all hosts: the first with a device that is not set up ends the others before they can tell.
        words.append(f"--setup={setup_command(mission_path(args), devices=args.devices)}")
        for name, address in self.addresses.items():
            words.append(f"--map={name}={address}")
        for option in ("dump", "unreachable_after", "state"):
            if getattr(args, option) is not None:
                words += [f"--{option.replace('_', '-')}", str(getattr(args, option))]
        words += [f"--{option}" for option in ("sim", "volatile") if getattr(args, option)]
        if args.until_done:
            words += ["--until-done", "--lost-after", str(min(args.lost_after, LOST_AFTER))]
        return words

    async def pass_on(self, host: str, source: asyncio.StreamReader, target: TextIO) -> None:
        """Lines of a host, each with its name before it."""
        while line := await self.line(source):
            self.show(host, line.decode(errors="replace").removesuffix("\n"), target)

    def show(self, host: str, text: str, target: TextIO) -> None:
        """One line with its host's name before it, above the table where there is one.

        On a terminal its control characters are shown as escapes; elsewhere it goes out unchanged.
        """
        line = f"{host:<{self.width}} | {text}"
        if not target.isatty():
            target.write(line + "\n")
        elif self.view:
            self.view.print(visible(line))
        else:
            target.write(visible(line) + "\n")

    async def line(self, source: asyncio.StreamReader) -> bytes:
        try:
            return await source.readline()
        except ValueError:
            # A line over the limit: show what there is of it.
            return await source.read(1 << 16)

    async def wait(self, host: str) -> int:
        """The exit status of a host. One that cannot start, or has not heard of another, stops the others."""
        status = await self.children[host].wait()
        if status:
            self.tell(host)
        if status < 0:
            return self.ended_by(signal.Signals(-status), host)
        if status not in RAN and not self.words.first.is_set():
            self.refused = self.refused or status
        if status not in RAN or status == exits.UNHEARD:
            # It has not heard of one that may hang, and would be waited for for ever.
            self.ending.set()
        return status

    def tell(self, reaped: str) -> None:
        """The other hosts hear of one that has ended before its mission: that is proof, silence is none."""
        for host, child in self.children.items():
            if host != reaped and child.returncode is None and child.stdin and not child.stdin.is_closing():
                child.stdin.write(leash.news(reaped))

    def ended_by(self, number: signal.Signals, host: str) -> int:
        """The status of a host that a signal ended: nobody has seen what became of its devices."""
        self.show(host, f"ended by {number.name}", sys.stderr)
        devices = [device for device in self.mission.devices_of(host) if not device.is_sensor]
        for device in devices:
            told = f"{device.name}: NOT SAFE: nobody has seen its safe state '{device.safe_state}'"
            self.show(host, told, sys.stderr)
        return exits.UNSAFE if devices else exits.FAILED

    async def watch(self) -> None:
        """Stop everything in order when told to, and by force when that takes too long."""
        told = asyncio.create_task(self.words.first.wait())
        told.add_done_callback(lambda _: self.ending.set())
        await self.ending.wait()
        self.release()
        left = [host for host, child in self.children.items() if child.returncode is None]
        devices = [device for host in left for device in self.mission.devices_of(host)]
        await asyncio.sleep(longest_rest(devices) + PATIENCE)
        for host in left:
            if self.children[host].returncode is None:
                print(f"{host} does not end: killed", file=sys.stderr)
                self.children[host].kill()

    def hurry(self) -> None:
        """Say the second word to every host: the first was the end of its leash.

        A host may have heard that a little later than this process said it: said again, it is no echo.
        """
        self.terminate()
        asyncio.get_running_loop().call_later(ECHO, self.terminate)

    def terminate(self) -> None:
        """Send SIGTERM to every host that runs."""
        for child in self.children.values():
            if child.returncode is None:
                child.terminate()

    def release(self) -> None:
        """Close the pipes that the hosts hold on to."""
        for child in self.children.values():
            assert child.stdin
            child.stdin.close()
