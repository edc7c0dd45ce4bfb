"""`lfield recover` on real processes: the host of a coordinator is killed, and its home host continues it."""

import os
import pty
import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.process

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal stay(real seconds) { print("receives"); sleep(seconds); }
}
coordinator Tour {
    init(string[] arg) {
        findPost(arg[1]).stay(0.01);
        try {
            findPost(arg[2]).stay(1000.0);
        } catch (RestartException again) {
            print("told: " + again.message());
            findPost(arg[1]).stay(0.01);
            print("complete");
            sleep(1000.0);
        }
    }
}
"""
DEPLOYMENT = "//Post:near@alpha\n//Post:far@bravo\n//Tour:tom@alpha?near&far\n"


def answered(answer: str, *arguments: object, **options) -> int:
    """The status of a command at a terminal with this input."""
    terminal, end = pty.openpty()
    os.write(terminal, answer.encode())
    command = [sys.executable, "-m", "lfield", *map(str, arguments)]
    done = subprocess.run(command, stdin=end, capture_output=True, timeout=60, **options)
    os.close(terminal)
    os.close(end)
    return done.returncode


@pytest.mark.few(0)
def test_the_home_continues_and_the_restarted_host_does_not(lfield, own, here):
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    maps = lfield.maps(["alpha", "bravo"])
    up = ("up", "--deploy", deployment, *maps, "--first-start", "--host")
    hosts = {name: lfield.start(*up, name, env=own) for name in ("alpha", "bravo")}
    hosts["bravo"].wait_for("far: receives")
    alive = here("recover", "tom", "--yes", env=own)
    while "on its way to bravo" in alive.said:
        # The previous host does not have the confirmation of its arrival yet.
        alive = here("recover", "tom", "--yes", env=own)
    assert (alive.status, alive.out) == (69, [])
    assert "tom is alive on bravo (start 1), in a portal: nothing was done" in alive.said

    hosts["bravo"].signal(signal.SIGKILL)
    hosts["bravo"].wait()
    hosts["alpha"].wait_for("link to bravo lost")
    unasked = here("recover", "tom", deployment, *maps, env=own, status=64)
    assert "no terminal to confirm on; add --yes" in unasked.said
    assert (
        "tom, start 1: the newest copy is on alpha, as it left for bravo after 0 hops (transfer 1)"
        in unasked.out
    )
    assert any(line.startswith("  bravo does not answer; last contact ") for line in unasked.out)

    words = ("recover", "tom", deployment, *maps)
    assert answered("no\n", *words, cwd=lfield.folder, env=lfield.environment) == 1

    done = here("recover", "tom", deployment, *maps, "--yes", env=own, status=0)
    assert done.out[-1] == "alpha: tom recovered, as start 65537"
    hosts["alpha"].wait_for(
        "told: tom was recovered on alpha from its departure for bravo; this call may have b"
    )
    hosts["alpha"].wait_for("tom: complete")

    again = lfield.start(*up, "bravo", env=own)
    again.wait_for(r"tom stopped: tom was recovered \(start 65537, says alpha\), so start 1 was stopped")
    twice = here("recover", "tom", "--yes", env=own)
    assert (twice.status, "tom is alive on alpha (start 65537)" in twice.said) == (69, True)
    assert "resumed from the journal" not in again.said
