"""The steps that bring a robot to an installation, from its facts. Pure.

A step is done, or has commands that do it, or refuses: then the host is not changed. Planning again
with the facts after all steps gives steps that are all done, also after an interruption anywhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

from msgspec import Struct

from lfield.authority.key_material import AUTHORITY
from lfield.provision import robot_scripts as scripts
from lfield.provision.installation import PRIVATE, Installation, RobotFile
from lfield.provision.lock_file import Wheel
from lfield.provision.robot_facts import KEYS, ROOT, RobotFacts
from lfield.provision.wheel_target import ARCHITECTURES, MIN_GLIBC, PYTHONS, WheelTarget

StepState = Literal["done", "todo", "note", "refused"]

#: The Python that is brought to a robot without a usable one.
STANDALONE = "3.12"
#: A clock that is further away from that of the desk is reported, in seconds.
MAX_CLOCK_OFFSET = 60.0
#: Wheels that are sent in one command, in bytes: an interrupted transfer repeats at most this.
BATCH = 4 << 20
#: Steps that change files that the service reads when it starts.
_READ_BY_SERVICE = ("keys", "settings", "unit", "version")
#: Bytes of an environment for each byte of its wheels, bytecode included; of a Python, of its archive.
_UNPACKED, _PYTHON_UNPACKED = 6, 4


class RobotUpload(Struct, frozen=True):
    """A file that is sent with a command: its contents, or the file on the desk that has them."""

    name: str
    source: bytes | Path


class RootCommand(Struct, frozen=True):
    """A script that root runs on the robot, and the files in its working directory."""

    script: str
    uploads: tuple[RobotUpload, ...] = ()


class Step(Struct, frozen=True):
    """One step: `text` describes the state or the action; `advice` is for the operator."""

    name: str
    state: StepState
    text: str
    advice: str = ""
    commands: tuple[RootCommand, ...] = ()
    #: Whether the step must not be executed while a mission runs on the robot.
    disturbs_mission: bool = False


class PythonChoice(Struct, frozen=True):
    """The Python of the environment; `path` is empty if the desk brings one."""

    path: str
    tag: str


def choose_python(facts: RobotFacts) -> PythonChoice:
    """The robot's own Python if it can be used, its default one first; else a standalone Python."""
    usable = [python for python in facts.pythons if python.is_usable and python.tag in PYTHONS]
    if usable:
        return PythonChoice(usable[0].path, usable[0].tag)
    return PythonChoice("", STANDALONE)


def target_of(facts: RobotFacts, python: PythonChoice) -> WheelTarget:
    """The platform for which the robot needs wheels."""
    return WheelTarget(facts.arch, python.tag)


def system_step(facts: RobotFacts, arch: str, inventory: str) -> Step:
    """Whether the robot's system can be provisioned; `arch` is that of the inventory, or empty."""
    text = f"{facts.arch}, {facts.system or 'unknown system'}"
    if facts.arch not in ARCHITECTURES:
        supported = ", ".join(sorted(ARCHITECTURES))
        return Step("system", "refused", f"{text}: no wheels for this architecture", f"use {supported}")
    if arch and arch != facts.arch:
        reason = f"{text}: the inventory says {arch}"
        return Step("system", "refused", reason, f"correct `arch` or the addresses in {inventory}")
    if facts.glibc < MIN_GLIBC:
        found = ".".join(map(str, facts.glibc)) or "no"
        needed = ".".join(map(str, MIN_GLIBC))
        return Step("system", "refused", f"{text}: {found} glibc", f"install a system with glibc {needed}")
    return Step("system", "done", text)


def clock_step(facts: RobotFacts, host: str, desk_time: float) -> Step:
    """The step for the clock. A wrong clock is no obstacle: certificates are never 'not yet valid'
    (authority/trusted_clock.py).
    """
    offset = facts.time - desk_time
    if abs(offset) <= MAX_CLOCK_OFFSET:
        return Step("clock", "done", "agrees with the desk")
    where = "behind" if offset < 0 else "ahead of"
    advice = f"set it: ssh {host} sudo date -u -s @$(date +%s)"
    return Step("clock", "note", f"{abs(offset):.0f} s {where} the desk", advice)


def plan(facts: RobotFacts, user: str, installation: Installation) -> list[Step]:
    """All steps in their order, or only those that refuse; `user` is that of ssh."""
    python = choose_python(facts)
    steps = [
        _python_step(facts, python, installation),
        _users_step(facts, user, installation),
        _wheels_step(facts, installation),
        _environment_step(facts, python, installation),
        _keys_step(facts, installation),
        _files_step(facts, "settings", installation.settings),
        _files_step(facts, "unit", (installation.unit,)),
        _version_step(facts, installation),
    ]
    is_changed = any(step.state == "todo" for step in steps if step.name in _READ_BY_SERVICE)
    steps.append(_service_step(facts, installation, is_changed))
    refused = [step for step in (*steps, *_disk_step(facts, installation)) if step.state == "refused"]
    return refused or steps


# --- files to send ------------------------------------------------------------------------------------------


def _python_step(facts: RobotFacts, python: PythonChoice, installation: Installation) -> Step:
    if python.path:
        return Step("python", "done", f"{python.path}, {python.tag}")
    brought = installation.payload.python
    found = ", ".join(sorted({python.tag for python in facts.pythons})) or "none"
    text = f"the robot has {found}; {', '.join(PYTHONS)} can be used"
    if brought is None:
        return Step("python", "refused", text, "sudo apt-get install python3.11, or run --prepare with uv")
    if brought.version in facts.standalone:
        return Step("python", "done", f"standalone {brought.version}")
    script = scripts.python_script(brought.version, brought.sha256)
    command = RootCommand(script, (RobotUpload(scripts.ARCHIVE, brought.archive),))
    return Step("python", "todo", f"install a standalone Python {brought.version}: {text}", "", (command,))


def python_path(python: PythonChoice, installation: Installation) -> str:
    """The path of the Python that makes the environment."""
    brought = installation.payload.python
    if python.path or brought is None:
        return python.path
    return f"{ROOT}/python/{brought.version}/bin/python3"


def _users_step(facts: RobotFacts, user: str, installation: Installation) -> Step:
    groups = installation.groups
    if missing := sorted(groups - facts.existing_groups):
        reason = f"group {', '.join(missing)} does not exist on the robot"
        return Step("user", "refused", reason, "correct `groups` in the inventory, or create the group")
    has_groups = facts.service_groups is not None and groups <= facts.service_groups
    is_member = user == "root" or "lfield" in facts.member_of
    named = ", ".join(sorted(groups))
    if has_groups and is_member:
        return Step("user", "done", f"lfield, with access to ports by {named}")
    command = RootCommand(scripts.users_script(user, groups))
    return Step("user", "todo", f"create lfield in {named}; {user} joins lfield", "", (command,))


def _is_built(facts: RobotFacts, installation: Installation) -> bool:
    return installation.payload.environment in facts.versions


def missing_wheels(facts: RobotFacts, installation: Installation) -> list[Wheel]:
    """The wheels that the robot does not have, small ones first; none if its environment is complete."""
    if _is_built(facts, installation):
        return []
    wheels = installation.payload.wheels
    missing = [wheel for wheel in wheels if facts.wheels.get(wheel.file) != wheel.sha256]
    return sorted(missing, key=lambda wheel: (wheel.size, wheel.file))


def _wheels_step(facts: RobotFacts, installation: Installation) -> Step:
    missing = missing_wheels(facts, installation)
    if not missing:
        return Step("wheels", "done", f"all {len(installation.payload.wheels)} are there")
    size = sum(wheel.size for wheel in missing)
    commands = tuple(
        RootCommand(
            scripts.wheels_script([(wheel.file, wheel.sha256) for wheel in batch]),
            tuple(RobotUpload(wheel.file, installation.payload.path(wheel)) for wheel in batch),
        )
        for batch in _batches(missing)
    )
    return Step("wheels", "todo", f"send {len(missing)} wheels, {size / 1e6:.1f} MB", "", commands)


def _batches(wheels: Sequence[Wheel]) -> Iterator[list[Wheel]]:
    batch: list[Wheel] = []
    for wheel in wheels:
        if batch and sum(each.size for each in batch) + wheel.size > BATCH:
            yield batch
            batch = []
        batch.append(wheel)
    if batch:
        yield batch


def _disk_step(facts: RobotFacts, installation: Installation) -> Iterator[Step]:
    if _is_built(facts, installation):
        return
    payload = installation.payload
    needed = sum(wheel.size for wheel in missing_wheels(facts, installation))
    needed += _UNPACKED * sum(wheel.size for wheel in payload.wheels)
    if payload.python is not None and payload.python.version not in facts.standalone:
        needed += (1 + _PYTHON_UNPACKED) * payload.python.size
    if facts.free < needed:
        text = f"{ROOT} needs {needed / 1e6:.0f} MB, and {facts.free / 1e6:.0f} MB are free"
        yield Step("disk", "refused", text, "free disk space on the robot: sudo apt-get clean")


def _environment_step(facts: RobotFacts, python: PythonChoice, installation: Installation) -> Step:
    name = installation.payload.environment
    if _is_built(facts, installation):
        return Step("environment", "done", f"{ROOT}/{name}")
    script = scripts.environment_script(name, python_path(python, installation))
    uploads = (RobotUpload(scripts.REQUIREMENTS, installation.payload.lock.encode()),)
    return Step("environment", "todo", f"install {ROOT}/{name}", "", (RootCommand(script, uploads),))


# --- configuration ------------------------------------------------------------------------------------------


def _outdated(facts: RobotFacts, files: Sequence[RobotFile]) -> list[RobotFile]:
    return [
        file
        for file in files
        if (facts.files.get(file.path), facts.modes.get(file.path)) != (file.sha256, file.access)
    ]


def _numbered(files: Sequence[RobotFile]) -> tuple[RobotUpload, ...]:
    return tuple(RobotUpload(str(number), file.data) for number, file in enumerate(files))


def needs_new_key(facts: RobotFacts, keys: Sequence[RobotFile]) -> bool:
    """Whether the private key of a host is lost: it is not among `keys`, and not on the robot with them."""
    has_key = any(file.mode == PRIVATE for file in keys)
    certificates = [file for file in keys if file.path.endswith("/host.pem")]
    if has_key or not certificates:
        return False
    private = certificates[0].path.replace("/host.pem", "/host.key")
    return private not in facts.files or facts.files.get(certificates[0].path) != certificates[0].sha256


def _keys_step(facts: RobotFacts, installation: Installation) -> Step:
    if facts.host not in ("", installation.host) and not installation.takes_over:
        text = f"this robot is {facts.host}: it has its keys, and its service runs as {facts.host}"
        advice = f"correct the addresses in the inventory, or make it {installation.host}: --replace-keys"
        return Step("keys", "refused", text, advice)
    if not installation.keys:
        text = "there is no authority on this desk"
        if f"{KEYS}/{installation.keys_folder}/host.key" not in facts.files:
            advice = "lfield keys init --person NAME; or name its directory with --authority"
            return Step("keys", "refused", text, advice)
        return Step("keys", "note", f"{text}; the keys of the robot stay")
    if _has_other_authority(facts, installation) and not installation.takes_over:
        text = f"the keys of {installation.host} on the robot are of another authority, of another team"
        advice = "use the authority of that team, or take the robot over: --replace-keys"
        return Step("keys", "refused", text, advice)
    outdated = _outdated(facts, installation.keys)
    if not outdated and facts.has_private_keys_folder:
        return Step("keys", "done", f"keys of {installation.host}")
    script = scripts.keys_script(installation.keys_folder, outdated)
    command = RootCommand(script, _numbered(outdated))
    return Step("keys", "todo", f"install the keys of {installation.host}", "", (command,))


def _has_other_authority(facts: RobotFacts, installation: Installation) -> bool:
    """Whether the robot has keys of an authority that is not on this desk."""
    own = [file for file in installation.keys if file.path.endswith(f"/{AUTHORITY}")]
    return any(facts.files.get(file.path, file.sha256) != file.sha256 for file in own)


def _files_step(facts: RobotFacts, name: str, files: Sequence[RobotFile]) -> Step:
    outdated = _outdated(facts, files)
    if not outdated:
        return Step(name, "done", ", ".join(file.path for file in files))
    command = RootCommand(scripts.files_script(outdated), _numbered(outdated))
    text = f"write {', '.join(file.path for file in outdated)}"
    return Step(name, "todo", text, "", (command,), disturbs_mission=name == "unit")


def _version_step(facts: RobotFacts, installation: Installation) -> Step:
    environment = installation.payload.environment
    if facts.current == environment:
        return Step("version", "done", f"{environment} is active")
    wheels = [wheel.file for wheel in installation.payload.wheels]
    command = RootCommand(scripts.version_script(installation, wheels, facts.current))
    instead = f" instead of {facts.current}" if facts.current else ""
    text = f"activate {environment}{instead}"
    if _release(facts.current) > _release(environment):
        text += ", which is newer: a downgrade"
    return Step("version", "todo", text, "", (command,), disturbs_mission=True)


def _release(environment: str) -> tuple[int, ...]:
    """The version of lfield in the name of an environment, as numbers."""
    return tuple(int(part) for part in environment.partition("-")[0].split(".") if part.isdecimal())


def start_command(host: str) -> str:
    """The command that starts the service by hand."""
    return f"sudo -u lfield {ROOT}/current/bin/lfield service --host {host}"


def _service_step(facts: RobotFacts, installation: Installation, is_changed: bool) -> Step:
    if not facts.has_systemd:
        text = "not started: systemd does not run on the robot"
        return Step("service", "note", text, f"start it there: {start_command(installation.host)}")
    is_current = facts.started == installation.configuration and not is_changed
    if is_current and facts.is_active and facts.is_enabled:
        return Step("service", "done", "runs with this configuration, and starts at each boot")
    command = RootCommand(scripts.service_script(installation.configuration))
    text = "start the service, now and at each boot"
    return Step("service", "todo", text, "", (command,), disturbs_mission=True)
