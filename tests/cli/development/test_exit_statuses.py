"""The table of exit statuses is correct: each command ends with its documented statuses and a one-sentence
message.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from lfield import errors, exit_status
from lfield.cli.main import COMMANDS

pytestmark = pytest.mark.process

TABLE = (Path(__file__).parents[3] / "lfield/docs/exit-statuses.md").read_text(encoding="utf-8")

GOOD = "resource Bell { init(string[] arg) { } portal ring() { } }\n"
DEPLOYMENT = "//Bell:bell@alpha\n"
FLIES = "resource Sky { Mavlink fc; init(string[] arg) { } }\n"

# : Command lines by command and status, with words of the message.
REACHED: dict[tuple[str, int], tuple[str, str]] = {
    ("check", 65): ("check latin.L", "latin.L:1:4: error["),
    ("check", 66): ("check none.L", "cannot read none.L"),
    ("new", 73): ("new survey --into mission.L/x", "cannot write mission.L/x"),
    ("fmt", 1): ("fmt --check loose.L", "loose.L"),
    ("fmt", 65): ("fmt latin.L", "latin.L:1:4: error["),
    ("fmt", 66): ("fmt none.L", "cannot read none.L"),
    ("build", 65): ("build latin.dL", "latin.L:1:4: error["),
    ("build", 66): ("build mission.dL --devices none.yaml", "cannot read none.yaml"),
    ("build", 73): ("build mission.dL -o none/x.lfm", "cannot write none/x.lfm"),
    ("keys", 65): ("keys list --authority none", "none has no authority"),
    ("keys", 69): ("keys show .", "not found"),
    ("keys", 73): ("keys init mission.L", "cannot write mission.L: it is not a folder"),
    ("provision", 65): ("provision --inventory latin.yaml", "latin.yaml:1:4: error["),
    ("provision", 66): ("provision --inventory none.yaml", "cannot read none.yaml"),
    ("provision", 69): ("provision --inventory away.yaml", "0 of 1 hosts done"),
    ("push", 65): ("push latin.dL --inventory team.yaml", "latin.L:1:4: error["),
    ("push", 66): ("push none.lfm --inventory team.yaml", "cannot read none.lfm"),
    ("rollback", 65): ("rollback --inventory latin.yaml", "latin.yaml:1:4: error["),
    ("rollback", 66): ("rollback --inventory none.yaml", "cannot read none.yaml"),
    ("rollback", 69): ("rollback --inventory team.yaml", "NOT REACHED"),
    ("status", 65): ("status --inventory latin.yaml", "latin.yaml:1:4: error["),
    ("status", 66): ("status --inventory none.yaml", "cannot read none.yaml"),
    ("status", 69): ("status --inventory team.yaml", "NOT REACHED"),
    ("stop", 65): ("stop --inventory latin.yaml", "latin.yaml:1:4: error["),
    ("stop", 66): ("stop --inventory none.yaml", "cannot read none.yaml"),
    ("stop", 69): ("stop --inventory team.yaml", "NOT REACHED"),
    ("service", 65): ("service --host alpha --inventory latin.yaml", "latin.yaml:1:4: error["),
    ("service", 66): ("service --host alpha --inventory none.yaml", "cannot read none.yaml"),
    ("service", 69): ("service --host alpha --inventory nowhere.yaml", "cannot use no.such.host"),
    ("service", 73): (
        "service --host alpha --inventory team.yaml --state mission.L",
        "cannot write mission.L",
    ),
    ("sign", 65): ("sign latin.lfm", "not a valid bundle"),
    ("sign", 66): ("sign none.lfm", "cannot read none.lfm"),
    ("disasm", 65): ("disasm latin.lb", "not a valid L program"),
    ("disasm", 66): ("disasm none.lb", "cannot read none.lb"),
    ("debug", 65): ("debug . -c where", "has no recording"),
    ("debug", 66): ("debug none -c where", "cannot read none"),
    ("export", 65): ("export . --csv tables", "has no recording"),
    ("export", 66): ("export none --csv tables", "cannot read none"),
    ("replay", 65): ("replay .", "has no recording"),
    ("replay", 66): ("replay none", "cannot read none"),
    ("test", 65): ("test --from .", "has no recording"),
    ("inspect", 65): ("inspect latin.block", "not a valid block"),
    ("inspect", 66): ("inspect none.block", "cannot read none.block"),
    ("up", 65): ("up mission.dL --devices latin.yaml --host alpha", "latin.yaml:1:4: error["),
    ("up", 66): ("up none.lfm --host alpha", "cannot read none.lfm"),
    ("up", 69): ("up mission.dL --host alpha --map alpha=no.such.host.invalid:1", "cannot use no.such.host"),
    ("up", 73): ("up mission.dL --all --dump mission.L", "cannot write mission.L: it is not a folder"),
    ("events", 65): ("events latin.lfm", "not a valid bundle"),
    ("events", 66): ("events none.dL", "cannot read none.dL"),
    ("events", 73): ("events mission.dL --map alpha=127.0.0.1:1 --mcap mission.L", "cannot write mission.L"),
    ("events", 69): ("events mission.dL --map alpha=127.0.0.1:1 --no-follow", "no program listens there"),
    ("logs", 65): ("logs latin.lfm", "not a valid bundle"),
    ("logs", 66): ("logs none.dL", "cannot read none.dL"),
    ("logs", 69): ("logs", "no mission is running"),
    ("watch", 65): ("watch latin.lfm", "not a valid bundle"),
    ("watch", 66): ("watch mission.dL --tiles none.mbtiles", "none.mbtiles"),
    ("ps", 65): ("ps latin.lfm", "not a valid bundle"),
    ("ps", 66): ("ps none.lfm", "cannot read none.lfm"),
    ("ps", 69): ("ps mission.dL --map alpha=127.0.0.1:1", "mission.dL is not running"),
    ("query", 1): ("query Lift mission.dL --files", "from the files"),
    ("query", 65): ("query Lift mission.dL --capabilities latin.yaml", "latin.yaml:1:4: error["),
    ("query", 66): ("query Lift mission.dL --capabilities none.yaml", "cannot read none.yaml"),
    ("query", 69): ("query Lift", "no mission is running"),
    ("mcp", 65): ("mcp --keys none", "none"),
    ("mcp", 73): ("mcp --log none/x", "cannot write none/x"),
    ("capabilities", 65): ("capabilities check latin.yaml", "latin.yaml:1:4: error["),
    ("capabilities", 66): ("capabilities check none.yaml", "cannot read none.yaml"),
    ("plan", 65): ("plan check latin.L", "latin.L: it is neither"),
    ("plan", 66): ("plan check none.plan", "cannot read none.plan"),
    ("plan", 73): ("plan show area.geojson --out none/x.svg", "cannot write none/x.svg"),
    ("inventory", 65): ("inventory show --inventory latin.yaml", "latin.yaml:1:4: error["),
    ("inventory", 66): ("inventory show --inventory none.yaml", "cannot read none.yaml"),
    ("inventory", 69): ("inventory check --inventory team.yaml --json", "127.0.0.1:1"),
    ("estop", 65): ("estop latin.dL", "latin.dL:1:4: error["),
    ("estop", 66): ("estop none.dL", "cannot read none."),
    ("estop", 69): ("estop", "no mission is running"),
    ("pause", 65): ("pause latin.dL", "latin.dL:1:4: error["),
    ("pause", 66): ("pause none.dL", "cannot read none."),
    ("pause", 69): ("pause", "no mission is running"),
    ("resume", 65): ("resume latin.dL", "latin.dL:1:4: error["),
    ("resume", 66): ("resume none.dL", "cannot read none."),
    ("resume", 69): ("resume", "no mission is running"),
    ("forget", 65): ("forget tom latin.dL", "latin.dL:1:4: error["),
    ("forget", 66): ("forget tom none.dL", "cannot read none."),
    ("forget", 69): ("forget tom", "no mission is running"),
    ("recover", 65): ("recover tom latin.dL", "latin.dL:1:4: error["),
    ("recover", 66): ("recover tom none.dL", "cannot read none."),
    ("recover", 69): ("recover tom", "no mission is running"),
    ("start", 65): ("start latin.dL", "latin.dL:1:4: error["),
    ("start", 66): ("start none.dL", "cannot read none."),
    ("start", 69): ("start", "no mission is running"),
    ("doctor", 65): ("doctor --deploy latin.lfm", "not a valid bundle"),
    ("doctor", 66): ("doctor --deploy none.lfm", "cannot read none.lfm"),
    ("doctor", 69): ("doctor --deploy sky.dL --devices sky.yaml", "cannot open"),
    ("setup", 65): ("setup --deploy latin.lfm", "not a valid bundle"),
    ("setup", 66): ("setup --deploy none.lfm", "cannot read none.lfm"),
    ("setup", 69): ("setup --deploy sky.dL --devices sky.yaml", "cannot open"),
    ("driver", 73): ("driver new lamp --into mission.L/lamp", "cannot write mission.L/lamp"),
    ("kit", 65): ("kit mavlink --devices latin.yaml", "latin.yaml:1:4: error["),
    ("kit", 66): ("kit mavlink --devices none.yaml", "cannot read none.yaml"),
    ("kit", 69): ("kit mavlink --endpoint serial:/none:57600", "none"),
    ("sim", 65): ("sim can --device dbc:latin.L", "latin.L cannot be read as a DBC file"),
    ("sim", 66): ("sim can --device dbc:none.dbc", "cannot read none.dbc"),
    ("sim", 69): ("sim mavlink --listen udp:192.0.2.1:14550", "cannot use"),
    ("sim", 73): ("sim mavlink --listen udp:127.0.0.1:0 --log none/x", "cannot write none/x"),
}
# : The test files of the other statuses.
ELSEWHERE: dict[tuple[str, int], str] = {
    ("fmt", 73): "development/test_fmt_and_new.py",
    ("lsp", 69): "../editor/test_lsp_session.py",
    ("push", 1): "fleet/test_push_and_start.py",
    ("push", 4): "fleet/test_ballot_report.py",
    ("push", 69): "fleet/test_push_and_start.py",
    ("rollback", 1): "fleet/test_ballot_report.py",
    ("rollback", 4): "fleet/test_ballot_report.py",
    ("status", 1): "fleet/test_fleet_refusals.py",
    ("stop", 1): "fleet/test_fleet_refusals.py",
    ("stop", 3): "fleet/starts/test_unsafe_stop.py",
    ("service", 1): "fleet/test_push_and_start.py",
    ("sign", 73): "development/test_keys_commands.py",
    ("debug", 69): "../replay/test_replay_commands.py",
    ("export", 69): "../replay/test_replay_commands.py",
    ("export", 73): "../replay/test_replay_commands.py",
    ("replay", 1): "../replay/test_replay_commands.py",
    ("test", 1): "../testing/test_pytest_plugin.py",
    ("test", 66): "../testing/test_pytest_plugin.py",
    ("test", 69): "../testing/test_pytest_plugin.py",
    ("up", 1): "run/test_up_life_and_death.py",
    ("up", 3): "stops",
    ("up", 4): "run/test_up_life_and_death.py",
    ("up", 76): "run",
    ("events", 1): "watch/test_events_until_done.py",
    ("events", 4): "watch/test_events_until_done.py",
    ("estop", 3): "operations",
    ("pause", 3): "operations/test_pause_command.py",
    ("recover", 1): "operations/test_recover_command.py",
    ("start", 1): "stops/test_start_command.py",
    ("watch", 69): "watch/test_watch.py",
    ("plan", 69): "device/test_plan_command.py",
    ("mcp", 69): "fleet/client/test_client_on_robots.py",
    ("setup", 1): "device/test_setup_command.py",
    ("setup", 73): "device/test_setup_command.py",
    ("kit", 1): "device/test_kit_command.py",
    ("kit", 3): "device/test_kit_command.py",
}


def documented() -> set[tuple[str, int]]:
    """Commands and statuses of the table."""
    rows = re.findall(r"^\| `(\w+)` \| ([0-9 ]+) \|", TABLE, re.MULTILINE)
    return {(name, int(status)) for name, statuses in rows for status in statuses.split()}


def test_every_command_and_status_of_the_table_is_tested() -> None:
    assert {name for name, _ in documented()} == set(COMMANDS)
    assert documented() == REACHED.keys() | ELSEWHERE.keys()
    for place in ELSEWHERE.values():
        assert (Path(__file__).parents[1] / place).exists(), place


def test_meanings_of_the_table_are_those_of_the_code() -> None:
    rows = re.findall(r"^\| (\d+) \| `(\w+)` \| (.*) \|$", TABLE, re.MULTILINE)
    assert {int(status): text for status, _, text in rows} == dict(exit_status.MEANINGS)
    assert all(getattr(exit_status, constant) == int(status) for status, constant, _ in rows)


def test_every_exception_has_a_status_of_the_table() -> None:
    kinds = [
        kind for kind in vars(errors).values() if isinstance(kind, type) and hasattr(kind, "exit_status")
    ]
    assert {kind.exit_status for kind in kinds} <= exit_status.MEANINGS.keys()


@pytest.fixture
def files(lfield):
    """Valid files, and files of every kind with a byte that is not UTF-8."""
    # A host listens only if it has keys.
    lfield.keys.give("alpha")
    lfield.mission(GOOD, DEPLOYMENT)
    lfield.mission(FLIES, "//Sky:sky@alpha\n", name="sky")
    bound = "agents: {sky: {devices: {fc: {driver: mavlink, endpoint: 'serial:/none:57600'}}}}\n"
    lfield.write("sky.yaml", bound)
    lfield.write("loose.L", GOOD.replace(" ", "  "))
    lfield.write("team.yaml", "hosts: {alpha: {addresses: ['127.0.0.1:1'], service_port: 2, ssh_port: 3}}\n")
    lfield.write("nowhere.yaml", "hosts: {alpha: {addresses: [no.such.host.invalid]}}\n")
    lfield.write("away.yaml", "hosts:\n  alpha:\n    addresses: [127.0.0.1]\n    ssh_port: 1\n")
    lfield.write("area.geojson", '{"type": "Polygon", "coordinates": [[[8, 47], [8.1, 47], [8, 47.1]]]}')
    for ending in ("L", "dL", "lb", "lfm", "yaml", "block"):
        lfield.write(f"latin.{ending}", b"abc\xe9")
    return lfield


@pytest.mark.few(30)
@pytest.mark.parametrize(("command", "status"), REACHED)
def test_a_command_ends_with_its_documented_status(files, here, command: str, status: int) -> None:
    line, words = REACHED[command, status]
    done = here(*line.split(), status=status)
    assert words in "\n".join([*done.err, *done.out])


@pytest.mark.parametrize(
    "command", ["check mission.L", "check mission.dL", "build mission.dL", "up mission.dL --all"]
)
def test_the_registry_of_a_mission_is_read_also_without_capabilities_in_its_program(
    files, here, command
) -> None:
    files.write("mission.capabilities.yaml", b"abc\xe9")
    done = here(*command.split())
    assert (done.status, done.err[0].split(" ")[0]) == (65, "mission.capabilities.yaml:1:4:")


def test_a_named_registry_is_not_skipped(files, here) -> None:
    here("build", "mission.dL", "--capabilities", "none.yaml", status=66)


@pytest.mark.few(2)
@pytest.mark.parametrize("streams", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_closed_stream_is_handled(files, streams: str) -> None:
    line = f"{sys.executable} -m lfield check mission.L none.L {streams}"
    assert subprocess.run(["bash", "-c", line], cwd=files.folder, check=False).returncode == 66


@pytest.mark.few(2)
@pytest.mark.parametrize("command", ["--help", "disasm mission.L", "driver list"])
@pytest.mark.parametrize("stream", [">&-", ">/dev/full"])
def test_output_that_cannot_be_written_is_a_failure(files, command: str, stream: str) -> None:
    line = f"{sys.executable} -m lfield {command} {stream}"
    assert subprocess.run(["bash", "-c", line], cwd=files.folder, check=False).returncode == 74


#: A program that sends SIGINT to itself while a command imports a module, or while Python ends.
INTERRUPTED = """
import atexit, os, signal, sys
def press():
    os.kill(os.getpid(), signal.SIGINT)
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "{module}":
            press()
sys.meta_path.insert(0, Finder())
if "{module}" == "the end":
    atexit.register(press)
from lfield.__main__ import main
sys.exit(main())
"""


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("module", "command"),
    [
        ("lfield.cli", "check mission.L"),
        ("argparse", "check mission.L"),
        ("lfield.cli.development.check", "check mission.L"),
        ("lfield.mission.loader", "check mission.L"),
        ("lfield.host.host", "up mission.dL --all"),
        ("lfield.cli.run.up_all", "up mission.dL --all"),
        ("the end", "check mission.L"),
    ],
)
def test_ctrl_c_at_any_moment_causes_no_traceback(files, module: str, command: str) -> None:
    done = subprocess.run(
        [sys.executable, "-S", "-c", INTERRUPTED.format(module=module), *command.split()],
        cwd=files.folder, capture_output=True, text=True, check=False,
        env={"PYTHONPATH": ":".join(sys.path)},
    )  # fmt: skip
    # A process that a signal ends has no exit status; a shell reports 130.
    assert done.returncode in (exit_status.INTERRUPTED, -signal.SIGINT)
    assert done.stderr == ""


def test_an_ignored_ctrl_c_stays_ignored(files) -> None:
    """A shell ignores SIGINT for background processes."""
    ignored = (
        f"trap '' INT; exec {sys.executable} -c '{INTERRUPTED.format(module='argparse')}' check mission.L"
    )
    done = subprocess.run(["bash", "-c", ignored], cwd=files.folder, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
