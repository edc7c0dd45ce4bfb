"""What the documents show and their test does not run, line by line with the reason; and what pages start from.

A line that no page has any more must go from here too: the test says so.
"""

from __future__ import annotations

#: Reasons that several lines have.
HARDWARE = "hardware: a port or a bus of the robot"
INSTALLS = "installs software on the system"
SERVICE = "needs systemd, and a robot that is set up"
LONG = "runs for minutes: "
RUNNING = "about a mission that runs: "
EXAMPLES = LONG + "tests/cli/run/test_thesis_and_examples.py runs it"
DRIVER = "a driver of its own: tests/driver/test_driver_bench.py makes it and runs its tests"
KIT = "serves on a fixed port: tests/kits runs every kit against every fake"

#: By page: command lines, and first lines of outputs.
EXCEPTIONS: dict[str, dict[str, str]] = {}

#: By page: files of the repository that it speaks of by other names. A folder is a mission.
FILES: dict[str, dict[str, str]] = {
    "lfield/docs/operations.md": {
        "mission.L": "examples/02-equivalent-lift/mission.L",
        "mission.dL": "examples/02-equivalent-lift/mission.dL",
        "mission.capabilities.yaml": "examples/02-equivalent-lift/mission.capabilities.yaml",
    },
    "drivers/lfield_can/README.md": {"gripper.dbc": "sim-adapters/lfield_sim/can/gripper.dbc"},
    "drivers/lfield_mavlink/README.md": {"keys/alpha.key": "LICENSE"},
}
