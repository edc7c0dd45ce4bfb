"""The other end of the wire under `--sim`: the same planner, with what can be wrong with one."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Sequence

from lfield.driver import DeviceBinding
from lfield_planner.planning import answer
from lfield_planner.worker import own_output
from lfield_sim.faults import Fault, Faults, add_fault_option
from lfield_sim.serving import serve_until_told

FAULTS = (
    Fault("slow", 0.0, "seconds before it answers; 1e6 is for ever", 0.0, 1e6),
    Fault("fails", "", "the error that it ends with instead of a plan"),
    Fault("nonsense", "", "what it answers: unknown, repeated, long, or any words"),
    Fault("silent", False, "hangs up instead of an answer"),
)


def nonsense(kind: str, asked: str) -> str:
    """An answer that makes no sense to what was asked."""
    request = json.loads(asked)
    count = len(request["sites"])
    if kind == "unknown":
        return json.dumps({"tour": [count]})
    if kind == "repeated":
        return json.dumps({"tour": [0, 0]})
    if kind == "long":
        farthest = max(range(count), key=lambda site: sum(map(abs, request["sites"][site])), default=0)
        return json.dumps({"tour": [farthest, *(site for site in range(count) if site != farthest)]})
    return kind


class PlannerSim:
    """The fake for `lfield sim planner` and `lfield up --sim`."""

    name = "planner"
    help = "A planner that plans, fails, answers nonsense, or takes for ever."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Where it listens, and what is wrong with it."""
        parser.add_argument("--listen", default="tcp:127.0.0.1:0", metavar="tcp:HOST:PORT")
        parser.add_argument("--called", default="", metavar="NAME", help="the name of its binding")
        parser.add_argument("--until-stdin-closes", action="store_true", help="end with who started it")
        add_fault_option(parser)

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The fake of a binding, on a free port."""
        return ["--listen", "tcp:127.0.0.1:0", "--called", devices[0].name]

    def run(self, args: argparse.Namespace) -> int:
        """Serve until told to end."""
        sys.stdout = own_output()
        asyncio.run(self.serve(args))
        return 0

    async def serve(self, args: argparse.Namespace) -> None:
        """The same on the running loop, which may be that of a mission's test."""
        faults = Faults(FAULTS, {"1": args.called})
        faults.apply(args.fault)
        _, host, port = args.listen.split(":")
        server = await asyncio.start_server(Talk(faults).serve, host, int(port), limit=1 << 16)
        host, port = server.sockets[0].getsockname()[:2]
        endpoint = f"tcp:{host}:{port}"
        try:
            await serve_until_told(
                "planner", endpoint, "", faults,
                devices={"1": args.called}, until_stdin_closes=args.until_stdin_closes,
            )  # fmt: skip
        finally:
            server.close()


class Talk:
    """What it says to those who are linked with it."""

    def __init__(self, faults: Faults) -> None:
        self._get = faults.get

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer each line, until there is none."""
        try:
            while line := await reader.readline():
                answer = await self._told(line.decode("utf-8", "replace"))
                if self._get("silent", 1):
                    break
                writer.write(f"{answer}\n".encode())
        except (OSError, ValueError):
            pass
        finally:
            writer.close()

    async def _told(self, asked: str) -> str:
        if not json.loads(asked)["sites"]:
            return json.dumps({"tour": []})  # nothing is wrong with what costs it no thought
        if seconds := self._get("slow", 1):
            await asyncio.sleep(seconds)
        if error := self._get("fails", 1):
            return json.dumps({"error": error})
        if kind := self._get("nonsense", 1):
            return nonsense(kind, asked)
        # In a thread: the door for faults is to answer meanwhile.
        return await asyncio.get_running_loop().run_in_executor(None, answer, asked)


SIM = PlannerSim()
