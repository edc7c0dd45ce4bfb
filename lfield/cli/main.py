"""The command `lfield`: finds the subcommand, runs it, makes failures a sentence and a status (exits.py)."""

from __future__ import annotations

import argparse
import io
import os
import re
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, NoReturn, Protocol

from lfield import __version__, exits
from lfield.cli.of_the_system import of_the_system
from lfield.errors import BindingError, LfieldError, ProgramError, UsageError
from lfield.text.outlet import silence
from lfield.text.visible import ESCAPES, as_text, continued, on_terminal, visible

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

#: Subcommands, each a module of a room of this package, and what they are for.
COMMANDS = {
    "check": "report errors and warnings in programs, deployments and bindings",
    "build": "compile a mission into one bundle, or a program into a program file",
    "keys": "create, renew, revoke and list the keys of a team",
    "sign": "sign a bundle",
    "disasm": "disassemble a program",
    "test": "run the tests of missions in virtual time and draw the tracks",
    "up": "run one host of a mission, or all hosts on this computer",
    "ps": "show the hosts and agents of running missions",
    "watch": "serve a web page that shows a running team, with an emergency stop",
    "events": "print the events of a mission's hosts, with the cause of each",
    "logs": "print the log of a mission's programs and hosts",
    "query": "list the agents that provide a capability, and why others do not",
    "capabilities": "show and check the registry of capabilities",
    "estop": "emergency stop: put every device of a running mission in its safe state",
    "start": "start waiting coordinators without the hosts that are missing",
    "pause": "pause a mission and put its devices in their safe states",
    "resume": "resume a paused mission",
    "forget": "terminate a coordinator that is in doubt, lost or suspended",
    "recover": "continue a coordinator on another host after its host is permanently lost",
    "inspect": "print the contents of an agent dump, a host's journal, or a bundle",
    "doctor": "diagnose ports, permissions, libraries, clock and devices",
    "driver": "list installed drivers, or create a new one",
    "setup": "write the parameters that the bindings require to devices, or restore the old ones",
    "kit": "run a driver's conformance tests on a device",
    "sim": "run a simulated device, or inject faults into one",
}
_ROOMS = {
    "desk": ("check", "build", "disasm", "test", "inspect", "capabilities", "keys", "sign"),
    "run": ("up",),
    "team": (
        "ps",
        "watch",
        "events",
        "logs",
        "query",
        "estop",
        "start",
        "pause",
        "resume",
        "forget",
        "recover",
    ),
    "robot": ("doctor", "driver", "setup", "kit", "sim"),
}
#: The module of every subcommand.
MODULES = {name: f"lfield.cli.{room}.{name}" for room, names in _ROOMS.items() for name in names}


#: The commands that a Ctrl-C lets end in order, by an exception, and what they import first: msgspec crashes
#: when one comes while it makes a class. All others leave nothing behind; the system ends them at once.
ORDERLY = {
    "up": ("mission.bundle", "mission.cache", "operator.runs", "host.process.run"),
    "estop": ("operator.addressed", "operator.descent", "operator.runs"),
    "pause": ("operator.addressed", "operator.descent", "operator.runs"),
    "watch": ("operator.addressed", "operator.runs", "operator.sight.watched"),
    "events": ("operator.addressed", "operator.sight.listening", "operator.runs"),
    "logs": ("operator.addressed", "operator.sight.listening", "operator.runs"),
    "doctor": ("operator.doctor", "mission.load"),
    "setup": ("devices.setup", "mission.load"),
    "test": ("mission.load",),
    "kit": ("devices.try_out", "mission.one_device"),
    "sim": ("driver.sims",),
}
_HALF = re.compile(r"\\u(d[89a-f][0-9a-f]{2})")
#: What may be empty: no emergency stop is refused for want of a reason.
REASON = "--reason"


class Command(Protocol):
    """What a module of a subcommand provides."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare its options."""

    def run(self, args: argparse.Namespace) -> int:
        """Do it; returns the exit status. Raises LfieldError."""


class _Parser(argparse.ArgumentParser):
    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        # argparse's own says nothing of a full disk.
        if message:
            (file or sys.stderr).write(message)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Options may stand between the words of a list: `test -k charge A -x B`. argparse's own takes none
        of the list after that."""
        lists = any(not a.option_strings and a.nargs in ("*", "+") for a in self._actions)
        if not lists or self._intermixes:
            return super().parse_known_args(args, namespace)
        self._intermixes = True
        return self.parse_known_intermixed_args(args, namespace)

    #: Whether that is under way, which asks for both halves in turn.
    _intermixes = False

    def error(self, message: str) -> NoReturn:
        # argparse shows words as Python writes them.
        message = _HALF.sub(r"\\u{\1}", message)
        raise UsageError(f"{message} (see '{self.prog} --help')")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    _fill_streams()
    try:
        status = _dispatch(words)
        sys.stdout.flush()
        return status
    except ProgramError as error:
        print(visible("\n".join(d.render() for d in error.diagnostics)), file=sys.stderr)
        _tell(f"lfield: {error}")
        return error.exit_status
    except BindingError as error:
        for line in filter(None, [*error.problems, error.cure]):
            _tell(line)
        _tell(f"lfield: {len(error.problems)} problem(s) with the devices")
        return error.exit_status
    except LfieldError as error:
        _tell(f"lfield: {error}")
        return error.exit_status
    except KeyboardInterrupt:
        return exits.INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has left.
        silence(sys.stdout)
        return exits.INPUT_OUTPUT
    except OSError as error:
        _let_out()
        status, told = of_the_system(error)
        _tell(f"lfield: {told}")
        return status
    except Exception as error:
        if os.environ.get("LFIELD_TRACEBACK"):
            raise
        _tell(f"lfield: a bug in lfield itself: {type(error).__name__}: {error}")
        _tell("lfield: run again with LFIELD_TRACEBACK=1 and report what it prints")
        return exits.SOFTWARE


def _fill_streams() -> None:
    """Of standard streams that were closed (`>&-`) Python has none; those that are there take every text.

    What is said to stderr goes nowhere then; what is printed cannot be written, as on a full disk.
    """
    for name, mode in (("stdin", "r"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115  # never closed
    if sys.stdout is None:
        sys.stdout = open(os.open(os.devnull, os.O_RDONLY), "w", encoding="utf-8")  # noqa: SIM115  # never closed
    for stream in (sys.stdout, sys.stderr):
        # A stream of another kind encodes nothing, or by itself.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=ESCAPES)
    sys.stdout, sys.stderr = on_terminal(sys.stdout), on_terminal(sys.stderr)


def _let_out() -> None:
    try:
        sys.stdout.flush()
    except OSError:
        # It is the output that cannot be written.
        silence(sys.stdout)


def _tell(text: str) -> None:
    """An error may repeat what a program, a file or a host has said."""
    print(continued(text), file=sys.stderr)


def _refuse_empty(words: list[str]) -> None:
    """An empty word names nothing; taken for none, it would mean all, or this folder. Raises UsageError."""
    for before, word in zip(["", *words], words, strict=False):
        option = before if not word else word[:-1] if re.fullmatch(r"--[a-z-]+=", word) else None
        if option is None or option == REASON:
            continue
        what = f"the value of {option}" if option.startswith("-") else "a word of the command line"
        raise UsageError(f"{what} is empty; is it a variable of the shell that is not set?")


def _dispatch(words: list[str]) -> int:
    _refuse_empty(words)
    parser = _Parser(prog="lfield", description="Run one program on a team of robots.", epilog=_STATUSES)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--version", action="version", version=f"lfield {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    chosen = next((word for word in words if not word.startswith("-")), "")
    for name, purpose in COMMANDS.items():
        subparser = commands.add_parser(name, help=purpose, description=purpose.capitalize() + ".")
        # Only the chosen command is imported: a small command starts fast, whatever the others need.
        if name == chosen:
            _command(name).add_arguments(subparser)
    try:
        args = _in_text(parser.parse_args(words))
    except SystemExit:
        # --help or --version has been answered: whether the answer got out is for `main` to see.
        return exits.DONE
    command = _command(args.command)
    # Until here it ends the process (lfield/__main__.py).
    if args.command in ORDERLY and signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        for module in ORDERLY[args.command]:
            import_module(f"lfield.{module}")
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return command.run(args)


def _in_text(args: argparse.Namespace) -> argparse.Namespace:
    """What was said, as text that can be printed, kept and sent. What names a file stays as it is."""
    for name, value in vars(args).items():
        if isinstance(value, str):
            setattr(args, name, as_text(value))
        elif isinstance(value, list):
            setattr(args, name, [as_text(each) if isinstance(each, str) else each for each in value])
    return args


def _command(name: str) -> Command:
    return import_module(MODULES[name])


_STATUSES = "exit statuses:\n" + "\n".join(f"  {n:>4}  {words}" for n, words in exits.MEANINGS.items())


if __name__ == "__main__":
    sys.exit(main())
