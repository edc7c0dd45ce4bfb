"""The command `lfield`: runs the subcommand, and turns errors into a sentence and an exit status."""

from __future__ import annotations

import argparse
import gc
import io
import os
import re
import signal
import sys
from collections.abc import Collection, Iterable, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from lfield import __version__, exit_status
from lfield.cli.action_help import action_help
from lfield.cli.os_errors import system_refusal
from lfield.errors import BindingError, LfieldError, ProgramError, UsageError
from lfield.text.nonblocking_output import discard_output
from lfield.text.terminal_escape import ESCAPES, escape, escape_indented, escaping_stream, printable_argument

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

#: Subcommands with their purpose; each is a module of a subpackage.
COMMANDS = {
    "new": "create a mission that runs at once on simulated devices",
    "check": "report errors and warnings in programs, deployments and bindings",
    "fmt": "format programs and deployments in place",
    "lsp": "serve an editor by the Language Server Protocol on stdin and stdout",
    "build": "compile a mission into one bundle, or a program into a program file",
    "keys": "create, renew, revoke and list the keys of a team",
    "sign": "sign a bundle",
    "disasm": "disassemble a program",
    "plan": "check and draw mission and area files of ground stations",
    "test": "run the tests of missions in virtual time and draw the tracks",
    "up": "run one host of a mission, or all hosts on this computer",
    "ps": "show the hosts and agents of running missions",
    "watch": "serve a web page that shows a running team and has an emergency stop",
    "events": "print the events of a mission's hosts, each with its cause",
    "logs": "print the log of a mission's programs and hosts",
    "query": "list the agents that provide a capability, and explain why others do not",
    "mcp": "serve an AI assistant by the Model Context Protocol on stdin and stdout",
    "capabilities": "show and check the registry of capabilities",
    "inventory": "show the hosts of the inventory, and check which of their addresses answer",
    "provision": "install lfield on the robots of the inventory, over ssh",
    "push": "send a bundle to all robots of its mission and activate it on all or none",
    "rollback": "activate the previous bundle on all robots or none",
    "status": "show bundle, version and mission of each robot, and why it refuses or waits",
    "stop": "stop the mission on all robots in order",
    "service": "run the permanent service of a robot: receives bundles, starts and stops missions",
    "estop": "emergency stop: put every device of a running mission in its safe state",
    "start": "start the mission on robots with services, or start coordinators that wait for a missing host",
    "pause": "pause a mission and put its devices in their safe states",
    "resume": "resume a paused mission",
    "forget": "end a coordinator that is in doubt, lost or suspended, so that no copy of it continues",
    "recover": "continue a coordinator on another host when its own host is permanently lost",
    "inspect": "print the contents of an agent dump, a host's journal, or a bundle",
    "debug": "debug recordings, or a mission in virtual time, forwards and backwards",
    "replay": "replay recordings of hosts and report the first difference",
    "export": "write the events and telemetry of a recording as MCAP or CSV",
    "doctor": "check ports, permissions, libraries, clock and devices",
    "driver": "list installed drivers, or create a new one",
    "setup": "write the required parameters into devices, or restore the old ones",
    "kit": "run a driver's conformance checks on a device",
    "sim": "run a simulated device, or inject faults into one",
}
_PACKAGES = {
    "development": (
        "new",
        "check",
        "fmt",
        "lsp",
        "build",
        "disasm",
        "test",
        "inspect",
        "capabilities",
        "keys",
        "sign",
        "plan",
    ),
    "debugging": ("debug",),
    "recordings": ("replay", "export"),
    "run": ("up",),
    "operations": (
        "ps",
        "watch",
        "events",
        "logs",
        "query",
        "mcp",
        "estop",
        "start",
        "pause",
        "resume",
        "forget",
        "recover",
    ),
    "fleet": ("inventory", "provision", "push", "rollback", "status", "stop", "service"),
    "device": ("doctor", "driver", "setup", "kit", "sim"),
}
#: The module of each subcommand.
MODULES = {name: f"lfield.cli.{package}.{name}" for package, names in _PACKAGES.items() for name in names}


#: The commands that end in order after a Ctrl-C, and their imports before that: msgspec crashes when a
#: KeyboardInterrupt comes while it makes a class. The kernel ends all other commands at once.
INTERRUPTIBLE = {
    "up": ("mission.bundle", "mission.build_cache", "operator.runs", "host.process.host_process"),
    "estop": ("operator.targets", "operator.safe_state_progress", "operator.runs"),
    "pause": ("operator.targets", "operator.safe_state_progress", "operator.runs"),
    "watch": ("operator.targets", "operator.runs", "client.team_watch"),
    "events": ("operator.targets", "operator.dashboard.event_feed", "operator.runs"),
    "logs": ("operator.targets", "operator.dashboard.event_feed", "operator.runs"),
    "doctor": ("operator.diagnostics", "mission.loader"),
    "setup": ("devices.device_setup", "mission.loader"),
    "test": ("mission.loader",),
    "debug": ("mission.loader", "replay.debugger.debugger", "replay.recording_files"),
    "kit": ("devices.conformance_run", "mission.device_selection"),
    "sim": ("driver.sims",),
    "provision": ("provision.host_provisioning", "provision.team_keys"),
}
_LONE_SURROGATE = re.compile(r"\\u(d[89a-f][0-9a-f]{2})")
#: The names that ROS 2 and other tools have for a command.
_OTHER_NAMES = {"run": "up", "launch": "up", "compile": "build", "validate": "check", "format": "fmt"}
#: The option that may be empty: an emergency stop needs no reason.
REASON = "--reason"


class Command(Protocol):
    """The interface of a subcommand's module."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the options."""

    def run(self, args: argparse.Namespace) -> int:
        """Run the command; returns the exit status. Raises LfieldError."""


class _Parser(argparse.ArgumentParser):
    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        # The method of argparse ignores a full disk.
        if message:
            (file or sys.stderr).write(message)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Allows options between the arguments of a list: `test -k charge A -x B`."""
        lists = any(not a.option_strings and a.nargs in ("*", "+") for a in self._actions)
        if not lists or self._is_intermixed:
            return super().parse_known_args(args, namespace)
        self._is_intermixed = True
        return self.parse_known_intermixed_args(args, namespace)

    #: Guards against recursion: the intermixed parser calls this method.
    _is_intermixed = False

    def _match_arguments_partial(self, actions: Any, arg_strings_pattern: str) -> list[int]:
        # Before Python 3.13.1, an absent optional argument is complete at the first option: MISSION of
        # `query Lift --files MISSION` would be unknown. It is left for the strings after the options ("O").
        counts: list[int] = super()._match_arguments_partial(actions, arg_strings_pattern)
        while counts and counts[-1] == 0 and "O" in arg_strings_pattern[sum(counts) :]:
            counts.pop()
        return counts

    def flags(self) -> set[str]:
        """The options without a value, of all subcommands."""
        found: set[str] = set()
        for action in self._actions:
            if action.nargs == 0:
                found.update(action.option_strings)
            elif isinstance(action.choices, dict):
                # Subcommands.
                found.update(*(each.flags() for each in action.choices.values()))
        return found

    def refuse(self, unknown: Sequence[str], args: argparse.Namespace) -> NoReturn:
        """Raise UsageError for arguments that the chosen subcommand does not have."""
        from lfield.text.suggestions import did_you_mean

        for action in self._actions:
            name = getattr(args, action.dest, "")
            if isinstance(action.choices, dict) and name in action.choices:
                action.choices[name].refuse(unknown, args)
        options = [option for action in self._actions for option in action.option_strings]
        hint = did_you_mean(unknown[0].partition("=")[0], options)
        self.error(f"unrecognized arguments: {' '.join(unknown)}{f': {hint}' if hint else ''}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        # argparse names all choices: for a misspelt command that are forty.
        if action.choices is None or value in action.choices:
            return
        from lfield.text.suggestions import MAX_LISTED, did_you_mean

        hint = did_you_mean(_OTHER_NAMES.get(value, value), map(str, action.choices))
        if hint is None and len([*action.choices]) <= MAX_LISTED:
            super()._check_value(action, value)
        raise argparse.ArgumentError(action, f"invalid choice: {value!r}{f': {hint}' if hint else ''}")

    def error(self, message: str) -> NoReturn:
        # argparse prints arguments as Python literals.
        message = _LONE_SURROGATE.sub(r"\\u{\1}", message)
        raise UsageError(f"{message} (see '{self.prog} --help')")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    _fill_streams()
    try:
        status = _dispatch(arguments)
        sys.stdout.flush()
        return status
    except LfieldError as error:
        return _report(error, arguments)
    except KeyboardInterrupt:
        return exit_status.INTERRUPTED
    except BrokenPipeError:
        # The reader of the output has exited.
        discard_output(sys.stdout)
        return exit_status.INPUT_OUTPUT
    except OSError as error:
        _flush_streams()
        return _report(system_refusal(error), arguments)
    except Exception as error:
        if os.environ.get("LFIELD_TRACEBACK"):
            raise
        return _report(LfieldError(f"bug in lfield: {type(error).__name__}: {error}"), arguments)


def _report(error: LfieldError, arguments: Sequence[str]) -> int:
    """Print an error, with --json also as an object on stdout; returns the exit status."""
    match error:
        case ProgramError():
            from lfield.text.message_tables import render_findings

            print(escape(render_findings(error.diagnostics)), file=sys.stderr)
        case BindingError():
            for line in filter(None, [*error.problems, error.cure]):
                _print_error(line)
    # The message of a BindingError repeats its problems.
    if not (isinstance(error, BindingError) and error.problems):
        _print_error(f"lfield: {error}")
    if type(error) is LfieldError:
        _print_error(f"lfield: {error.remedy}")
    if "--json" in arguments:
        import json

        try:
            print(json.dumps({**error.as_data(), "exit_status": error.exit_status}), flush=True)
        except OSError:
            discard_output(sys.stdout)
    return error.exit_status


def _fill_streams() -> None:
    """Open standard streams that were closed (`>&-`), and make all of them accept every text.

    A closed stderr is discarded; writing to a closed stdout fails, as on a full disk.
    """
    for name, mode in (("stdin", "r"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115  # never closed
    if sys.stdout is None:
        sys.stdout = open(os.open(os.devnull, os.O_RDONLY), "w", encoding="utf-8")  # noqa: SIM115  # never closed
    for stream in (sys.stdout, sys.stderr):
        # Other streams do not encode, or do it themselves.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=ESCAPES)
    sys.stdout, sys.stderr = escaping_stream(sys.stdout), escaping_stream(sys.stderr)


def _flush_streams() -> None:
    try:
        sys.stdout.flush()
    except OSError:
        # The output cannot be written.
        discard_output(sys.stdout)


def _print_error(text: str) -> None:
    """Print an error; text from programs, files and hosts is escaped."""
    print(escape_indented(text), file=sys.stderr)


def _refuse_empty(arguments: list[str], flags: Collection[str]) -> None:
    """Refuse empty arguments, which would mean all, or this directory. Raises UsageError.

    `flags` are the options without a value.
    """
    for before, argument in zip(["", *arguments], arguments, strict=False):
        option = before if not argument else argument[:-1] if re.fullmatch(r"--[a-z-]+=", argument) else None
        if option is None or option == REASON:
            continue
        is_value = option.startswith("-") and option not in flags
        subject = f"the value of {option}" if is_value else "an argument"
        raise UsageError(f"{subject} is empty; is a shell variable not set?")


def _dispatch(arguments: list[str]) -> int:
    parser = _Parser(prog="lfield", description="Run one program on a team of robots.", epilog=_STATUSES)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--version", action="version", version=f"lfield {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    chosen = next((argument for argument in arguments if not argument.startswith("-")), "")
    # The parsers of all forty commands take longer than many commands: they are for --help and mistakes only.
    for name in arguments[:1] if chosen in COMMANDS and arguments[0] == chosen else COMMANDS:
        subparser = commands.add_parser(name, **action_help(COMMANDS[name]))
        # Only the chosen command is imported, so that small commands start fast.
        if name == chosen:
            _command(name).add_arguments(subparser)
    _refuse_empty(arguments, parser.flags())
    try:
        args, unknown = parser.parse_known_args(arguments)
    except SystemExit:
        # --help or --version was printed; `main` flushes the output.
        return exit_status.DONE
    if unknown:
        parser.refuse(unknown, args)
    args, command = _printable_args(args), _command(args.command)
    # Until here a Ctrl-C ends the process (lfield/__main__.py).
    if args.command in INTERRUPTIBLE and signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        _import_all(INTERRUPTIBLE[args.command])
        signal.signal(signal.SIGINT, signal.default_int_handler)
    _enable_gc()
    return command.run(args)


def _import_all(modules: Iterable[str]) -> None:
    for module in modules:
        import_module(f"lfield.{module}")


def _enable_gc() -> None:
    """Enable Python's garbage collector, which `lfield/__main__.py` disables, for new objects."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def _printable_args(args: argparse.Namespace) -> argparse.Namespace:
    """The arguments as text that can be printed, stored and sent. File names stay as they are."""
    for name, value in vars(args).items():
        if isinstance(value, str):
            setattr(args, name, printable_argument(value))
        elif isinstance(value, list):
            setattr(
                args, name, [printable_argument(each) if isinstance(each, str) else each for each in value]
            )
    return args


def _command(name: str) -> Command:
    return import_module(MODULES[name])


_STATUSES = "exit statuses:\n" + "\n".join(
    f"  {n:>4}  {meaning}" for n, meaning in exit_status.MEANINGS.items()
)


if __name__ == "__main__":
    sys.exit(main())
