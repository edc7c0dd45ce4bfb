"""Duration of the whole command `lfield query`: from files only, and with two running hosts."""

from __future__ import annotations

from harness.checkout import Checkout, Mission
from harness.figure import Figure, Opener
from harness.paced import Round, whole_run
from harness.processes import Processes
from harness.samples import Contender

_PROGRAM = """
resource Hoist {
    init(string[] arg) { while (true) yield(); }
    portal lift(real height) emit real { return height; }
    portal lower(real height) emit real { return height; }
    portal ready() { write("ready\\n"); }
}
coordinator Boss {
    init(string[] arg) {
        findHoist("arm2").lift(1.0);
        findHoist("arm1").ready();
    }
}
"""
_AGENTS = "//Hoist:arm1@alpha", "//Hoist:arm2@bravo", "//Boss:boss@alpha"
_CAPABILITIES = """
registry: 1
providers: {Hoist: {attributes: {payload: 20.0}, serves: {Lift: {}}}}
agents: {arm2: {payload: 1.2}}
"""
_QUERY = "Lift where payload >= 2.0"


def asking(*arguments: str, running: bool) -> Opener:
    """Run the command with these options."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        mission = Mission(processes.folder(), _PROGRAM, _AGENTS)
        mission.deploy.with_suffix(".capabilities.yaml").write_text(_CAPABILITIES, encoding="utf-8")
        if running:
            mission.up(checkout, processes)[0].line()

        def ask() -> Round:
            with Processes() as own:
                return whole_run(
                    checkout.lfield(own, "query", _QUERY, *mission.arguments, *arguments), "Lift"
                )

        return ask

    return opener


FIGURE = Figure(
    "lfield query: a command from its start to its end",
    {"from the files": asking("--files", running=False), "of two hosts": asking(running=True)},
    rounds=9,
    one_size="two hosts; `growth` has agents by number",
    between=("from the files", "of two hosts"),
)
