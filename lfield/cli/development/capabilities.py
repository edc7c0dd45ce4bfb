"""`lfield capabilities`: shows and checks the registry of capabilities."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.action_help import action_help
from lfield.errors import UsageError

if TYPE_CHECKING:
    from lfield.capability.model import Registry


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    tree = actions.add_parser("tree", **action_help("print the taxonomy with its L types"))
    tree.add_argument("id", metavar="ID", nargs="?", default="", help="print only the terms below this one")
    _add_mission(tree)
    show = actions.add_parser("show", **action_help("print a term, capability, attribute, provider or rule"))
    show.add_argument("name", metavar="NAME", help="name or id")
    show.add_argument("--L", dest="as_class", action="store_true", help="print the L class of a capability")
    show.add_argument(
        "--program", metavar="FILE.L", type=Path, help="with --L: the class as this program sees it"
    )
    _add_mission(show)
    check = actions.add_parser(
        "check", **action_help("report errors in registry files (default: the built-in registry)")
    )
    check.add_argument("files", metavar="FILE", nargs="*", type=Path, help="registry files, or a mission")
    check.add_argument("--alone", action="store_true", help="check without the built-in registry")
    check.add_argument(
        "--program", metavar="FILE.L", type=Path, help="also check against the resources of this program"
    )


def _add_mission(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--capabilities", metavar="FILE", type=Path, help="registry of a mission to include")


def run(args: argparse.Namespace) -> int:
    """Returns 0; `check` returns 65 when there are mistakes."""
    match args.action:
        case "tree":
            return _tree(args)
        case "show":
            return _show_class(args) if args.as_class else _show(args)
        case _:
            return _check(args)


def _registry(args: argparse.Namespace) -> Registry:
    """The registry with the parts of installed drivers, and of a mission if one is given."""
    from lfield.capability.registry_reader.registry_files import read_registry
    from lfield.driver.plugins import discover

    return read_registry(mission=args.capabilities, libraries=discover().capabilities)


# --- tree and show ------------------------------------------------------------------------------------


def _tree(args: argparse.Namespace) -> int:
    from lfield.cli.views.trees import print_tree
    from lfield.operator.registry.taxonomy import term_of, tree

    registry = _registry(args)
    term = term_of(registry, args.id) if args.id else None
    if args.id and term is None:
        raise _unknown(registry, args.id)
    if term is None:
        print(f"taxonomy, version {registry.version}")
    print_tree(tree(registry, term.id if term is not None else ""))
    return 0


def _show(args: argparse.Namespace) -> int:
    from lfield.operator.registry.sheets import describe, in_terminal

    if args.program is not None:
        raise UsageError("--program is for the class of a capability: give --L too")
    registry = _registry(args)
    sheets = describe(registry, args.name)
    if not sheets:
        raise _unknown(registry, args.name)
    print("\n\n".join("\n".join(in_terminal(sheet)) for sheet in sheets))
    return 0


def _show_class(args: argparse.Namespace) -> int:
    """The class of a capability, for a program or for one that has all resources of the registry."""
    from lfield.capability.program_types.class_generator import UsableRealisations, class_text
    from lfield.capability.program_types.registry_types import RegistryTypes
    from lfield.driver.plugins import discover
    from lfield.errors import ProgramError
    from lfield.mission.registry_check import program_files
    from lfield.text.source_text import Diagnostics

    registry = _registry(args)
    if args.name not in registry.primitives:
        raise _unknown(registry, args.name)
    if args.program is None:
        print(class_text(UsableRealisations(registry, registry.providers), args.name), end="")
        return 0
    found = Diagnostics()
    files = program_files(args.program, discover(), found)
    if found.errors:
        raise ProgramError(found.errors)
    generated = RegistryTypes(lambda: registry).generate([args.name], files).classes
    if args.name not in generated:
        raise UsageError(f"{args.program} has a unit '{args.name}' of its own, which hides the capability")
    print(generated[args.name].text, end="")
    return 0


def _unknown(registry: Registry, name: str) -> UsageError:
    from lfield.operator.registry.taxonomy import unknown_name

    return UsageError(f"the registry has no '{name}': {unknown_name(registry, name)}")


# --- check --------------------------------------------------------------------------------------------


def _check(args: argparse.Namespace) -> int:
    from lfield.mission.registry_check import check_registry
    from lfield.text.message_tables import tally

    if args.alone and not args.files:
        raise UsageError("--alone is for files of your own: name them")
    found = check_registry(args.files, alone=args.alone, program=args.program)
    for finding in found:
        print(finding.render(), file=sys.stderr)
    errors, warnings = (sum(d.severity == kind for d in found) for kind in ("error", "warning"))
    if errors:
        print(f"lfield: {tally(errors, warnings)}", file=sys.stderr)
        return exit_status.DATA
    print(tally(errors, warnings))
    return 0
