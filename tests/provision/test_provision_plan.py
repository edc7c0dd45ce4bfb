"""The plan of one robot: steps from facts, without a robot."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from lfield.provision.installation import (
    Installation,
    Payload,
    StandalonePython,
    key_files,
    settings_file,
    unit_file,
)
from lfield.provision.lock_file import Wheel
from lfield.provision.plan import (
    BATCH,
    MAX_CLOCK_OFFSET,
    STANDALONE,
    Step,
    choose_python,
    clock_step,
    plan,
    system_step,
    target_of,
)
from lfield.provision.robot_facts import RobotFacts, RobotPython, facts_script, parse_access, parse_facts
from lfield.provision.wheel_target import WheelTarget

OWN = Path("/desk/lfield-0.4.0-py3-none-any.whl")
WHEELS = (
    Wheel("rich-15.0.0-py3-none-any.whl", "a" * 64, 300_000),
    Wheel("cryptography-50.0.2-cp311-abi3-manylinux_2_28_aarch64.whl", "b" * 64, BATCH),
    Wheel(OWN.name, "c" * 64, 900_000),
)
STANDALONE_PYTHON = StandalonePython("3.12.9", Path("/desk/python.tar.gz"), "d" * 64, 20_000_000)
ROBOT = RobotFacts(
    time=1000.0,
    arch="aarch64",
    glibc=(2, 36),
    system="Debian GNU/Linux 12 (bookworm)",
    has_systemd=True,
    pythons=(RobotPython("/usr/bin/python3", (3, 11, 2), True),),
    standalone=frozenset(),
    free=1 << 30,
    existing_groups=frozenset({"dialout", "gpio"}),
    service_groups=None,
    member_of=frozenset({"pi"}),
    versions=frozenset(),
    current="",
    started="",
)
NAMES = ["python", "user", "wheels", "environment", "keys", "settings", "unit", "version", "service"]


def installation(python: StandalonePython | None = None, version: str = "0.4.0") -> Installation:
    payload = Payload(version, WHEELS, Path("/desk/wheels"), OWN, python)
    keys = key_files("alpha", [("host.pem", b"certificate", False), ("host.key", b"secret", True)])
    settings = (settings_file("service.env", b"LFIELD_HOST=alpha\n"),)
    return Installation(
        "alpha", payload, frozenset({"dialout", "gpio"}), settings, unit_file(b"[Unit]"), keys, "alpha"
    )


def provisioned(facts: RobotFacts, expected: Installation) -> RobotFacts:
    """The facts after all steps."""
    files = (*expected.settings, *expected.keys, expected.unit)
    return replace(
        facts,
        service_groups=frozenset({"lfield"}) | expected.groups,
        member_of=facts.member_of | {"lfield"},
        wheels={wheel.file: wheel.sha256 for wheel in expected.payload.wheels},
        versions=facts.versions | {expected.payload.environment},
        current=expected.payload.environment,
        started=expected.configuration,
        standalone=frozenset({expected.payload.python.version} if expected.payload.python else ()),
        files={file.path: file.sha256 for file in files},
        modes={file.path: file.access for file in files},
        has_private_keys_folder=True,
        is_enabled=True,
        is_active=True,
    )


def states(steps: list[Step]) -> dict[str, str]:
    return {step.name: step.state for step in steps}


def test_bare_robot_needs_every_step():
    steps = plan(ROBOT, "pi", installation())
    assert [step.name for step in steps] == NAMES
    assert [step.name for step in steps if step.state == "done"] == ["python"]
    assert all(step.commands for step in steps if step.state == "todo")


def test_provisioned_robot_needs_no_step():
    expected = installation()
    assert set(states(plan(provisioned(ROBOT, expected), "pi", expected)).values()) == {"done"}


def test_wheels_are_sent_once_in_bounded_batches():
    step = plan(ROBOT, "pi", installation())[NAMES.index("wheels")]
    sent = [[upload.name for upload in command.uploads] for command in step.commands]
    assert sent == [[WHEELS[0].file, WHEELS[2].file], [WHEELS[1].file]]
    own = [
        upload.source for command in step.commands for upload in command.uploads if upload.name == OWN.name
    ]
    assert own == [OWN]
    some = replace(ROBOT, wheels={WHEELS[0].file: WHEELS[0].sha256, WHEELS[1].file: "damaged"})
    step = plan(some, "pi", installation())[NAMES.index("wheels")]
    assert [upload.name for command in step.commands for upload in command.uploads] == [
        WHEELS[2].file,
        WHEELS[1].file,
    ]


def test_environment_name_depends_on_its_wheels():
    expected = installation()
    assert expected.payload.environment.startswith("0.4.0-")
    other = replace(expected.payload, wheels=(replace(WHEELS[0], sha256="e" * 64), *WHEELS[1:]))
    assert other.environment != expected.payload.environment


@pytest.mark.parametrize(
    ("change", "todo"),
    [
        (lambda facts, wanted: {"files": {**facts.files, wanted.unit.path: "other"}}, {"unit", "service"}),
        (
            lambda facts, wanted: {"modes": {**facts.modes, wanted.keys[1].path: "644:root:root"}},
            {"keys", "service"},
        ),
        (lambda facts, wanted: {"has_private_keys_folder": False}, {"keys", "service"}),
        (lambda facts, wanted: {"current": "0.3.0-0123456789ab"}, {"version", "service"}),
        (lambda facts, wanted: {"started": "before"}, {"service"}),
        (lambda facts, wanted: {"is_active": False}, {"service"}),
        (lambda facts, wanted: {"is_enabled": False}, {"service"}),
        (lambda facts, wanted: {"service_groups": frozenset({"lfield", "dialout"})}, {"user"}),
        (lambda facts, wanted: {"member_of": frozenset({"pi"})}, {"user"}),
        (lambda facts, wanted: {"versions": frozenset()}, {"environment"}),
        (lambda facts, wanted: {"versions": frozenset(), "wheels": {}}, {"environment", "wheels"}),
    ],
)
def test_only_differences_are_repaired(change, todo):
    wanted = installation()
    facts = provisioned(ROBOT, wanted)
    steps = states(plan(replace(facts, **change(facts, wanted)), "pi", wanted))
    assert {name for name, state in steps.items() if state != "done"} == todo


def test_changed_configuration_restarts_the_service():
    expected = installation()
    facts = provisioned(ROBOT, expected)
    other = replace(expected, settings=(settings_file("service.env", b"LFIELD_HOST=bravo\n"),))
    steps = states(plan(facts, "pi", other))
    assert {name for name, state in steps.items() if state == "todo"} == {"settings", "service"}


def test_steps_that_change_the_running_version_disturb_a_mission():
    steps = plan(ROBOT, "pi", installation())
    assert [step.name for step in steps if step.disturbs_mission] == ["unit", "version", "service"]


def test_root_needs_no_group():
    facts = replace(provisioned(ROBOT, installation()), member_of=frozenset({"root"}))
    assert states(plan(facts, "root", installation()))["user"] == "done"


def test_keys_of_the_robot_stay_without_an_authority():
    expected = installation()
    without = replace(expected, keys=())
    assert states(plan(provisioned(ROBOT, expected), "pi", without))["keys"] == "note"
    assert states(plan(ROBOT, "pi", without)) == {"keys": "refused"}


def test_robot_of_another_host_is_replaced_only_by_command():
    """By mistake the inventory has the address of this robot under the name of another host."""
    expected = installation()
    assert states(plan(replace(ROBOT, host="alpha"), "pi", expected))["keys"] == "todo"
    for other in (replace(ROBOT, host="bravo"), replace(provisioned(ROBOT, expected), host="bravo")):
        (refused,) = plan(other, "pi", expected)
        assert (refused.name, refused.state) == ("keys", "refused")
        assert "bravo" in refused.text
        # Without an authority its settings are not overwritten either.
        assert {step.state for step in plan(other, "pi", replace(expected, keys=()))} == {"refused"}
        assert states(plan(other, "pi", replace(expected, takes_over=True)))["keys"] != "refused"


def test_keys_of_another_authority_are_replaced_only_by_command():
    expected = installation()
    own = replace(
        expected, keys=(*expected.keys, *key_files("alpha", [("authority.pem", b"of this team", False)]))
    )
    facts = provisioned(ROBOT, own)
    other = replace(facts, files={**facts.files, own.keys[-1].path: "of another team"})
    assert states(plan(other, "pi", own)) == {"keys": "refused"}
    steps = states(plan(other, "pi", replace(own, takes_over=True)))
    assert {name for name, state in steps.items() if state == "todo"} == {"keys", "service"}
    assert set(states(plan(facts, "pi", own)).values()) == {"done"}


@pytest.mark.parametrize(
    ("current", "is_downgrade"), [("0.10.0-0123456789ab", True), ("0.3.9-0123456789ab", False), ("", False)]
)
def test_downgrade_of_lfield_is_named(current, is_downgrade):
    facts = replace(provisioned(ROBOT, installation()), current=current)
    step = plan(facts, "pi", installation())[NAMES.index("version")]
    assert (step.state, "downgrade" in step.text) == ("todo", is_downgrade)


def test_start_command_is_named_without_systemd():
    step = plan(replace(ROBOT, has_systemd=False), "pi", installation())[-1]
    assert (step.name, step.state) == ("service", "note")
    assert "/opt/lfield/current/bin/lfield service --host alpha" in step.advice


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ({"existing_groups": frozenset({"dialout"})}, "user"),
        ({"free": 10_000_000}, "disk"),
        ({"pythons": ()}, "python"),
    ],
)
def test_refused_step_leaves_the_robot_unchanged(changes, refused):
    steps = plan(replace(ROBOT, **changes), "pi", installation())
    assert states(steps) == {refused: "refused"}


def test_full_disk_is_accepted_on_a_provisioned_robot():
    expected = installation()
    facts = replace(provisioned(ROBOT, expected), free=0)
    assert set(states(plan(facts, "pi", expected)).values()) == {"done"}


@pytest.mark.parametrize(
    ("changes", "arch", "state"),
    [
        ({}, "", "done"),
        ({}, "aarch64", "done"),
        ({}, "x86_64", "refused"),
        ({"arch": "riscv64"}, "", "refused"),
        ({"glibc": (2, 27)}, "", "refused"),
        ({"glibc": ()}, "", "refused"),
    ],
)
def test_systems_without_wheels_are_refused(changes, arch, state):
    assert system_step(replace(ROBOT, **changes), arch, "inventory.yaml").state == state


@pytest.mark.parametrize(
    ("offset", "state"), [(0.0, "done"), (MAX_CLOCK_OFFSET, "done"), (61.0, "note"), (-1e9, "note")]
)
def test_wrong_clock_is_reported(offset, state):
    assert clock_step(replace(ROBOT, time=1e9 + offset), "alpha", 1e9).state == state


@pytest.mark.parametrize(
    ("versions", "path", "tag"),
    [
        ([("/usr/bin/python3", (3, 13, 5), True)], "/usr/bin/python3", "3.13"),
        ([("/usr/bin/python3", (3, 10, 12), True)], "", STANDALONE),
        (
            [("/usr/bin/python3", (3, 14, 0), True), ("/usr/bin/python3.12", (3, 12, 1), True)],
            "/usr/bin/python3.12",
            "3.12",
        ),
        ([("/usr/bin/python3", (3, 11, 2), False)], "", STANDALONE),
        ([], "", STANDALONE),
    ],
)
def test_robot_python_is_used_if_wheels_support_it(versions, path, tag):
    facts = replace(ROBOT, pythons=tuple(RobotPython(*python) for python in versions))
    choice = choose_python(facts)
    assert (choice.path, choice.tag) == (path, tag)
    assert target_of(facts, choice) == WheelTarget("aarch64", tag)


def test_standalone_python_is_installed_once():
    facts = replace(ROBOT, pythons=(RobotPython("/usr/bin/python3", (3, 10, 12), True),))
    expected = installation(STANDALONE_PYTHON)
    first = plan(facts, "pi", expected)
    assert first[0].state == "todo"
    assert first[0].commands[0].uploads[0].source == STANDALONE_PYTHON.archive
    (command,) = first[NAMES.index("environment")].commands
    assert "/opt/lfield/python/3.12.9/bin/python3" in command.script
    assert set(states(plan(provisioned(facts, expected), "pi", expected)).values()) == {"done"}


# --- facts --------------------------------------------------------------------------------------------------

OUTPUT = """Welcome to the robot!
time\t1700000000
machine\taarch64
bits\t64
glibc\t2.36
system\tDebian GNU/Linux 12 (bookworm)
systemd\tyes
python\t/usr/bin/python3\t3.11.2\tyes
python\t/usr/bin/python3.10\t
free\t1000
existing\tdialout gpio\x20
service\tlfield dialout
member\tpi lfield
version\t0.4.0-0123456789ab
current\t0.4.0-0123456789ab
started\tabc
wheel\t/opt/lfield/wheels/rich-15.0.0-py3-none-any.whl\taaa
file\t/etc/lfield/service.env\tbbb
mode\t/etc/lfield/service.env\t644:root:root
keys\tprivate
enabled\tenabled
active\tinactive
"""


def test_facts_are_parsed_from_the_script_output():
    facts = parse_facts(OUTPUT)
    assert (facts.arch, facts.glibc, facts.free, facts.time) == ("aarch64", (2, 36), 1024_000, 1.7e9)
    assert facts.pythons == (RobotPython("/usr/bin/python3", (3, 11, 2), True),)
    assert facts.existing_groups == {"dialout", "gpio"}
    assert facts.service_groups == {"lfield", "dialout"}
    assert facts.versions == {"0.4.0-0123456789ab"}
    assert facts.wheels == {"rich-15.0.0-py3-none-any.whl": "aaa"}
    assert facts.files == {"/etc/lfield/service.env": "bbb"}
    assert (facts.has_private_keys_folder, facts.is_enabled, facts.is_active) == (True, True, False)


def test_32_bit_system_on_a_64_bit_kernel_is_recognized():
    """32-bit Raspberry Pi OS on a Pi 4: `uname -m` is that of the kernel."""
    assert parse_facts(OUTPUT.replace("bits\t64", "bits\t32")).arch == "armv7l"


def test_output_of_another_program_is_refused():
    with pytest.raises(ValueError, match="not a robot"):
        parse_facts("not a robot\n")
    with pytest.raises(ValueError, match="no output"):
        parse_access("")


def test_names_in_the_script_are_quoted():
    script = facts_script("pi; reboot", ["dialout", "a b"], "it's")
    assert "'pi; reboot'" in script
    assert "'a b' dialout" in script
    assert "/etc/lfield/keys/'it'\"'\"'s'/*" in script
