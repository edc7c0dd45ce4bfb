"""Provisioning of one robot: connects, reads its facts, plans, executes the steps, and runs doctor there."""

from __future__ import annotations

import asyncio
import json
import shlex
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec.structs import replace

from lfield.errors import LfieldError, ProvisionError
from lfield.provision.installation import (
    BASE_GROUPS,
    Installation,
    RobotFile,
    device_file,
    settings_file,
    unit_file,
)
from lfield.provision.own_wheel import deployment_file
from lfield.provision.plan import (
    STANDALONE,
    PythonChoice,
    Step,
    choose_python,
    clock_step,
    needs_new_key,
    plan,
    system_step,
    target_of,
)
from lfield.provision.robot_facts import (
    CURRENT,
    SERVICE_USER,
    RobotFacts,
    facts_script,
    parse_facts,
)
from lfield.provision.ssh_connection import SshConnection
from lfield.provision.ssh_errors import SshDestination, access_error
from lfield.provision.team_keys import keys_folder
from lfield.provision.wheel_cache import WheelCache
from lfield.provision.wheel_target import PYTHONS, WheelTarget
from lfield.text.input_files import error_reason
from lfield.text.suggestions import listed

#: The reported states of a step: `running` precedes `changed` or `failed`; a dry run ends with `todo`.
Progress = Literal["done", "running", "changed", "todo", "note", "refused", "failed"]
#: Runs doctor with the rights that the unit gives to the service.
_DOCTOR = f"""
cd /
export RUNTIME_DIRECTORY=/run/lfield STATE_DIRECTORY=/var/lib/lfield HOME=/var/lib/lfield
limit="prlimit --rtprio=1"
$limit true 2>/dev/null || limit=""
$limit runuser -u {SERVICE_USER} -- {CURRENT}/bin/lfield doctor --json || [ $? = 69 ]
"""
_MISSIONS = f"""
cd /
if [ -x {CURRENT}/bin/lfield ]; then LFIELD_INVENTORY= {CURRENT}/bin/lfield ps --json 2>/dev/null; fi
printf '\\nprocesses\\t%s\\n' "$(pgrep -f '[l]field up ' | tr '\\n' ' ')"
"""
#: Prints the reasons against an update; none if the present version cannot report them.
_CHECK = f"""
cd /
export STATE_DIRECTORY=/var/lib/lfield HOME=/var/lib/lfield
[ -x {CURRENT}/bin/lfield ] || exit 0
found=$(runuser -u {SERVICE_USER} -- {CURRENT}/bin/lfield service --host HOST --check 2>/dev/null)
[ $? = 1 ] && printf '%s\\n' "$found"
exit 0
"""


#: Prints the reason of the end of a service that does not run; no text if it runs, or without systemd. The
#: unit starts it again 2 s after each end, so a single check may find it running.
_SERVICE = """
[ -d /run/systemd/system ] || exit 0
for look in 1 2 3 4 5 6; do
  if ! systemctl is-active lfield.service >/dev/null; then
    echo "it does not run"
    journalctl --unit lfield.service --lines 20 --output cat 2>/dev/null | grep '^lfield:' | tail -n 1
    exit 0
  fi
  sleep 0.5
done
"""


@dataclass(frozen=True, slots=True)
class Robot:
    """A host of the inventory, for provisioning."""

    name: str
    destinations: tuple[SshDestination, ...]
    arch: str = ""
    python: str = ""
    groups: frozenset[str] = frozenset()
    #: Files in /etc/lfield: the inventory, and the robot's own devices file.
    settings: Mapping[str, bytes] = field(default_factory=dict)
    #: Files in /etc/lfield that devices need; one may be a key.
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)


class StepReport(msgspec.Struct, frozen=True):
    """The state of a step of a host; `findings` are those of doctor, as JSON data."""

    host: str
    step: str
    state: Progress
    text: str
    advice: str = ""
    findings: tuple[Mapping[str, Any], ...] = ()

    def as_data(self) -> dict[str, object]:
        """The report as JSON data."""
        data: dict[str, object] = {
            "host": self.host,
            "step": self.step,
            "state": self.state,
            "message": self.text,
        }
        if self.advice:
            data["hint"] = self.advice
        return {**data, "findings": list(self.findings)} if self.findings else data


class UpdateGate:
    """An update of lfield on several robots: none is changed before all `hosts` have been checked.

    Hosts of different versions do not link, so a coordinator that has not ended could not continue on a team
    of which a part has another version.
    """

    def __init__(self, hosts: Iterable[str]) -> None:
        self._unchecked = set(hosts)
        self._refusing: dict[str, None] = {}
        self._all_checked = asyncio.Event()

    def on_checked(self, host: str, *, refuses: bool = False) -> None:
        """Record that a host was checked, or cannot be. `refuses`: a mission there runs or has not ended.

        Only the first call for a host counts.
        """
        if host not in self._unchecked:
            return
        self._unchecked.discard(host)
        if refuses:
            self._refusing[host] = None
        if not self._unchecked:
            self._all_checked.set()

    async def refusing(self, host: str) -> list[str]:
        """The other hosts that refuse, in the order of their checks, when all have been checked."""
        await self._all_checked.wait()
        return [other for other in self._refusing if other != host]


class ProvisionRun(msgspec.Struct, frozen=True):
    """The common data of all hosts of a run. Keys of a host are empty if the authority is not on this
    desk.
    """

    cache: WheelCache
    keys: Mapping[str, tuple[RobotFile, ...]]
    sockets: Path
    inventory: str
    on_report: Callable[[StepReport], None]
    #: Makes new keys for a host; not in a dry run.
    replaces_keys: Callable[[str], tuple[RobotFile, ...]] | None = None
    is_dry: bool = False
    only_prepares: bool = False
    #: Whether a robot with keys of another authority or host is taken over.
    takes_over: bool = False
    gate: UpdateGate = msgspec.field(default_factory=lambda: UpdateGate(()))
    desk_time: Callable[[], float] = time.time


class HostProvisioning:
    """The provisioning of one robot."""

    def __init__(self, run: ProvisionRun, robot: Robot, number: int) -> None:
        self._run, self._robot = run, robot
        self._connection = SshConnection(robot.name, run.sockets / f"{number}.ssh")

    async def provision(self) -> bool:
        """Execute all steps; returns whether the robot is provisioned, and doctor has found no problem
        there.
        """
        try:
            if self._run.only_prepares and self._robot.arch and self._robot.python:
                await self._collect(WheelTarget(self._robot.arch, self._robot.python))
                return True
            return await self._provision()
        except (LfieldError, OSError) as error:
            self._report_error(error)
            return False
        finally:
            self._run.gate.on_checked(self._robot.name)
            await self._connection.close()

    def _report_error(self, error: LfieldError | OSError) -> None:
        match error:
            case ProvisionError():
                self._report("failed", "failed", error.reason, error.advice)
            case OSError():
                # An error of the cache, or of a process that cannot be started.
                reason = f"{error.filename or 'this computer'}: {error_reason(error)}"
                self._report("failed", "failed", reason, "correct it on the desk, and run provision again")
            case _:
                self._report("failed", "failed", str(error))

    def _report(
        self,
        step: str,
        state: Progress,
        text: str,
        advice: str = "",
        findings: tuple[Mapping[str, Any], ...] = (),
    ) -> None:
        self._run.on_report(StepReport(self._robot.name, step, state, text, advice, findings))

    async def _provision(self) -> bool:
        await self._connect()
        facts = await self._facts()
        system = system_step(facts, self._robot.arch, self._run.inventory)
        if not self._report_step(system):
            return False
        self._report_step(clock_step(facts, str(self._connection.destination), self._run.desk_time()))
        installation = await self._installation(facts)
        if self._run.only_prepares:
            return True
        steps = plan(facts, self._connection.access.user, installation)
        permitted = await self._permitted(steps)
        refuses = any(step.name == "mission" and step.state == "refused" for step in permitted)
        self._run.gate.on_checked(self._robot.name, refuses=refuses)
        if facts.current and not refuses:
            permitted = await self._without_partial_update(permitted)
        if not all([await self._step(step) for step in permitted]):
            return False
        return self._run.is_dry or await self._doctor()

    async def _connect(self) -> None:
        self._report("connection", "running", f"connecting to {self._robot.destinations[0]}")
        await self._connection.open(self._robot.destinations)
        access = await self._connection.read_access()
        if access.sudo != "yes":
            raise access_error(self._robot.name, self._connection.destination, access)
        means = "" if access.uid == 0 else ", root by sudo"
        self._report("connection", "done", f"{self._connection.destination}{means}")

    async def _facts(self) -> RobotFacts:
        groups = self._robot.groups.union(BASE_GROUPS)
        user = self._connection.access.user
        script = facts_script(user, groups, keys_folder(self._robot.name))
        output = await self._connection.run_as_root(f"sh -c {shlex.quote(script)}", "facts")
        try:
            return parse_facts(output)
        except ValueError as error:
            raise ProvisionError(self._robot.name, f"its facts cannot be read: {error}") from None

    async def _collect(self, target: WheelTarget, python: PythonChoice | None = None) -> Installation:
        """Collect the payload on the desk; a Python of the inventory that is too old is replaced."""
        choice = python or PythonChoice("", target.python)
        if python is None and target.python in PYTHONS:
            choice = PythonChoice("python3", target.python)
        elif python is None:
            target = WheelTarget(target.arch, STANDALONE)
        self._report("wheels", "running", f"collecting wheels for {target}")
        payload = await self._run.cache.payload(target, brings_python=not choice.path)
        size = sum(wheel.size for wheel in payload.wheels)
        state: Progress = "done" if self._run.only_prepares else "running"
        brought = f" and Python {payload.python.version}" if payload.python else ""
        self._report(
            "wheels", state, f"{len(payload.wheels)} for {target}{brought}, {size / 1e6:.0f} MB collected"
        )
        name = self._robot.name
        environment = settings_file("service.env", f"LFIELD_HOST={name}\n".encode())
        settings = [settings_file(file, data) for file, data in self._robot.settings.items()]
        settings += [device_file(file, data) for file, data in self._robot.files.items()]
        return Installation(
            name,
            payload,
            self._robot.groups.union(BASE_GROUPS),
            (*settings, environment),
            unit_file(deployment_file("lfield.service")),
            self._run.keys.get(name, ()),
            keys_folder(name),
            self._run.takes_over,
        )

    async def _installation(self, facts: RobotFacts) -> Installation:
        python = choose_python(facts)
        installation = await self._collect(target_of(facts, python), python)
        if self._run.replaces_keys is None or not needs_new_key(facts, installation.keys):
            return installation
        self._report("keys", "note", f"the private key of {installation.host} is lost; making a new one")
        return replace(installation, keys=self._run.replaces_keys(installation.host))

    async def _permitted(self, steps: list[Step]) -> list[Step]:
        """The steps up to the first that would disturb a running mission, which refuses."""
        disturbing = [step for step in steps if step.state == "todo" and step.disturbs_mission]
        if not disturbing:
            return steps
        if not await is_mission_running(self._connection):
            update = next((step for step in disturbing if step.name == "version"), None)
            reason = await update_refusal(self._connection, self._robot.name) if update is not None else ""
            advice = "let them end, or 'lfield stop --discard'; then run provision again"
            return steps if update is None or not reason else _refused_from(steps, update, reason, advice)
        return _refused_from(
            steps, disturbing[0], "a mission runs on the robot", "stop it, and run provision again"
        )

    async def _without_partial_update(self, steps: list[Step]) -> list[Step]:
        """The steps; those before an update of lfield if another robot cannot be updated now."""
        update = next((step for step in steps if step.name == "version" and step.state == "todo"), None)
        if update is None or not (others := await self._run.gate.refusing(self._robot.name)):
            return steps
        reason = f"lfield is updated on all robots or none, and {listed(others)} cannot be updated"
        return _refused_from(steps, update, reason, "end the mission there, and run provision again")

    def _report_step(self, step: Step) -> bool:
        """Report a step as it was planned; returns whether it does not refuse."""
        self._report(step.name, step.state, step.text, step.advice)
        return step.state != "refused"

    async def _step(self, step: Step) -> bool:
        if step.state != "todo" or self._run.is_dry:
            return self._report_step(step)
        self._report(step.name, "running", step.text)
        for number, command in enumerate(step.commands):
            await self._connection.execute(command, step.name)
            if len(step.commands) > 1:
                self._report(step.name, "running", f"{step.text} ({number + 1} of {len(step.commands)})")
        self._report(step.name, "changed", step.text)
        return True

    async def _doctor(self) -> bool:
        self._report("doctor", "running", "checking ports, permissions, libraries and clock")
        output = await self._connection.run_as_root(f"sh -c {shlex.quote(_DOCTOR)}", "doctor")
        findings = tuple(json.loads(line) for line in output.splitlines() if line.startswith("{"))
        problems = sum(finding.get("state") == "problem" for finding in findings)
        text = f"{len(findings)} findings, {problems or 'no'} problem{'s' if problems > 1 else ''}"
        self._report("doctor", "failed" if problems else "done", text, findings=findings)
        return not problems and await self._service_runs()

    async def _service_runs(self) -> bool:
        """Whether the service has not ended since its start, as with a full disk; reports it if it has."""
        script = f"sh -c {shlex.quote(_SERVICE)}"
        output = await self._connection.run_as_root(script, "service")
        reason = ": ".join(output.splitlines())
        if reason:
            self._report("service", "failed", reason, "'journalctl -u lfield' on the robot shows more")
        return not reason


def _refused_from(steps: list[Step], first: Step, reason: str, advice: str) -> list[Step]:
    """The steps before `first`, and a refusal in place of the rest."""
    return [*steps[: steps.index(first)], Step("mission", "refused", reason, advice)]


async def update_refusal(connection: SshConnection, host: str) -> str:
    """The reason why another version of lfield may not become active on the robot; '' if it may, or none
    is there.
    """
    script = _CHECK.replace("HOST", shlex.quote(host))
    output = await connection.run_as_root(f"sh -c {shlex.quote(script)}", "mission")
    return "; ".join(line for line in output.splitlines() if line)


async def is_mission_running(connection: SshConnection) -> bool:
    """Whether hosts of a mission run on the robot, also of another user or started by hand."""
    output = await connection.run_as_root(f"sh -c {shlex.quote(_MISSIONS)}", "mission")
    answer, _, processes = output.rpartition("processes\t")
    try:
        listed = json.loads(answer)
    except ValueError:
        # The robot has no lfield yet, or it does not start.
        return bool(processes.strip())
    return not (isinstance(listed, dict) and listed.get("code") == "no-mission-running")
