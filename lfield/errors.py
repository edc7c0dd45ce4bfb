"""Every exception lfield raises on purpose.

    LfieldError
    ├── UsageError                the command line was wrong                                  64
    │   └── NoHome                a user without a home, where a folder in it is needed       64
    ├── ProgramError              an L program, deployment or access file has errors         65
    ├── BindingError              a devices file is wrong, or a device is missing             65
    │   └── DevicesError          devices that cannot be opened: no library, port or answer   69
    ├── ConstraintError           a condition over attributes that cannot be judged           65
    ├── ProgramFileError          not a program file, or one the verifier refused             65
    ├── BundleError               not a bundle, or one of another version                     65
    ├── KeysError                 keys, a certificate or a list that cannot be used           65
    │   └── SignatureError        a bundle that nobody has signed who may, or that was changed 65
    ├── BlockError                bytes that are not a sound block of this program            65
    ├── InputFileError            a file cannot be read                                       66
    ├── OutputFileError           a file cannot be written (full disk, no permission)         73
    ├── JournalError              a journal that cannot be written (full or broken disk)      73
    │   ├── JournalInUse          a journal that another process keeps                        69
    │   └── ForeignJournal        one of a newer version, another mission or computer         65
    ├── WireError                 bytes from a peer that break the protocol                   76
    ├── GreetingError             a peer that must not be talked to                           76
    ├── AddressError              a port in use, an address that is not ours                  69
    │   └── NobodyListens         an address where no program listens                         69
    ├── MissionTestError          a test of a mission asks for what there is not               64
    │   ├── DoubleError           a double that does not fit its mission                       65
    │   ├── RealEndpoint          a test of a mission touches what is real                     64
    │   └── Stuck                 what a test of a mission waits for does not come             64
    ├── NothingRuns               no mission that a command could be about                    69
    ├── CoordinatorAlive          a coordinator that is alive, or may be, and must not be     69
    ├── HostFailure               a bug in lfield that ended a host                           70
    └── PluginError               a driver is unknown, broken or lacks its vendor library     69
        └── DeviceError           a device refused, failed or went away
            └── NotSetUp          a device keeps settings that are not those its binding needs

The number is the exit status a command ends with when the exception reaches it (exits.py).
Data is kept in attributes; `str()` is one sentence that says what is wrong and what to do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from lfield import exits

if TYPE_CHECKING:
    from collections.abc import Sequence


class Finding(Protocol):
    """One thing found in a text, which can show itself with its place (text/source.py: Diagnostic)."""

    @property
    def severity(self) -> str:
        """`error`, `warning`, or `note`, which is neither."""

    def render(self) -> str:
        """The finding for a reader, in several lines without the last newline."""

    def as_data(self) -> dict[str, object]:
        """The finding for a program, as data that JSON can hold."""


class LfieldError(Exception):
    """Root of the tree; `exit_status` is what a command returns when nobody handles it."""

    exit_status = exits.SOFTWARE


class UsageError(LfieldError):
    """A command line that makes no sense; the message says how to write it."""

    exit_status = exits.USAGE


class NoHome(UsageError):
    """A folder of the user's own is needed, and nothing says where it is; `variable` could."""

    def __init__(self, variable: str) -> None:
        self.variable = variable
        super().__init__(
            f"this user has no home folder: set HOME, or {variable}, to the absolute path of a folder"
        )


class ProgramError(LfieldError):
    """An L program, a deployment, a registry or an access file with errors: all of them, in source order."""

    exit_status = exits.DATA

    def __init__(self, diagnostics: Sequence[Finding]) -> None:
        self.diagnostics = tuple(diagnostics)
        count = len(self.diagnostics)
        super().__init__(f"{count} error{'s' if count != 1 else ''}")


class BindingError(LfieldError):
    """A devices file that cannot be used; `problems` lists everything found wrong, a sentence each.

    `findings` are those of them that have a place in a text, the first ones in the same order.
    `cure` is one about what to do, for all of them, or ''.
    """

    exit_status = exits.DATA
    cure = ""

    def __init__(self, problems: Sequence[str], findings: Sequence[Finding] = ()) -> None:
        self.problems, self.findings = tuple(problems), tuple(findings)
        super().__init__("; ".join(self.problems))


class DevicesError(BindingError):
    """Devices that are bound well and cannot be opened now; `problems` lists all of them.

    `not_set_up` are those of the problems that `lfield setup` would solve.
    """

    exit_status = exits.UNAVAILABLE

    def __init__(self, problems: Sequence[str], not_set_up: Sequence[str] = ()) -> None:
        self.not_set_up = frozenset(not_set_up)
        super().__init__(problems)

    def cured_by(self, command: str) -> DevicesError:
        """The same, with the command that sets up what is not."""
        cured = DevicesError(self.problems, tuple(self.not_set_up))
        cured.cure = f"this sets it up: {command}" if self.not_set_up else ""
        return cured


class ConstraintError(LfieldError):
    """A condition over attributes with mistakes; `problems` lists everything found wrong, a sentence each."""

    exit_status = exits.DATA

    def __init__(self, text: str, problems: Sequence[str]) -> None:
        self.text, self.problems = text, tuple(problems)
        super().__init__(f'{"; ".join(self.problems)} (in "{text}")')


class ProgramFileError(LfieldError):
    """A program file that is damaged, of another version, or refused by the verifier."""

    exit_status = exits.DATA

    def __init__(self, reason: str, *, method: str = "", pc: int | None = None) -> None:
        self.reason, self.method, self.pc = reason, method, pc
        where = f" (in {method}, instruction {pc})" if method and pc is not None else ""
        super().__init__(f"not a sound L program: {reason}{where}; build it again with 'lfield build'")


class BundleError(LfieldError):
    """A mission in one file that is damaged, of another version, or makes no sense."""

    exit_status = exits.DATA

    def __init__(
        self, reason: str, advice: str = "build it again with 'lfield build'", *, file: str = ""
    ) -> None:
        self.reason, self.advice = reason, advice
        super().__init__(f"{file or 'this'} is not a sound bundle: {reason}; {advice}")

    def of(self, file: object) -> BundleError:
        """The same, of a file."""
        return BundleError(self.reason, self.advice, file=str(file))


class KeysError(LfieldError):
    """A key, a certificate or a revocation list that cannot be used; the message says what to do."""

    exit_status = exits.DATA


class SignatureError(KeysError):
    """A bundle without a signature, or with one that does not fit it, or of somebody who may not sign."""


class BlockError(LfieldError):
    """Bytes that are not a sound block: wrong magic, wrong program, or a reference that leads nowhere."""

    exit_status = exits.DATA

    def __init__(self, reason: str, *, word: int | None = None) -> None:
        self.reason, self.word = reason, word
        super().__init__(f"not a sound block: {reason}" + (f" (word {word})" if word is not None else ""))


class InputFileError(LfieldError):
    """A file that cannot be read."""

    exit_status = exits.NO_INPUT

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"cannot read {path}: {reason}")


class DamagedFileError(InputFileError):
    """A file that can be read and is not what it should be."""

    exit_status = exits.DATA


class OutputFileError(LfieldError):
    """A file or stream that cannot be written."""

    exit_status = exits.NO_OUTPUT

    def __init__(self, path: str, reason: str) -> None:
        self.path, self.reason = path, reason
        super().__init__(f"cannot write {path}: {reason}")


class JournalError(LfieldError):
    """A journal that cannot be opened or kept: `path` says which, `reason` why, `advice` what to do."""

    exit_status = exits.NO_OUTPUT

    def __init__(self, path: str, reason: str, advice: str = "") -> None:
        self.path, self.reason, self.advice = path, reason, advice
        super().__init__(f"cannot use the journal {path}: {reason}" + (f"; {advice}" if advice else ""))


class JournalInUse(JournalError):
    """A journal that another process keeps; `process` is its number, 0 when it is not known."""

    exit_status = exits.UNAVAILABLE

    def __init__(self, path: str, process: int) -> None:
        self.process = process
        who = f"process {process}" if process else "another process"
        super().__init__(path, f"{who} keeps it", "a host runs once: end that one, or name another --state")


class ForeignJournal(JournalError):
    """A journal that is sound and not ours to use: of a newer version, another deployment or computer."""

    exit_status = exits.DATA


class WireError(LfieldError):
    """Bytes from a peer that break the protocol; the link they came on is closed."""

    exit_status = exits.PROTOCOL


class GreetingError(LfieldError):
    """A peer of another protocol, program, deployment or name; the message says which."""

    exit_status = exits.PROTOCOL


class OverBudget(WireError):
    """A member of the team whose messages take more processing time than its budget.

    `ration` is its part of one processor; `closes` says that its link is closed, `seconds` over budget.
    """

    def __init__(self, ration: float, seconds: float, *, closes: bool) -> None:
        self.ration, self.seconds, self.closes = ration, seconds, closes
        for_so_long = f" for {seconds:g} s" if closes else ""
        super().__init__(
            f"its messages have taken more than {ration:.0%} of this computer's processor{for_so_long}, and "
            "more are waiting"
        )


class AddressError(LfieldError):
    """An address that cannot be listened on or reached."""

    exit_status = exits.UNAVAILABLE

    def __init__(self, address: str, reason: str) -> None:
        self.address, self.reason = address, reason
        super().__init__(f"cannot use {address}: {reason}")


class NobodyListens(AddressError):
    """An address at which no program listens: whoever did has ended, or was never there."""

    def __init__(self, address: str) -> None:
        super().__init__(address, "nobody listens there; is its host up?")


class MissionTestError(LfieldError):
    """A test of a mission asks for what there is not, or does what a test may not."""

    exit_status = exits.USAGE


class Stuck(MissionTestError):
    """What a test waits for does not come: `standing` says where every agent stands and what it waits for."""

    def __init__(self, waited: str, standing: Sequence[str]) -> None:
        self.standing = standing
        super().__init__("\n".join([waited, *(f"  {line}" for line in standing)]))


class RealEndpoint(MissionTestError):
    """Something under test wanted to use this computer's network, ports or devices."""

    def __init__(self, what: str) -> None:
        self.what = what
        super().__init__(
            f"a test of a mission touches nothing real, and {what}: "
            "give the device a fake, or its agent a double"
        )


class DoubleError(MissionTestError):
    """A double, which answers for a resource in the test of a mission, that does not fit the mission."""

    exit_status = exits.DATA


class NothingRuns(LfieldError):
    """No mission runs that a command could be about; the message says where was looked."""

    exit_status = exits.UNAVAILABLE


class CoordinatorAlive(LfieldError):
    """A coordinator that is alive, or may be, where that stands in the way; the message says where."""

    exit_status = exits.UNAVAILABLE


class HostFailure(LfieldError):
    """A bug in lfield, or want of memory, that ended a host: `cause` was raised, its traceback with it."""

    def __init__(self, host: str, cause: BaseException) -> None:
        self.host, self.cause = host, cause
        if isinstance(cause, MemoryError):
            super().__init__(f"{host} ends because there is no memory left; its devices are made safe")
            return
        frames = cause.__traceback__
        while frames is not None and frames.tb_next is not None:
            frames = frames.tb_next
        where = ""
        if frames is not None:
            where = f" at {frames.tb_frame.f_code.co_filename.rpartition('/')[2]}:{frames.tb_lineno}"
        super().__init__(
            f"{host} ends because of a bug in lfield itself: {type(cause).__name__}: {cause}{where}; "
            "its devices are made safe"
        )


class NoEngine(LfieldError):
    """Why wasmtime, which is installed, runs nothing here; the reference engine does."""

    def __init__(self, cause: BaseException) -> None:
        self.cause = cause
        why = str(cause).partition("\n")[0] or "there is not memory enough"
        super().__init__(f"wasmtime cannot be used: {why}")


class PluginError(LfieldError):
    """A driver plugin that is unknown, broken, or lacks its vendor library."""

    exit_status = exits.UNAVAILABLE


class DeviceError(PluginError):
    """A device refused a command, failed, or went away.

    `device` is its name in L (`fc`), `kind` the L exception it becomes (`DeviceException`,
    `DeviceTimeoutException` or `CancelledException`), `reason` the device's own words.
    """

    def __init__(self, device: str, reason: str, *, kind: str = "DeviceException") -> None:
        self.device, self.reason, self.kind = device, reason, kind
        super().__init__(f"{device}: {reason}")


class NotSetUp(DeviceError):
    """A device keeps settings that are not those its binding needs; the reason names each of them."""
