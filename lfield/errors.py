"""The exceptions of lfield, one tree: each class has a stable `code`, and the exit status of a command.

`lfield/docs/messages.md` lists the codes with their meaning and remedy; it is generated from this file. Data
is kept in attributes; `str()` is one sentence: the problem, and the remedy.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from lfield import exit_status

if TYPE_CHECKING:
    from collections.abc import Sequence


class ReportableFinding(Protocol):
    """A finding with its position in a file (text/source_text.py: Diagnostic)."""

    @property
    def severity(self) -> str:
        """`error`, `warning` or `note`."""

    def render(self) -> str:
        """The finding as lines of text, without the last newline."""

    def as_data(self) -> dict[str, object]:
        """The finding as JSON data."""


class LfieldError(Exception):
    """A bug in lfield; also the root of the tree. `exit_status` is the status of a command that it ends."""

    exit_status = exit_status.SOFTWARE
    code, remedy = "bug", "run again with LFIELD_TRACEBACK=1 and report what it prints"

    def as_data(self) -> dict[str, object]:
        """The error as JSON data."""
        return {"error": str(self), "code": self.code}


class SystemRefusal(LfieldError):
    """The operating system refused a call: too many open files, a deleted working directory, a full disk."""

    code, remedy = "operating-system", "see the message"

    def __init__(self, status: int, reason: str) -> None:
        self.exit_status = status
        super().__init__(reason)


class UsageError(LfieldError):
    """The command line is invalid."""

    exit_status = exit_status.USAGE
    code, remedy = "usage", "lfield COMMAND --help"


class NoHomeFolder(UsageError):
    """The user has no home directory, and a file there is needed; `variable` can name a directory."""

    code, remedy = "no-home-directory", "set HOME, or the variable in the message, to an absolute path"

    def __init__(self, variable: str) -> None:
        self.variable = variable
        super().__init__(
            f"this user has no home folder: set HOME, or {variable}, to the absolute path of a folder"
        )


class ProgramError(LfieldError):
    """An L program, a deployment, a registry or an access file has errors: `diagnostics`, in source order."""

    exit_status = exit_status.DATA
    code, remedy = "program-errors", "correct each diagnostic; the code of each is in the second table"

    def __init__(self, diagnostics: Sequence[ReportableFinding]) -> None:
        self.diagnostics = tuple(diagnostics)
        count = len(self.diagnostics)
        super().__init__(f"{count} error{'s' if count != 1 else ''}")


class BindingError(LfieldError):
    """A devices file is invalid; `problems` has a sentence for each mistake.

    `findings` are the mistakes with a position in a file, in the order of the first `problems`. `cure` is a
    sentence with the remedy, or ''.
    """

    exit_status = exit_status.DATA
    code, remedy = "bindings", "correct the devices file; `lfield check MISSION` reports the same"
    cure = ""

    def __init__(self, problems: Sequence[str], findings: Sequence[ReportableFinding] = ()) -> None:
        self.problems, self.findings = tuple(problems), tuple(findings)
        super().__init__("; ".join(self.problems))


class DevicesError(BindingError):
    """The bindings are valid, but devices cannot be opened: no library, no port or no answer.

    `not_set_up` are the `problems` that `lfield setup` solves.
    """

    exit_status = exit_status.UNAVAILABLE
    code, remedy = "devices-unavailable", "`lfield doctor MISSION` diagnoses ports, permissions and devices"

    def __init__(self, problems: Sequence[str], not_set_up: Sequence[str] = ()) -> None:
        self.not_set_up = frozenset(not_set_up)
        super().__init__(problems)

    def cured_by(self, command: str) -> DevicesError:
        """This error with the command that sets up the devices in `not_set_up`."""
        cured = DevicesError(self.problems, tuple(self.not_set_up))
        cured.cure = f"to set it up: {command}" if self.not_set_up else ""
        return cured


class ConstraintError(LfieldError):
    """A condition over attributes is invalid; `problems` has a sentence for each mistake."""

    exit_status = exit_status.DATA
    code, remedy = "condition", "correct the condition"

    def __init__(self, text: str, problems: Sequence[str]) -> None:
        self.text, self.problems = text, tuple(problems)
        super().__init__(f'{"; ".join(self.problems)} (in "{text}")')


class ProgramFileError(LfieldError):
    """A compiled program is damaged, has another format version, or is refused by the verifier."""

    exit_status = exit_status.DATA
    code, remedy = "program-file", "build it again with `lfield build`"

    def __init__(self, reason: str, *, method: str = "", pc: int | None = None) -> None:
        self.reason, self.method, self.pc = reason, method, pc
        where = f" (in {method}, instruction {pc})" if method and pc is not None else ""
        super().__init__(f"not a valid L program: {reason}{where}; build it again with 'lfield build'")


class BundleError(LfieldError):
    """A bundle is damaged, has another format version, or is inconsistent."""

    exit_status = exit_status.DATA
    code, remedy = "bundle", "build it again with `lfield build`"

    def __init__(
        self, reason: str, advice: str = "build it again with 'lfield build'", *, file: str = ""
    ) -> None:
        self.reason, self.advice = reason, advice
        super().__init__(f"{file or 'this'} is not a valid bundle: {reason}; {advice}")

    def of(self, file: object) -> BundleError:
        """This error with the name of the file."""
        return BundleError(self.reason, self.advice, file=str(file))


class KeysError(LfieldError):
    """A key, a certificate or a certificate revocation list cannot be used."""

    exit_status = exit_status.DATA
    code, remedy = "keys", "`lfield keys show` prints the state of your keys"


class SignatureError(KeysError):
    """A bundle is not signed, its signature is invalid, or its signer has no permission to sign."""

    code, remedy = "signature", "sign the bundle with `lfield sign` and keys that may sign"


class BlockError(LfieldError):
    """The block of an agent is damaged or belongs to another program."""

    exit_status = exit_status.DATA
    code, remedy = "block", "none: the sender or the file is damaged; keep it and report it"

    def __init__(self, reason: str, *, word: int | None = None) -> None:
        self.reason, self.word = reason, word
        super().__init__(f"not a valid block: {reason}" + (f" (word {word})" if word is not None else ""))


class InputFileError(LfieldError):
    """A file cannot be read."""

    exit_status = exit_status.NO_INPUT
    code, remedy = "file-not-readable", "correct the path or its permissions"

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"cannot read {path}: {reason}")


class DamagedFileError(InputFileError):
    """A file can be read, and its contents are damaged or of another kind."""

    exit_status = exit_status.DATA
    code, remedy = "file-damaged", "name the right file, or restore it"


class MissionFileError(InputFileError):
    """A mission, area or parameter file is invalid: `file`, `reason`, and the item it is about.

    `item` is the item's number as shown by ground stations, None for the file as a whole; `where` names
    another place, such as `line 3`.
    """

    exit_status = exit_status.DATA
    code, remedy = "mission-file", "correct the file in the program that wrote it"

    def __init__(self, file: str, reason: str, *, item: int | None = None, where: str = "") -> None:
        self.file, self.item, self.where = file, item, where
        self.fault = reason
        place = f"item {item}" if item is not None else where
        super().__init__(file, f"{place}: {reason}" if place else reason)


class OutputFileError(LfieldError):
    """A file or stream cannot be written."""

    exit_status = exit_status.NO_OUTPUT
    code, remedy = "file-not-writable", "free disk space, or correct the path or its permissions"

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"cannot write {path}: {reason}")


class JournalError(LfieldError):
    """A journal cannot be opened or written: `path`, `reason`, and `advice` on the remedy."""

    exit_status = exit_status.NO_OUTPUT
    code, remedy = "journal", "check the disk; `lfield inspect JOURNAL` prints what can be read"

    def __init__(self, path: str, reason: str, advice: str = "") -> None:
        self.path, self.reason, self.advice = path, reason, advice
        super().__init__(f"cannot use the journal {path}: {reason}" + (f"; {advice}" if advice else ""))


class JournalInUse(JournalError):
    """Another process has the journal open; `process` is its id, 0 when that is unknown."""

    exit_status = exit_status.UNAVAILABLE
    code, remedy = "journal-in-use", "stop that process, or name another directory with --state"

    def __init__(self, path: str, process: int) -> None:
        self.process = process
        who = f"process {process}" if process else "another process"
        super().__init__(path, f"{who} has it open", "stop that process, or name another --state")


class ForeignJournal(JournalError):
    """The journal belongs to another deployment or computer, or has a newer format version."""

    exit_status = exit_status.DATA
    code, remedy = "journal-foreign", "name another directory with --state, or install the newer version"


class RecordingError(LfieldError):
    """A recording cannot be used: it is damaged, of a newer version, or of another mission."""

    exit_status = exit_status.DATA
    code, remedy = "recording", "see the message; `lfield replay` names the parts that can be used"


class WireError(LfieldError):
    """A peer violated the protocol between hosts; its link is closed."""

    exit_status = exit_status.PROTOCOL
    code, remedy = "protocol", "run the same version of lfield on all hosts"


class HandshakeError(LfieldError):
    """A peer has another protocol version, program, deployment or name, or is not a member of the team.

    `answered_by` is the host that answered at the address of another one, '' in all other cases.
    """

    exit_status = exit_status.PROTOCOL
    code, remedy = "handshake", "start all hosts with the same bundle, and check their addresses and keys"

    def __init__(self, reason: str, *, answered_by: str = "") -> None:
        self.answered_by = answered_by
        super().__init__(reason)


class CpuBudgetExceeded(WireError):
    """The messages of a member of the team take more processing time than its budget.

    `share` is its part of one processor; `closes`: its link is closed after `seconds` over budget.
    """

    code, remedy = "cpu-budget", "find out why that host sends so much; restart it"

    def __init__(self, share: float, seconds: float, *, closes: bool) -> None:
        self.share, self.seconds, self.closes = share, seconds, closes
        for_so_long = f" for {seconds:g} s" if closes else ""
        super().__init__(
            f"its messages took more than {share:.0%} of this computer's processor{for_so_long}, and more "
            "are queued"
        )


class AddressError(LfieldError):
    """An address cannot be bound or reached."""

    exit_status = exit_status.UNAVAILABLE
    code, remedy = "address", "correct the address in the inventory, or name it with --map HOST=ADDR:PORT"

    def __init__(self, address: str, reason: str) -> None:
        self.address, self.reason = address, reason
        super().__init__(f"cannot use {address}: {reason}")


class NoListener(AddressError):
    """No program listens at the address."""

    code, remedy = "no-listener", "start the host, or correct its address"

    def __init__(self, address: str) -> None:
        super().__init__(address, "no program listens there (is it running?)")


class MissingZenoh(AddressError):
    """An address is in a Zenoh fabric, and the package is not installed."""

    code, remedy = "zenoh-missing", "pip install 'lfield[zenoh]'"

    def __init__(self, address: str) -> None:
        super().__init__(address, "the package eclipse-zenoh is not installed: pip install 'lfield[zenoh]'")


class ZenohUnreachable(AddressError):
    """No router or peer of the Zenoh fabric can be reached; lfield retries."""

    code, remedy = "zenoh-unreachable", "start the router, or correct `zenoh` in the inventory"


class MissionTestError(LfieldError):
    """A mission test uses an object that does not exist, or an action that a test must not use."""

    exit_status = exit_status.USAGE
    code, remedy = "mission-test", "correct the test"


class Stuck(MissionTestError):
    """A mission test waits for an event that cannot occur; `standing` has the position of every agent."""

    code, remedy = "mission-test-stuck", "correct the program or the test"

    def __init__(self, waited: str, standing: Sequence[str]) -> None:
        self.standing = standing
        super().__init__("\n".join([waited, *(f"  {line}" for line in standing)]))


class RealEndpoint(MissionTestError):
    """Code under test tried to use a network, port or device of this computer."""

    code, remedy = "mission-test-real-device", "simulate the device, or give its agent a double"

    def __init__(self, what: str) -> None:
        self.what = what
        super().__init__(
            f"a mission test must not use real networks, ports or devices: {what}: "
            "simulate the device, or give its agent a double"
        )


class DoubleError(MissionTestError):
    """A test double of a resource does not fit the mission."""

    exit_status = exit_status.DATA
    code, remedy = "mission-test-double", "give the double the portals of its resource"


class NoMissionRunning(LfieldError):
    """No running mission matches the command."""

    exit_status = exit_status.UNAVAILABLE
    code, remedy = "no-mission-running", "start it with `lfield up`, or name the mission or the run"


class PortalCallError(LfieldError):
    """A portal call of a person has not returned: `portal` is AGENT.PORTAL, `reason` the reason.

    `kind` is the exception of L that it has thrown, or the code of the reason.
    """

    exit_status = exit_status.FAILED
    code, remedy = "portal-call", "see the message"

    def __init__(self, portal: str, kind: str, reason: str) -> None:
        self.portal, self.kind, self.reason = portal, kind, reason
        super().__init__(f"{portal}(): {kind}: {reason}" if kind else f"{portal}(): {reason}")

    def as_data(self) -> dict[str, object]:
        """The error as JSON data."""
        return {**super().as_data(), "portal": self.portal, "kind": self.kind}


class PortalCallRefused(PortalCallError):
    """The host has refused a portal call: it has not started."""

    code, remedy = "portal-call-refused", "open the portal in the access file, or call later"


class PortalFailed(PortalCallError):
    """A portal has thrown an exception, or its call was cancelled or has reached its time limit."""

    code, remedy = "portal-failed", "see the message; `lfield logs` has the lines of the resource"


class CallOutcomeUnknown(PortalCallError):
    """A portal may have been executed: its host has stopped or restarted, or is unreachable."""

    exit_status = exit_status.UNKNOWN_OUTCOME
    code, remedy = "portal-call-unknown", "check the state of the resource before calling again"


class CoordinatorAlive(LfieldError):
    """The coordinator is alive or may be alive, but the command requires that it has ended."""

    exit_status = exit_status.UNAVAILABLE
    code, remedy = "coordinator-alive", "wait for it, or stop its host first"


class HostFailure(LfieldError):
    """A bug in lfield, or lack of memory, stopped a host; `cause` is the exception."""

    code, remedy = "host-failure", "run again with LFIELD_TRACEBACK=1 and report what it prints"

    def __init__(self, host: str, cause: BaseException) -> None:
        self.host, self.cause = host, cause
        if isinstance(cause, MemoryError):
            self.reason = "out of memory; its devices go to their safe states"
        else:
            import traceback  # rarely needed, and every command starts faster without it

            frames = traceback.extract_tb(cause.__traceback__)
            where = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
            self.reason = (
                f"bug in lfield: {type(cause).__name__}: {cause}{where}; its devices go to their safe states"
            )
        super().__init__(f"{host} stopped: {self.reason}")


class EngineUnavailable(LfieldError):
    """wasmtime is installed and cannot be used; the reference engine runs the program."""

    code, remedy = "engine-unavailable", "see the message; programs run slower until then"

    def __init__(self, cause: BaseException) -> None:
        self.cause = cause
        why = str(cause).partition("\n")[0] or "not enough memory"
        super().__init__(f"wasmtime cannot be used: {why}")


class PluginError(LfieldError):
    """A driver is unknown or broken, or the library of its vendor is missing."""

    exit_status = exit_status.UNAVAILABLE
    code, remedy = "driver", "install the driver; `lfield driver list` prints the installed ones"


class DeviceError(PluginError):
    """A device refused a command, failed, or went away.

    `device` is its name in L (`fc`), `kind` the L exception that it becomes (`DeviceException`,
    `DeviceTimeoutException` or `CancelledException`), `reason` the device's own words.
    """

    code, remedy = "device", "see the message; `lfield doctor MISSION` diagnoses devices"

    def __init__(self, device: str, reason: str, *, kind: str = "DeviceException") -> None:
        self.device, self.reason, self.kind = device, reason, kind
        super().__init__(f"{device}: {reason}")


class DeviceNotSetUp(DeviceError):
    """Parameters of a device differ from those that its binding requires; the reason names each."""

    code, remedy = "device-not-set-up", "`lfield setup --deploy MISSION` writes them"


class ProvisionError(LfieldError):
    """A robot cannot be provisioned: `host` (empty: none of them), `reason`, and `advice` on the remedy."""

    exit_status = exit_status.UNAVAILABLE
    code, remedy = "provision", "follow the advice in the message, and run `lfield provision` again"

    def __init__(self, host: str, reason: str, advice: str = "") -> None:
        self.host, self.reason, self.advice = host, reason, advice
        super().__init__((f"{host}: " if host else "") + reason + (f"; {advice}" if advice else ""))
