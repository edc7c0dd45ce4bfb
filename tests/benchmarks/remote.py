"""A remote portal call: hop there, run the portal, go on. Compared with a remote method call.

Two hosts run as real processes on loopback TCP. A coordinator calls a portal of the resource on the other
host, in turns: after the call it IS there, so the next call leads back. One call is one hop: the block goes
over once and nothing comes back but a confirmation that nobody waits for. With an RPC library the caller
stays, so one call is a request and a reply with the same bytes in both.

L measures itself: `now()` before and after the call, on two hosts that share this machine's clock. Each
difference is left with the resource at once by a local call that is not timed, so the samples do not
travel. The live state is an int array of the given size, on top of the coordinator itself.

Between its turns the mission sleeps and both hosts are stopped (SIGSTOP), as idle as the servers it is
compared with.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from contenders import CLIENTS, Echo
from harness import Child, Children, Figure, Row, free_port, median, microseconds, percentile, size, times

SIZES = (64, 1 << 10, 8 << 10, 64 << 10)
ROUNDS, CALLS, WARM_UP = 8, 300, 20
LIBRARIES = ("Pyro5", "RPyC", "gRPC")

_MISSION = """
resource Post {
    real[] kept;
    int count;

    init(string[] arg) { kept = new real[s2i(arg[1])]; }

    portal visit() { }

    portal keep(real seconds) {
        kept[count] = seconds;
        count = count + 1;
    }

    portal give() emit real[] {
        count = 0;
        return kept;
    }

    portal report(int bytes, real[] seconds) {
        write(i2s(bytes));
        for (int i = 0; i < seconds.length(); i = i + 1) write(" " + f2s(seconds[i]));
        write("\\n");
    }

    portal end() { write("end of round\\n"); }
}

coordinator Traveller {
    Post near;
    Post far;
    int[] load;

    init(string[] arg) {
        near = findPost("near");
        far = findPost("far");
        int calls = s2i(arg[1]);
        int warmUp = s2i(arg[2]);
        int[] sizes = new int[arg.length() - 3];
        for (int i = 0; i < sizes.length(); i = i + 1) sizes[i] = s2i(arg[i + 3]);
        while (true) {
            for (int i = 0; i < sizes.length(); i = i + 1) measure(sizes[i], calls, warmUp);
            near.end();
            sleep(0.2);     // long enough to be stopped in
        }
    }

    private void measure(int bytes, int calls, int warmUp) {
        load = new int[bytes / 8];
        near.visit();
        for (int i = 0; i < warmUp; i = i + 2) {
            far.visit();
            near.visit();
        }
        for (int i = 0; i < calls; i = i + 2) {
            real start = now();
            far.visit();
            far.keep(now() - start);
            start = now();
            near.visit();
            near.keep(now() - start);
        }
        near.report(bytes, near.give());
        near.report(bytes, far.give());
    }
}
"""


def figure() -> Figure:
    """The table of all sizes."""
    samples = measure()
    rows: list[Row] = []
    for count in SIZES:
        medians = {name: median(of_sizes[count]) for name, of_sizes in samples.items()}
        fastest = min(medians[name] for name in LIBRARIES)
        for name, of_sizes in samples.items():
            rows.append(
                Row(
                    size(count) if name == "lfield" else "",
                    "lfield: remote portal call" if name == "lfield" else _NAMES[name],
                    microseconds(medians[name]),
                    microseconds(percentile(of_sizes[count], 99)),
                    times(medians[name] / fastest),
                    "1.00x" if name == "lfield" else "",
                )
            )
    return Figure(
        "Remote portal call by live state; ratio to the fastest RPC library",
        rows,
        (f"{ROUNDS} rounds of {CALLS} calls; a portal call is one hop, a method call goes and returns",),
    )


_NAMES = {
    "TCP one way": "TCP, one way (half an echo)",
    "TCP": "TCP, echo",
    "Pyro5": "Pyro5, method call",
    "RPyC": "RPyC, method call",
    "gRPC": "gRPC, method call",
}


def measure() -> dict[str, dict[int, list[float]]]:
    """Seconds of each call by contender and size, all measured in turns."""
    samples: dict[str, dict[int, list[float]]] = {
        name: {count: [] for count in SIZES} for name in ("lfield", *_NAMES)
    }
    with Children() as children, tempfile.TemporaryDirectory() as folder:
        near, far = _start_mission(children, Path(folder))
        servers = {name: children.start(sys.executable, _CONTENDERS, name) for name in CLIENTS}
        with _stopped_at_end_of_round(near, far, samples["lfield"]):
            echoes = {name: CLIENTS[name](int(server.line())) for name, server in servers.items()}
        # The first round warms the mission up and was thrown away with its samples.
        for kept in samples["lfield"].values():
            kept.clear()
        for _ in range(ROUNDS):
            near.go_on()
            far.go_on()
            with _stopped_at_end_of_round(near, far, samples["lfield"]):
                for name, echo in echoes.items():
                    for count in SIZES:
                        samples[name][count] += _calls(echo, count)
    for count in SIZES:
        samples["TCP one way"][count] = [seconds / 2 for seconds in samples["TCP"][count]]
    return samples


_CONTENDERS = str(Path(__file__).with_name("contenders.py"))


def _start_mission(children: Children, folder: Path) -> tuple[Child, Child]:
    """The two hosts, up and running."""
    deploy = folder / "travel.dL"
    (folder / "travel.L").write_text(_MISSION, encoding="utf-8")
    words = "&".join(str(word) for word in (CALLS, WARM_UP, *SIZES))
    half = CALLS // 2
    deploy.write_text(
        f"//Post:near@a?{half}\n//Post:far@b?{half}\n//Traveller:traveller@a?{words}\n", encoding="utf-8"
    )
    maps = [word for host in ("a", "b") for word in ("--map", f"{host}=127.0.0.1:{free_port()}")]
    command = (sys.executable, "-m", "lfield", "up", "--deploy", str(deploy), *maps)
    return children.start(*command, "--host", "a"), children.start(*command, "--host", "b")


@contextmanager
def _stopped_at_end_of_round(near: Child, far: Child, kept: dict[int, list[float]]) -> Iterator[None]:
    """Read a round of the mission, then hold its hosts for as long as the others are measured."""
    while (line := near.line()) != "end of round":
        count, *seconds = line.split()
        kept[int(count)] += [float(word) for word in seconds]
    near.pause()
    far.pause()
    yield


def _calls(echo: Echo, count: int) -> list[float]:
    """Seconds of each of CALLS echoes of so many bytes, after a warm-up."""
    data, taken = bytes(count), []
    for _ in range(WARM_UP):
        echo(data)
    for _ in range(CALLS):
        start = time.perf_counter()
        echo(data)
        taken.append(time.perf_counter() - start)
    return taken
