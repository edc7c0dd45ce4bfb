"""A mission bundle, from the build to its hosts, and the commands that read it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.process

EXAMPLES = Path(__file__).parents[3] / "examples"
PROGRAM = """
resource Echo {
    init(string[] arg) { while (true) yield(); }
    portal say(string text) { write(text + "\\n"); }
}
coordinator Caller {
    init(string[] arg) { findEcho(arg[1]).say("here"); }
}
"""
DEPLOYMENT = "//Caller:tom@alpha?echo\n//Echo:echo@bravo\n"
LIFTING = """
resource Crane {
    init(string[] arg) { while (true) yield(); }
    portal hoist(real height) emit real { return height; }
}
coordinator Boss { init(string[] arg) { Lift[] who = findLift("payload > 1.0"); } }
"""
CAPABILITIES = """
registry: 1
providers:
  Crane: {attributes: {payload: 50.0}, serves: {Lift: {portals: {lift: hoist, lower: hoist}}}}
"""
ARM = """
resource Arm { Dynamixel boom; init(string[] arg) { while (true) yield(); } portal here() { } }
"""
ARM_DEVICES = """silence: 2.0
agents:
  arm:
    devices:
      boom: {driver: dynamixel, endpoint: "serial:/dev/ttyNOBODY:57600", id: 1, waivers: [device_watchdog]}
"""


@pytest.fixture
def bundled(lfield, here):
    """`bundled()` builds and signs the mission of a test's folder, and removes its sources."""

    def build() -> None:
        here("build", "mission.dL", status=0)
        lfield.keys.sign(lfield.folder / "mission.lfm")
        for path in lfield.folder.glob("mission.*"):
            if path.suffix != ".lfm":
                path.unlink()

    return build


def test_hosts_run_from_a_bundle_without_sources(lfield, bundled) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    bundled()
    maps = lfield.maps(["alpha", "bravo"])
    hosts = [
        lfield.start("up", "mission.lfm", "--host", name, "--until-done", *maps)
        for name in ("alpha", "bravo")
    ]
    assert [host.wait() for host in hosts] == [0, 0]
    assert hosts[1].out == ["here"]


@pytest.mark.few(0)
def test_all_hosts_of_a_bundle_run_at_once(lfield, bundled) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    bundled()
    ran = lfield("up", "mission.lfm", "--all", "--until-done", status=0)
    assert "bravo | here" in ran.out


def test_a_build_reports_its_bundle(lfield, here) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    result = lfield("build", "mission.dL", "-o", "other.lfm", status=0)
    (line,) = result.err
    assert line.startswith("other.lfm: ")
    assert line.endswith("for alpha, bravo")
    output = here("inspect", "other.lfm")
    text = "\n".join(output.out)
    assert "host bravo at bravo:8181\n  resource echo (Echo)" in text
    assert line.split("bundle ")[1].split(",")[0] in text
    checked = here("check", "other.lfm")
    assert (checked.status, checked.err) == (0, [])
    assert "Caller" in "\n".join(here("disasm", "other.lfm").out)
    wasm = "\n".join(here("disasm", "other.lfm", "--wasm").out)
    assert wasm.startswith("(module")
    assert "i64.add" in wasm


@pytest.mark.few(0)
def test_a_running_team_is_found_by_its_bundle_and_by_its_deployment(lfield, alone) -> None:
    deployment = lfield.mission(PROGRAM, DEPLOYMENT)
    lfield("build", "mission.dL")
    team = lfield.start("up", "mission.lfm", "--all", env=alone)
    team.wait_for("bravo listening ")
    for mission in (["mission.lfm"], ["--deploy", deployment]):
        output = lfield("ps", *mission, env=alone, status=0)
        assert "echo" in "\n".join(output.out)
        stopped = lfield("estop", *mission, env=alone)
        assert (lfield.status(stopped), stopped.out) == (
            0,
            ["alpha: has no devices that move", "bravo: has no devices that move"],
        )
    team.signal(signal.SIGTERM)
    assert team.wait() == 130


def test_a_query_reads_a_bundle(lfield, here, bundled) -> None:
    lfield.mission(LIFTING, "//Crane:crane@yard\n//Boss:boss@yard\n")
    lfield.write("mission.capabilities.yaml", CAPABILITIES)
    bundled()
    result = here("query", "Lift where payload >= 20", "mission.lfm", "--files", status=0)
    assert "crane" in "\n".join(result.out)


def test_a_bundle_whose_program_names_no_capability_has_no_registry(lfield, here, bundled) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    bundled()
    result = here("query", "Lift", "mission.lfm", "--files", status=64)
    assert "the program of mission.lfm names no capability" in result.err[0]


@pytest.mark.few(0)
def test_a_robot_may_have_other_bindings(lfield, bundled) -> None:
    lfield.mission(ARM, "//Arm:arm@here\n", ARM_DEVICES)
    bundled()
    lfield.write("robot.yaml", ARM_DEVICES.replace("NOBODY", "OTHER"))
    maps = lfield.maps(["here"])
    for options, port in (([], "ttyNOBODY"), (["--devices", "robot.yaml"], "ttyOTHER")):
        ran = lfield("up", "mission.lfm", "--host", "here", *maps, *options, status=69)
        assert port in "\n".join(ran.err)
    simulated = lfield.start("up", "mission.lfm", "--host", "here", *maps, "--sim")
    simulated.wait_for("here listening ")


def test_a_deployment_is_listed_and_explained_like_its_bundle(lfield, here) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    here("build", "mission.dL", status=0)
    for command in ("disasm", "inspect"):
        of_bundle, of_deployment = here(command, "mission.lfm"), here(command, "mission.dL")
        assert (of_bundle.status, of_deployment.status) == (0, 0)
        # Only a bundle has a signer.
        assert [line for line in of_bundle.out if not line.startswith("signed ")] == of_deployment.out


def test_a_program_is_refused_as_mission(lfield, here) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    refused = here("up", "mission.L", "--all", status=64)
    assert refused.err == ["lfield: mission.L is a program: name its deployment, mission.dL"]


def test_an_unbound_device_is_refused_in_a_build(lfield, here) -> None:
    lfield.mission(ARM, "//Arm:arm@here\n")
    result = here("build", "mission.dL", status=65)
    assert "arm.boom (Dynamixel) is not bound" in result.err[0]
    assert not (lfield.folder / "mission.lfm").exists()
    here("build", "mission.dL", "--sim", status=0)


def test_files_of_devices_are_copied_beside_the_bundle(lfield, here) -> None:
    program = "resource Car { Mavlink fc; init(string[] arg) { while (true) yield(); } portal here() { } }"
    devices = """
agents:
  car:
    devices:
      fc: {driver: mavlink, endpoint: "tcp:127.0.0.1:1", signing_key: keys/secret, waivers: [device_watchdog]}
"""
    lfield.mission(program, "//Car:car@here\n", devices)
    lfield.write("keys/secret", "00" * 32)
    result = here("build", "mission.dL", "-o", "sent/mission.lfm")
    assert result.status == 73, "there is no such folder"
    (lfield.folder / "sent").mkdir()
    result = here("build", "mission.dL", "-o", "sent/mission.lfm")
    assert result.err[-1] == "copy to the same folder: keys/secret"
    assert ("00" * 32).encode() not in (lfield.folder / "sent" / "mission.lfm").read_bytes()


@pytest.mark.few(0)
def test_a_driver_different_from_that_of_the_build_is_refused(lfield) -> None:
    """The manifest of the build has one more limit than that of the robot."""
    lfield.mission(ARM, "//Arm:arm@here\n", ARM_DEVICES)
    code = (
        "from pathlib import Path; from dataclasses import replace; from lfield.mission import bundle;"
        "from lfield.mission.loader import load_mission; from lfield.driver.driver_index import *;"
        "m = load_mission(Path('mission.dL')); d = m.drivers.by_driver['dynamixel'];"
        "files = {t: ManifestFile(f.name, bytes(32)) for t, f in d.files.items()};"
        "m = replace(m, drivers=DriverIndex({'dynamixel': replace(d.without_local_parts, files=files)}));"
        "Path('mission.lfm').write_bytes(bundle.encode(m))"
    )
    subprocess.run([sys.executable, "-c", code], cwd=lfield.folder, check=True, timeout=60)
    lfield.keys.sign(lfield.folder / "mission.lfm")
    ran = lfield("up", "mission.lfm", "--host", "here", *lfield.maps(["here"]), status=69)
    text = "\n".join(ran.err)
    assert "the installed driver 'dynamixel' is not the one that the mission was built with" in text
    assert "install lfield 0" in text


@pytest.mark.parametrize(
    ("command", "status", "words"),
    [
        (["up", "mission.lfm", "--program", "mission.L"], 64, "--program is for a deployment"),
        (["up", "mission.lfm", "--deploy", "mission.dL"], 64, "not allowed with argument"),
        (["build", "mission.lfm"], 64, "give it other bindings with --devices, or a name with -o"),
        (["build", "mission.lfm", "--program", "mission.L"], 64, "which has its program"),
        (["build", "mission.L", "--sim"], 64, "build the bundle of a deployment"),
        (["up", "nobody.lfm"], 66, "cannot read nobody.lfm"),
        (["up", "cut.lfm", "--all"], 65, "cut.lfm is not a valid bundle: it is damaged or truncated"),
        (["ps", "cut.lfm"], 65, "is not a valid bundle"),
        (["check", "cut.lfm"], 65, "is not a valid bundle"),
        (["disasm", "cut.lfm"], 65, "is not a valid bundle"),
        (["inspect", "cut.lfm"], 65, "is not a valid bundle"),
        (["up", "newer.lfm"], 65, "it has format 9, this lfield reads format 3"),
        (["up", "mission.lfm"], 64, "name one with --host, or run all of them here with --all"),
    ],
)
def test_an_invalid_bundle_or_command_line_is_refused(lfield, here, command, status, words) -> None:
    lfield.mission(PROGRAM, DEPLOYMENT)
    here("build", "mission.dL")
    data = (lfield.folder / "mission.lfm").read_bytes()
    lfield.write("cut.lfm", data[:99])
    lfield.write("newer.lfm", data[:4] + b"\x09" + data[5:])
    result = here(*command, status=status)
    assert words in "\n".join(result.err)


#: A program that runs a command and prints the modules of the host's process when it is up.
SHOWING = """
import sys
from lfield.cli.main import main
from lfield.host.logbook import Logbook
from lfield.text.log_messages import DEVICE_REPORT

note = Logbook.note

def told(self, text, **more):
    note(self, text, **more)
    if " listening " in text:
        note(self, DEVICE_REPORT.line(device="loaded", text=" ".join(sorted(sys.modules))))

Logbook.note = told
sys.exit(main(sys.argv[1:]))
"""
NOT_ON_ROBOTS = (
    "yaml",
    "lfield.lang",
    "lfield.compiler",
    "lfield.text.yaml_source",
    "lfield.capability.registry_reader",
)
NOT_ON_ROBOTS += ("lfield.capability.condition_parser", "lfield.capability.condition_compiler")
NOT_ON_ROBOTS += ("lfield.capability.program_types", "lfield.mission.loader", "rich")


@pytest.mark.few(0)
@pytest.mark.parametrize("example", ["01-first-flight", "02-equivalent-lift", "10-client-server"])
def test_neither_a_host_nor_its_guards_load_the_compiler_or_yaml(lfield, example) -> None:
    """Python lists every import of every process, also of fakes, which do not run on robots."""
    deployment = EXAMPLES / example / "mission.dL"
    lfield("build", deployment, "--sim", "-o", "mission.lfm", status=0)
    lfield.keys.sign(lfield.folder / "mission.lfm")
    host = deployment.read_text().partition("@")[2].split()[0].partition("?")[0].partition(":")[0]
    command = [sys.executable, "-c", SHOWING, "up", "mission.lfm", "--host", host, "--sim"]
    keys = {"XDG_CONFIG_HOME": f"{lfield.folder}/config"}
    environment = {**lfield.environment, **keys, "PYTHONPROFILEIMPORTTIME": "1"}
    with subprocess.Popen(
        [*command, "--map", lfield.maps([host])[1]],
        cwd=lfield.folder, env=environment, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL, text=True, start_new_session=True,
    ) as running:  # fmt: skip
        assert running.stderr is not None
        lines = []
        for line in running.stderr:
            lines.append(line)
            if line.startswith("loaded: "):
                break
        os.kill(running.pid, signal.SIGTERM)
        running.communicate(timeout=60)
    imported = {line.rpartition("|")[2].strip() for line in lines if line.startswith("import time:")}
    loaded = lines[-1].split()[1:]
    assert "lfield.host.host" in loaded, "".join(lines[-20:])
    for names in (imported, loaded):
        assert not [name for name in names for no in NOT_ON_ROBOTS if name == no or name.startswith(f"{no}.")]


def test_a_bundle_and_a_deployment_are_shown_as_json(lfield, here) -> None:
    deployment = EXAMPLES / "01-first-flight" / "mission.dL"
    here("build", deployment, "--sim", "-o", "mission.lfm", status=0)
    bundle, unbuilt = (
        json.loads("\n".join(here("inspect", file, "--json").out)) for file in ("mission.lfm", deployment)
    )
    assert (bundle["kind"], bundle["signed"]) == ("bundle", "no")
    assert (unbuilt["kind"], unbuilt["signed"]) == ("deployment", None)
    assert sum(part["bytes"] for part in bundle["parts"]) > 1000
    hosts = {host["name"]: [agent["id"] for agent in host["agents"]] for host in bundle["hosts"]}
    assert hosts == {"alpha": ["lead", "pilot"], "bravo": ["wing"]}
    (device,) = bundle["hosts"][1]["agents"][0]["devices"]
    assert (device["field"], device["type"], device["driver"]) == ("fc", "Mavlink", "mavlink")
