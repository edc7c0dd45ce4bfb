"""Invalid files and command lines: a sentence and a status of sysexits, never a traceback."""

from __future__ import annotations

import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from lfield.net.tls import TlsIdentity
from lfield.testing.keyring import Keyring

pytestmark = pytest.mark.process

GOOD = """
resource Bell {
    init(string[] arg) { }
    portal ring() { write("ring\\n"); }
}
coordinator Ringer {
    init(string[] arg) { findBell(arg[1]).ring(); }
}
"""
DEPLOYMENT = "//Bell:bell@alpha\n//Ringer:tom@alpha?bell\n"
GARBAGE = bytes(range(256)) * 20


@pytest.fixture
def good(lfield):
    return lfield.mission(GOOD, DEPLOYMENT)


@pytest.fixture
def refused(here):
    """`refused(status, words, *command)`: the refusal of a command line."""

    def check(status: int, words: str, *command) -> None:
        result = here(*command)
        assert words in "\n".join(result.err)
        assert (result.status, result.out) == (status, []), result.err

    return check


# usage


@pytest.mark.few(8)
@pytest.mark.parametrize(
    ("command", "words"),
    [
        ([], "the following arguments are required: COMMAND"),
        (["fly"], "invalid choice: 'fly' (see"),
        (["chek"], "invalid choice: 'chek': did you mean 'check'?"),
        (["run"], "invalid choice: 'run': did you mean 'up'?"),
        (["check", "mission.L", "--jsn"], "--jsn: did you mean '--json'? (see 'lfield check --help')"),
        (["keys", "list", "--dir", "x"], "unrecognized arguments: --dir x (see 'lfield keys list --help')"),
        (["up"], "one of the arguments MISSION --deploy is required"),
        (["ps", "--deploy", "mission.dL", "--deploy", "b.dL"], "--deploy is given twice"),
        (["up", "--deploy", "mission.dL", "--wings"], "unrecognized arguments: --wings"),
        (["up", "--deploy", "mission.dL", "--all", "--host", "alpha"], "not allowed with argument"),
        (["up", "--deploy", "mission.dL", "--lost-after", "soon"], "--lost-after"),
        (["up", "--deploy", "mission.dL", "--unreachable-after", "-1"], "a number of seconds above 0"),
        (["up", "--deploy", "mission.dL", "--lasts", "400d"], "and at most 3153600000, not '400d'"),
        (["up", "--deploy", "mission.dL", "--lasts", "1e10"], "and at most 3153600000, not '1e10'"),
        (["up", "--deploy", "mission.dL", "--map", "alpha"], "write it as NAME=ADDR:PORT"),
        (["up", "--deploy", "mission.dL", "--map", "alpha=localhost:0"], "write it as NAME=ADDR:PORT"),
        (["ps", "--deploy", "mission.dL", "--map", "alhpa=localhost:1"], "did you mean 'alpha'"),
        (["up", "--deploy", "mission.dL", "--host", "alhpa"], "did you mean 'alpha'"),
        (["up", "--deploy", "mission.dL"], "name one with --host, or run all of them here with --all"),
        (["sim"], "no simulated device given; installed: can, dynamixel, mavlink"),
        (["sim", "mavlink", "--listen", "pigeon:1"], "write udp:HOST:PORT"),
        (["check"], "required: FILE"),
    ],
)
def test_an_invalid_command_line_is_refused(lfield, refused, good, command, words):
    refused(64, words, *command)


def test_help_and_version_succeed(lfield):
    output = lfield("--help", status=0)
    assert "130  interrupted" in "\n".join(output.out)
    assert lfield("--version").out[0].startswith("lfield ")
    assert "--until-done" in "\n".join(lfield("up", "--help").out)


@pytest.mark.parametrize("command", ["up", "ps", "estop"])
def test_help_describes_the_mission_before_its_alternative(here, command):
    text = "\n".join(here(command, "--help").out)
    assert -1 < text.index("(.dL) or bundle (.lfm)") < text.index("another way to give MISSION")


# files


COMMANDS = [
    "check {path}.L",
    "check {path}.dL",
    "build {path}.L -o out.lb",
    "disasm {path}.L",
    "disasm {path}.lb",
    "inspect {path}.block",
    "up --deploy {path}.dL --program mission.L --host alpha",
    "up --deploy mission.dL --host alpha --program {path}.L",
    "up --deploy mission.dL --host alpha --program {path}.lb",
    "up --deploy mission.dL --host alpha --devices {path}.yaml",
    "ps --deploy {path}.dL",
]


@pytest.mark.few(3)
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("name", "status"),
    [("missing", 66), ("folder", 66), ("garbage", 65), ("loop", 66)],
)
def test_an_invalid_file_is_refused_with_its_status(lfield, refused, good, command, name, status):
    for ending in ("L", "dL", "lb", "block", "yaml"):
        path = lfield.folder / f"{name}.{ending}"
        if name == "folder":
            path.mkdir()
        elif name == "loop":
            # A file that no user can open, not even root.
            path.symlink_to(path.name)
        elif name == "garbage":
            path.write_bytes(GARBAGE)
    refused(status, f"{name}.", *command.format(path=name).split())
    assert not (lfield.folder / "out.lb").exists()


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("command", "why"),
    [
        *((command, "is a directory") for command in ("check", "build", "disasm", "up --all")),
        ("inspect", "the folder has no host.journal"),
        ("setup --deploy", "is a directory"),
        ("doctor --deploy", "is a directory"),
    ],
)
def test_a_directory_in_place_of_a_mission_is_refused(here, command, why):
    for name in (".", "/"):
        done = here(*command.split(), name, status=66)
        assert f"lfield: cannot read {name}: {why}" in "\n".join(done.err)


@pytest.mark.parametrize("command", ["check", "build", "up --all"])
def test_a_file_with_the_suffix_of_no_mission_file_is_refused(lfield, refused, command):
    # A deployment in a program file would be valid: its lines are comments there.
    (lfield.folder / "mission.dl").write_text("//Copter:lead@alpha\n")
    refused(64, "mission.dl is neither a ", *command.split(), "mission.dl")


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (["check", ""], "an argument"),
        (["build", "mission.dL", "-o", ""], "the value of -o"),
        (["up", "mission.dL", "--all", "--dump", ""], "the value of --dump"),
        (["up", "mission.dL", "--all", "--devices="], "the value of --devices"),
        (["setup", "mavlink", "--state", ""], "the value of --state"),
        (["driver", "new", "lamp", "--into", ""], "the value of --into"),
        (["ps", "--run", ""], "the value of --run"),
        (["query", "--explain", ""], "an argument"),
        (["driver", "new", "--sensor", ""], "an argument"),
        (["sim", "mavlink", "--log", ""], "the value of --log"),
    ],
)
def test_an_empty_argument_is_refused(lfield, refused, good, command, what):
    refused(64, f"lfield: {what} is empty; is a shell variable not set?", *command)


def test_an_emergency_stop_needs_no_reason(refused, here):
    here("estop", "--reason", "", status=69)


def test_a_file_that_is_not_a_mission_is_reported_by_its_own_name(refused):
    refused(65, "cannot read /dev/null: neither a deployment", "setup", "--deploy", "/dev/null")
    refused(66, "cannot read none.dL: no such file", "up", "none.dL", "--all")


def test_an_endless_file_in_place_of_a_program_is_refused(lfield, refused, good):
    refused(65, "not a valid L program", "disasm", "/dev/zero")


@pytest.mark.parametrize("command", ["check zero.L", "check zero.dL"])
def test_an_endless_file_is_not_read_to_its_end(lfield, refused, good, command):
    for name in ("zero.L", "zero.dL"):
        (lfield.folder / name).symlink_to("/dev/zero")
    refused(66, "file too large", *command.split())


@pytest.mark.few(2)
@pytest.mark.parametrize(("program", "cut"), [("whole", 0), ("cut", 1), ("cut", 100), ("flipped", 0)])
def test_a_damaged_program_file_is_refused(lfield, here, refused, good, program, cut):
    here("build", "mission.L", status=0)
    path = lfield.folder / "mission.lb"
    data = bytearray(path.read_bytes())
    if program == "whole":
        output = here("disasm", path, status=0)
        assert any("Ringer" in line for line in output.out)
        here("check", path, status=0)
        return
    if program == "flipped":
        data[len(data) // 2] ^= 0x40
    path.write_bytes(data[: len(data) - cut])
    refused(65, "mission.lb", "up", "--deploy", good, "--host", "alpha", "--program", path)
    refused(65, "mission.lb", "check", path)


def test_a_deployment_that_does_not_fit_the_program_is_refused(lfield, good):
    lfield.write("mission.dL", "//Bel:bell@alpha\n//Ringer:tom@alpha?bell\n//Ringer:tom@alpha?bell\n")
    done = lfield("up", "--deploy", good, "--all", "--until-done", status=65)
    text = "\n".join(done.err)
    assert "mission.dL:1:3: error[" in text
    assert "did you mean 'Bell'" in text
    assert "mission.dL:3:" in text, "all errors in one run"


def test_all_mistakes_of_a_devices_file_are_reported_at_once(lfield, here, good):
    lfield.write("mission.devices.yaml", "agents:\n  belle: {heap: 1 MiB}\n  bell: {heap: much, wings: 2}\n")
    done = here("up", "--deploy", good, "--all", "--until-done", status=65)
    text = "\n".join(done.err)
    assert "mission.devices.yaml:2:3" in text
    assert "mission.devices.yaml:3:16" in text
    assert "'wings'" in text


# check, build, disasm


def test_check_reports_every_error_of_a_file_in_one_run(lfield):
    lfield.write(
        "bad.L", "coordinator C {\n  init(string[] arg) {\n    int a = tru;\n    b = 1;\n    a.f();\n  }\n}\n"
    )
    done = lfield("check", "bad.L", status=65)
    errors = [line for line in done.err if ": error[L" in line]
    assert [error.split(":")[:2] for error in errors] == [["bad.L", "3"], ["bad.L", "4"], ["bad.L", "5"]]
    assert done.err[-1].startswith("lfield: 3 errors")
    assert sum(line.strip().startswith("^") for line in done.err) == 3


def test_check_prints_nothing_for_valid_files(lfield, good):
    done = lfield("check", "mission.L", "mission.dL")
    assert (lfield.status(done), done.out, done.err) == (0, [], [])


@pytest.mark.few(0)
def test_a_built_program_runs(lfield, good):
    built = lfield("build", "mission.L", "-o", "elsewhere.lb", status=0)
    assert "elsewhere.lb: " in built.err[0]
    (lfield.folder / "mission.L").unlink()
    done = lfield("up", "--deploy", good, "--all", "--until-done", "--program", "elsewhere.lb")
    assert (lfield.status(done), done.out) == (0, ["alpha | ring"]), done.said


@pytest.mark.parametrize("target", ["/dev/full", "/proc/nowhere/out.lb", "no/such/folder.lb", "mission.d"])
def test_a_program_file_that_cannot_be_written_is_reported(lfield, refused, good, target):
    (lfield.folder / "mission.d").mkdir()
    refused(73, f"cannot write {target}: ", "build", "mission.L", "-o", target)
    assert not [path.name for path in lfield.folder.iterdir() if path.name.startswith("tmp")]


@pytest.mark.few(0)
def test_a_listing_whose_reader_closes_ends_quietly(lfield, good):
    listing = f"{sys.executable} -m lfield disasm mission.L"
    command = f"unset PYTHONUNBUFFERED; {listing} | head -1; echo ${{PIPESTATUS[0]}}"
    many = "".join(f"class C{n} {{ public int f() {{ return {n}; }} }}\n" for n in range(1000))
    lfield.write("mission.L", GOOD + many)
    done = subprocess.run(
        ["bash", "-c", command], cwd=lfield.folder, capture_output=True, text=True, check=False
    )
    assert done.stderr == ""
    assert done.stdout.splitlines()[0].startswith("; program ")
    assert done.stdout.splitlines()[-1] == "74"


@pytest.mark.parametrize("command", ["disasm mission.L", "--help", "--version"])
def test_a_full_disk_under_the_output_of_a_command_is_reported(lfield, good, command):
    with open("/dev/full", "wb") as full:
        done = lfield(*command.split(), stdout=full)
    assert lfield.status(done) == 74
    assert done.err == ["lfield: no space left on device"]


# up


@pytest.mark.few(0)
def test_a_computer_in_the_deployment_needs_no_host_option(lfield):
    deployment = lfield.mission(GOOD, DEPLOYMENT.replace("alpha", socket.gethostname()))
    maps = lfield.maps([socket.gethostname()])
    done = lfield("up", "--deploy", deployment, *maps, "--until-done")
    assert (lfield.status(done), done.out) == (0, ["ring"]), done.said


@pytest.mark.few(0)
def test_a_host_named_by_a_loopback_address_is_this_computer(lfield):
    deployment = lfield.mission(
        GOOD,
        "//Bell:bell@127.0.0.1\n//Bell:other@192.0.2.7\n//Ringer:tom@127.0.0.1?bell\n",
        "start: {without: [192.0.2.7]}\n",
    )
    maps = lfield.maps(["127.0.0.1"])
    done = lfield("up", "--deploy", deployment, *maps, "--until-done", "--first-start")
    assert (lfield.status(done), done.out) == (0, ["ring"]), done.said


def test_a_host_of_several_does_not_start_without_keys(lfield, refused):
    deployment = lfield.mission(GOOD, "//Bell:bell@alpha\n//Ringer:tom@bravo?bell\n")
    refused(
        64,
        "alpha has no keys, which it needs to listen on a network",
        "up",
        "--deploy",
        deployment,
        "--host",
        "alpha",
        "--map",
        "alpha=127.0.0.1:8181",
    )


def test_a_single_host_without_keys_listens_only_locally(lfield, good):
    arguments = ("up", "--deploy", good, "--host", "alpha", "--map", "alpha=no.such.host.invalid:1")
    done = lfield(*arguments, "--until-done")
    assert (lfield.status(done), done.out) == (0, ["ring"]), done.said
    assert "alpha listening for commands of this computer" in done.err


def test_keys_of_another_host_are_refused(lfield, refused, good):
    up = ("up", "--deploy", good, "--host", "alpha", *lfield.maps(["alpha"]), "--keys")
    folder = lfield.keys.give("alpha", "bravo")
    refused(65, "these are the keys of host bravo, not of host alpha", *up, folder / "bravo")
    lfield.keys.put("alpha", replace(Keyring(folder).issue("host", "alpha"), authority=b"nothing"))
    refused(65, "the keys are damaged or mismatched", *up, folder)
    lfield.keys.put("alpha", lfield.keys.issue("host", "alpha", lasts=3600.0))
    refused(65, "but the mission may last 86400 s from", *up, folder)
    refused(65, "has no keys of host alpha", *up, lfield.folder)
    (folder / "alpha" / "host.key").chmod(0o644)
    refused(65, "host.key cannot be used", *up, folder)


def test_a_revoked_host_does_not_start(lfield, refused, good):
    maps, folder = lfield.maps(["alpha"]), lfield.keys.folder / "alpha"
    keys = lfield.keys.issue("host", "alpha")
    lfield.keys.put(
        "alpha",
        replace(keys, revoked=lfield.keys.revocation_list(2, f"{TlsIdentity(keys).own_identity().serial}")),
    )
    text = "the keys of host alpha are revoked (list 2): make new ones with 'lfield keys host alpha'"
    refused(65, text, "up", "--deploy", good, "--host", "alpha", *maps, "--keys", folder)


def test_an_address_of_another_computer_is_refused(lfield, refused, good):
    lfield.keys.give("alpha")
    up = ("up", "--deploy", good, "--host", "alpha", "--map")
    refused(69, "the address is not one of this machine", *up, "alpha=192.0.2.1:8181")
    refused(69, "the name is not known; correct it", *up, "alpha=no.such.host.invalid:1")


@pytest.mark.few(0)
def test_a_missing_vendor_library_names_the_extra_to_install(lfield):
    lfield.write("shim/pymavlink/__init__.py", "raise ImportError('No module named pymavlink')\n")
    example = Path(__file__).parents[3] / "examples" / "01-first-flight" / "mission.dL"
    done = lfield(
        "up",
        "--deploy",
        example,
        "--all",
        "--sim",
        "--until-done",
        env={"PYTHONPATH": str(lfield.folder / "shim")},
        status=69,
    )
    assert "lfield[mavlink]" in "\n".join(done.err)
    assert lfield.all_ended()
