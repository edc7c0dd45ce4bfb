"""`lfield keys`: the authority of a team, and the keys that it makes for hosts and persons."""

from __future__ import annotations

import argparse
import os
import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.cli.action_help import action_help
from lfield.errors import KeysError, UsageError
from lfield.text.number_arguments import whole_between

if TYPE_CHECKING:
    from lfield.authority.identity import Identity, Right
    from lfield.authority.ledger import LedgerKeys
    from lfield.authority.web_ca.web_certificates import IssuedWebKeys

#: Validity in days: the authority longer than the keys that it issues.
_AUTHORITY_DAYS, _DAYS, _MAX_DAYS = 3650, 365, 36500
_AUTHORITY_HELP = "directory of the authority (default: $LFIELD_AUTHORITY, or ~/.config/lfield/authority)"
#: Browsers reject a certificate that is valid for longer.
_MAX_PAGE_DAYS = 398


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    _add_init(actions.add_parser("init", **action_help("create the certificate authority of a team")))
    host = actions.add_parser(
        "host", **action_help("create the keys of hosts, with the names that they have in the deployment")
    )
    host.add_argument("names", metavar="NAME", nargs="+", help="names of hosts")
    person = actions.add_parser("person", **action_help("create the keys of a person"))
    person.add_argument("names", metavar="NAME", nargs=1, help="name of the person")
    person.add_argument(
        "--may",
        metavar="RIGHT,...",
        required=True,
        help="rights: observe (status, ps, logs, events, inventory check); stop (estop, pause; includes "
        "observe); operate (resume, estop --lift, forget, recover, start without services; includes stop); "
        "command (push, rollback, start and stop with services, sign; includes no other right: add observe)",
    )
    page = actions.add_parser(
        "page", **action_help("create the keys of a web page on a network, for 'lfield watch --listen'")
    )
    page.add_argument(
        "names", metavar="ADDRESS", nargs="+", help="addresses or names at which browsers open the page"
    )
    renew = actions.add_parser(
        "renew", **action_help("renew keys; the old certificate remains valid until it expires")
    )
    renew.add_argument("what", choices=("host", "person", "authority"), help="owner of the keys")
    renew.add_argument("names", metavar="NAME", nargs="*", help="names of hosts or persons")
    renew.add_argument(
        "--new-key",
        action="store_true",
        help="also create a new private key, which must then be copied to its computer",
    )
    revoke = actions.add_parser("revoke", **action_help("add keys to the revocation list"))
    revoke.add_argument("what", choices=("host", "person", "serial"), help="what NAME is")
    revoke.add_argument(
        "names", metavar="NAME", nargs=1, help="name of a host or person, or serial number of one certificate"
    )
    listed = actions.add_parser("list", **action_help("list all certificates that the authority has issued"))
    show = actions.add_parser("show", **action_help("show the owner, rights and validity of keys"))
    show.add_argument(
        "folder",
        metavar="DIR",
        nargs="?",
        type=Path,
        help="directory with keys (default: all keys on this computer)",
    )
    for each in (host, person, renew):
        _add_days(each, _DAYS)
    _add_days(page, _DAYS, _MAX_PAGE_DAYS)
    for each in (host, person, page, renew, revoke, listed):
        each.add_argument(
            "--authority",
            metavar="DIR",
            type=Path,
            help=_AUTHORITY_HELP,
        )


def _add_init(init: argparse.ArgumentParser) -> None:
    init.add_argument("folder", metavar="DIR", nargs="?", type=Path, help=_AUTHORITY_HELP)
    init.add_argument(
        "--person",
        metavar="NAME",
        help="also create keys for this person with the rights operate and command, and install them on "
        "this computer",
    )
    _add_days(init, _AUTHORITY_DAYS)


def _add_days(parser: argparse.ArgumentParser, default: int, maximum: int = _MAX_DAYS) -> None:
    parser.add_argument(
        "--days",
        metavar="N",
        type=whole_between(1, maximum, "days"),
        help=f"validity in days (default: {default})",
    )


def run(args: argparse.Namespace) -> int:
    """Returns 0; `show` returns 69 when some of the keys cannot be used."""
    match args.action:
        case "init":
            return _init(args)
        case "host" | "person":
            return _make(args)
        case "page":
            return _make_page(args)
        case "renew":
            return _renew(args)
        case "revoke":
            return _revoke(args)
        case "list":
            return _list(args)
        case _:
            return _show(args)


def _authority(named: Path | None) -> Path:
    from lfield.authority.keystore import authority_folder

    return named or authority_folder(os.environ)


def _ends(args: argparse.Namespace, at: float, default: int = _DAYS) -> float:
    return at + (args.days or default) * 86400.0


# --- making -----------------------------------------------------------------------------------------------


def _init(args: argparse.Namespace) -> int:
    from lfield.authority.ledger import KEY, create_ledger
    from lfield.authority.peer_verification import format_time

    if args.person is not None:
        _require_new_person(args.person)
    at = time.time()
    ledger = create_ledger(_authority(args.folder), at, _ends(args, at, _AUTHORITY_DAYS))
    authority = ledger.authority
    until = format_time(authority.valid_until)
    print(f"{ledger.folder}: the authority {authority.fingerprint[:12]}, until {until}")
    print(f"{KEY} can issue keys with every right: keep its directory private, and back it up")
    if args.person is not None:
        _make_own_keys(ledger.folder, args.person, at)
        print("next: 'lfield provision' makes the keys of the hosts in the inventory, and installs them")
        return 0
    print("next: 'lfield keys host NAME ...' for the hosts, 'lfield keys person NAME --may ...' for yourself")
    return 0


def _own_folder() -> Path:
    from lfield.authority.keystore import OWN
    from lfield.text.user_dirs import config_dir

    return config_dir() / "keys" / OWN


def _require_new_person(name: str) -> None:
    """Refuse before an authority is made: keys of another team would be lost. Raises KeysError."""
    from lfield.authority.ledger import require_name

    require_name(name)
    if (_own_folder() / "person.key").exists():
        raise KeysError(f"{_own_folder()} has keys already: move them away, or leave out --person")


def _make_own_keys(authority: Path, name: str, at: float) -> None:
    """Make the keys of this user, with all rights of a person, where commands find them."""
    from lfield.authority.identity import Right, sorted_rights
    from lfield.authority.keystore import read_keys, write_keys
    from lfield.authority.ledger import open_ledger
    from lfield.authority.peer_verification import format_time

    with open_ledger(authority) as ledger:
        identity, folder = ledger.make(
            "person", name, (Right.OPERATE, Right.COMMAND), at, at + _DAYS * 86400.0
        )
    write_keys(_own_folder(), read_keys(folder, "person"))
    until = format_time(identity.valid_until)
    print(f"{_own_folder()}: your keys, {identity}: until {until}, may {sorted_rights(identity.may)}")


def _make(args: argparse.Namespace) -> int:
    from lfield.authority.ledger import open_ledger

    may = _rights(args.may) if args.action == "person" else ()
    at = time.time()
    with open_ledger(_authority(args.authority)) as ledger:
        for name in args.names:
            _print_keys(ledger.make(args.action, name, may, at, _ends(args, at)))
    return 0


def _rights(names: str) -> tuple[Right, ...]:
    from lfield.authority.identity import Right
    from lfield.text.suggestions import did_you_mean, listed

    named = [right for right in (part.strip() for part in names.split(",")) if right]
    for right in named:
        if right not in list(Right):
            hint = did_you_mean(right, list(Right))
            raise UsageError(f"--may {right}: rights are {listed(Right)}" + (f"; {hint}" if hint else ""))
    if not named:
        raise UsageError(f"--may names no right: rights are {listed(Right)}")
    return tuple(map(Right, named))


def _print_keys(keys: LedgerKeys) -> None:
    """Print the keys that were made, and their destinations."""
    from lfield.authority.identity import sorted_rights
    from lfield.authority.keystore import OWN
    from lfield.authority.peer_verification import format_time

    identity, path = keys
    may = f", may {sorted_rights(identity.may)}" if identity.kind == "person" else ""
    print(f"{identity}: until {format_time(identity.valid_until)}{may}")
    folder = identity.name if identity.kind == "host" else OWN
    quoted = shlex.quote(str(path))
    if identity.kind == "host":
        print(f"  on {folder}, for a user:      ~/.config/lfield/keys/{folder}   a copy of {quoted}")
        print(f"  on {folder}, for the service: /etc/lfield/keys/{folder}, owned by the service's user")
    else:
        print(f"  on the computer of {identity}: ~/.config/lfield/keys/{folder}, a copy of {quoted}")


def _make_page(args: argparse.Namespace) -> int:
    from lfield.authority.ledger import open_ledger
    from lfield.authority.web_ca.web_certificates import issue_web_keys

    at = time.time()
    with open_ledger(_authority(args.authority)) as ledger:
        _print_page(issue_web_keys(ledger, args.names, at, _ends(args, at)))
    return 0


def _print_page(issued: IssuedWebKeys) -> None:
    """Print the keys, their use, and the steps in a browser."""
    from lfield.authority.peer_verification import format_time

    quoted = shlex.quote(str(issued.folder))
    print(f"page {', '.join(issued.keys.names)}: until {format_time(issued.keys.valid_until)}")
    print(f"  lfield watch --listen {issued.keys.names[0]} --page-keys {quoted} --deploy MISSION")
    root = shlex.quote(str(issued.root))
    print(f"  once for each browser: import {root} as an authority for web sites")
    print("  on a phone: install that file as a CA certificate (iOS: as a profile, and then trust it)")


def _renew(args: argparse.Namespace) -> int:
    from lfield.authority.ledger import open_ledger
    from lfield.authority.peer_verification import format_time

    if bool(args.names) == (args.what == "authority"):
        raise UsageError("name the keys to renew: host NAME ..., person NAME ..., or authority")
    at = time.time()
    with open_ledger(_authority(args.authority)) as ledger:
        if args.what == "authority":
            ledger.renew_authority(at, _ends(args, at, _AUTHORITY_DAYS))
            print(
                f"the authority {ledger.authority.fingerprint[:12]}: until "
                f"{format_time(ledger.authority.valid_until)}"
            )
            print("  nothing has to be copied: issued keys stay valid, and hosts trust the new certificate")
            return 0
        for name in args.names:
            _print_keys(ledger.renew(args.what, name, at, _ends(args, at), new_key=args.new_key))
    return 0


def _revoke(args: argparse.Namespace) -> int:
    from lfield.authority.key_material import REVOKED
    from lfield.authority.ledger import open_ledger

    (name,), at = args.names, time.time()
    with open_ledger(_authority(args.authority)) as ledger:
        if args.what == "serial":
            revoked = ledger.revoke_serial(name, at)
        else:
            revoked = ledger.revoke(args.what, name, at)
        for identity in revoked:
            print(f"{identity}: certificate {identity.serial[:12]} is revoked")
        path = shlex.quote(str(ledger.folder / REVOKED))
        print(f"list {ledger.revoked.number} is {path}: copy it into your own keys, or those of a host,")
        print("and hosts forward it to each other; an unreachable host does not receive it")
    return 0


# --- looking ----------------------------------------------------------------------------------------------


def _list(args: argparse.Namespace) -> int:
    from lfield.authority.ledger import open_ledger
    from lfield.authority.peer_verification import format_time

    at = time.time()
    with open_ledger(_authority(args.authority)) as ledger:
        authority = ledger.authority
        until = format_time(authority.valid_until)
        print(f"{ledger.folder}: the authority {authority.fingerprint[:12]}, until {until}")
        rows = ledger.rows(at)
        if ledger.revoked.number:
            print(f"revoked: {ledger.revoked}")
    for identity, state in rows:
        until = format_time(identity.valid_until)
        print(f"  {state:<8}{identity.serial[:12]:<14}until {until}  {_described(identity)}")
    return 0


def _described(identity: Identity) -> str:
    from lfield.authority.identity import sorted_rights

    rights = f", may {sorted_rights(identity.may) or 'nothing'}" if identity.kind == "person" else ""
    return f"{identity}{rights}"


def _show(args: argparse.Namespace) -> int:
    from lfield import exit_status
    from lfield.authority.keystore import local_folders
    from lfield.operator.key_health import health

    found = local_folders(os.environ) if args.folder is None else [args.folder]
    if not found:
        raise KeysError(
            "there are no keys on this computer: 'lfield keys init' begins, or copy a folder here"
        )
    findings = [finding for folder in found for finding in health(folder, time.time())]
    for finding in findings:
        print(f"{finding.what}" + (f"\n  -> {finding.cure}" if finding.cure else ""))
        for line in finding.details:
            print(f"  {line}")
    return (
        exit_status.UNAVAILABLE
        if any(finding.state == "problem" for finding in findings)
        else exit_status.DONE
    )
