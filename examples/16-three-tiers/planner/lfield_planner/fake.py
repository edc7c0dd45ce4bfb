"""The simulated planner for `--sim`: the same planner, with fault injection."""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Sequence

from lfield.driver import DeviceBinding
from lfield_planner.planning import answer
from lfield_planner.worker import own_output
from lfield_sim.fake_server import serve_until_stopped
from lfield_sim.faults import Fault, Faults, add_fault_option

FAULTS = (
    Fault("slow", 0.0, "seconds before it answers; 1e6 means never", 0.0, 1e6),
    Fault("fails", "", "the error that it returns instead of a plan"),
    Fault("nonsense", "", "its answer: unknown, repeated, long, or any text"),
    Fault("silent", False, "closes the connection instead of answering"),
)


def invalid_answer(kind: str, line: str) -> str:
    """An invalid answer to a request line; `kind` is a value of the fault `nonsense`."""
    request = json.loads(line)
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
    """The simulated device for `lfield sim planner` and `lfield up --sim`."""

    name = "planner"
    help = "A planner that plans, fails, answers nonsense, or never answers."

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Adds the endpoint and the faults."""
        parser.add_argument("--listen", default="tcp:127.0.0.1:0", metavar="tcp:HOST:PORT")
        parser.add_argument("--called", default="", metavar="NAME", help="the name of its binding")
        parser.add_argument("--until-stdin-closes", action="store_true", help="end with who started it")
        add_fault_option(parser)

    def arguments(self, devices: Sequence[DeviceBinding]) -> list[str]:
        """The command line of the simulated device of a binding, on a free port."""
        return ["--listen", "tcp:127.0.0.1:0", "--called", devices[0].name]

    def run(self, args: argparse.Namespace) -> int:
        """Serves until it is stopped."""
        sys.stdout = own_output()
        asyncio.run(self.serve(args))
        return 0

    async def serve(self, args: argparse.Namespace) -> None:
        """Serves in the running event loop, for example of a test with virtual time."""
        faults = Faults(FAULTS, {"1": args.called})
        faults.apply(args.fault)
        _, host, port = args.listen.split(":")
        server = await asyncio.start_server(PlannerServer(faults).serve, host, int(port), limit=1 << 16)
        host, port = server.sockets[0].getsockname()[:2]
        endpoint = f"tcp:{host}:{port}"
        try:
            await serve_until_stopped(
                "planner", endpoint, "", faults,
                devices={"1": args.called}, until_stdin_closes=args.until_stdin_closes,
            )  # fmt: skip
        finally:
            server.close()


class PlannerServer:
    """Answers requests on connections, with the faults."""

    def __init__(self, faults: Faults) -> None:
        self._get = faults.get

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answers each line until the connection ends."""
        try:
            while line := await reader.readline():
                answer = await self._answer(line.decode("utf-8", "replace"))
                if self._get("silent", 1):
                    break
                writer.write(f"{answer}\n".encode())
        except (OSError, ValueError):
            pass
        finally:
            writer.close()

    async def _answer(self, line: str) -> str:
        if not json.loads(line)["sites"]:
            return json.dumps({"tour": []})  # the request of `PlannerDevice._open` never fails
        if seconds := self._get("slow", 1):
            await asyncio.sleep(seconds)
        if error := self._get("fails", 1):
            return json.dumps({"error": error})
        if kind := self._get("nonsense", 1):
            return invalid_answer(kind, line)
        # In a thread, because the event loop also serves the fault-injection socket.
        return await asyncio.get_running_loop().run_in_executor(None, answer, line)


SIM = PlannerSim()
