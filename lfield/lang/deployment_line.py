"""One line of a deployment file: `//Type:id@host[:port][?argument&argument]`, or `//@host[:port]`.

`startable` and a space before an agent mark a coordinator that the program starts (decision 105).
"""

from __future__ import annotations

import re
from ipaddress import IPv4Address, IPv6Address
from urllib.parse import unquote_to_bytes

from msgspec import Struct

from lfield.lang import messages
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Diagnostics, Span

_COMMENT = re.compile(r"(?:^|(?<=\s))#")
_NAME = re.compile(r"[A-Za-z0-9._-]+", re.ASCII)
_TYPE = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_ESCAPE = re.compile(r"%(?![0-9a-fA-F]{2}).{0,2}", re.DOTALL)
_STARTABLE = re.compile(r"startable[ \t]+")
_LONGEST_HOST = 253
_HIGHEST_PORT = 65535


class DeploymentEntry(Struct, frozen=True):
    """The parts of a line with their places; `port_span` is the port, or the host without one.

    The line of a witness, a host without agents, has an empty type and id. `startable` is that word, empty
    for an agent that starts with its host.
    """

    span: Span
    type: Span
    id: Span
    host: Span
    port: int | None
    port_span: Span
    arguments: tuple[str, ...]
    startable: Span

    @property
    def is_witness(self) -> bool:
        """Whether the line only names a host."""
        return not self.type.text


def _is_ipv6(host: str) -> bool:
    """`[::1]`, `[fe80::1%wlan0]`: the brackets keep its colons apart from that of the port."""
    try:
        zone = IPv6Address(host[1:-1]).scope_id
    except ValueError:
        return False
    return host[0] + host[-1] == "[]" and (zone is None or _NAME.fullmatch(zone) is not None)


def is_address(host: str) -> bool:
    """Whether a host is an IP address and not a name."""
    try:
        IPv4Address(host)
    except ValueError:
        return _is_ipv6(host)
    return True


def _host_hint(host: str) -> str | None:
    """The mistake in a host of valid characters; None if it is valid."""
    if re.fullmatch(r"[0-9]+(\.+[0-9]*)+", host) and not is_address(host):
        return "an IPv4 address has four numbers from 0 to 255, as in 192.168.1.5"
    if host.startswith(".") or ".." in host:
        return "a host name has letters or digits before and after each dot"
    return None


class _Malformed(Exception):
    """The line cannot be split; it is reported."""


def read_line(line: Span, diagnostics: Diagnostics) -> DeploymentEntry | None:
    """The entry of a line; None for an empty line, a comment, or a line with mistakes (reported)."""
    comment = _COMMENT.search(line.text)
    whole = _trimmed(_part(line, 0, comment.start() if comment else len(line.text)))
    if not whole.text:
        return None
    before = len(diagnostics.found)
    try:
        entry = _Reader(diagnostics).entry(whole)
    except _Malformed:
        return None
    return entry if len(diagnostics.found) == before else None


class _Reader:
    """Splits one line and checks each part; every invalid part is reported."""

    def __init__(self, found: Diagnostics) -> None:
        self.found = found

    def entry(self, whole: Span) -> DeploymentEntry:
        """The parts of the line."""
        marked = _STARTABLE.match(whole.text)
        startable = _part(whole, 0, len("startable") if marked else 0)
        whole = _part(whole, marked.end() if marked else 0, len(whole.text))
        space = re.search(r"\s", whole.text)
        if space is not None:
            self.report(messages.DEPLOY_SPACE, _part(whole, space.start(), space.end()))
            raise _Malformed
        body = self.strip_scheme(whole)
        if body.text.startswith("@"):
            if startable.text:
                self.problem(startable, "a witness has no agents, so it has none that is startable")
            return self.witness(whole, body)
        place, _, _ = body.text.partition("?")
        agent = _part(body, 0, len(place))
        kind, rest = self.split(agent, ":", "no ':' after the type")
        name, address = self.split(rest, "@", "no '@' after the id")
        if not _TYPE.fullmatch(kind.text):
            self.problem(
                kind, f"'{kind.text}' is not the name of a type" if kind.text else "no type before ':'"
            )
        if not _NAME.fullmatch(name.text):
            self.report(messages.DEPLOY_ID, name, id=name.text)
        host, port_span, port = self.address(address)
        arguments = self.arguments(_part(body, len(place) + 1, len(body.text)))
        return DeploymentEntry(whole, kind, name, host, port, port_span, arguments, startable)

    def witness(self, whole: Span, body: Span) -> DeploymentEntry:
        """The line of a host without agents."""
        nothing = _part(body, 0, 0)
        place, mark, _ = body.text.partition("?")
        if mark:
            self.problem(_part(body, len(place), len(body.text)), "arguments are for an agent")
        host, port_span, port = self.address(_part(body, 1, len(place)))
        return DeploymentEntry(whole, nothing, nothing, host, port, port_span, (), nothing)

    def strip_scheme(self, whole: Span) -> Span:
        """The line after `pitp://` or `//`."""
        scheme = re.match(r"([A-Za-z][\w+.-]*:)?//", whole.text)
        if scheme is None:
            if whole.text.startswith("/"):
                self.problem(_part(whole, 0, 1), "one slash at the start: write two or none")
                raise _Malformed
            return whole
        known = scheme.group(1) or ""
        if known not in ("", "pitp:"):
            self.problem(_part(whole, 0, len(known)), f"'{known}' is not known: write pitp:// or only //")
        return _part(whole, scheme.end(), len(whole.text))

    def split(self, span: Span, mark: str, problem: str) -> tuple[Span, Span]:
        """The parts before and after a separator."""
        at = span.text.find(mark)
        if at < 0:
            self.problem(_part(span, len(span.text), len(span.text)), problem)
            raise _Malformed
        return _part(span, 0, at), _part(span, at + 1, len(span.text))

    def address(self, span: Span) -> tuple[Span, Span, int | None]:
        """Host, the place of the port, and the port."""
        # The colons of an IPv6 address are before its closing bracket.
        bracket = span.text.find("]") if span.text.startswith("[") else 0
        at = span.text.find(":", bracket) if bracket >= 0 else -1
        host = _part(span, 0, len(span.text) if at < 0 else at)
        if not (_NAME.fullmatch(host.text) or _is_ipv6(host.text)) or len(host.text) > _LONGEST_HOST:
            self.report(messages.DEPLOY_HOST, host, host=host.text[:60])
        elif hint := _host_hint(host.text):
            self.found.add(messages.DEPLOY_HOST.at(host, hint=hint, host=host.text[:60]))
        if at < 0:
            return host, host, None
        written = _part(span, at + 1, len(span.text))
        if re.fullmatch(r"[0-9]{1,5}", written.text) and 0 < int(written.text) <= _HIGHEST_PORT:
            return host, written, int(written.text)
        self.report(messages.DEPLOY_PORT, written, port=written.text[:20])
        return host, written, None

    def arguments(self, span: Span) -> tuple[str, ...]:
        """The arguments with their percent escapes decoded; a bare `?` gives none."""
        if not span.text:
            return ()
        decoded, start = [], 0
        for argument in span.text.split("&"):
            decoded.append(self.argument(_part(span, start, start + len(argument))))
            start += len(argument) + 1
        return tuple(decoded)

    def argument(self, span: Span) -> str:
        """One argument, decoded."""
        bad_escape = _ESCAPE.search(span.text)
        try:
            if bad_escape is None:
                return unquote_to_bytes(span.text).decode("utf-8")
        except UnicodeError:
            pass
        where = span if bad_escape is None else _part(span, bad_escape.start(), bad_escape.end())
        self.report(messages.DEPLOY_ESCAPE, where, escape=where.text)
        return ""

    def problem(self, span: Span, problem: str) -> None:
        """Report a line of another shape."""
        self.report(messages.DEPLOY_SYNTAX, span, problem=problem)

    def report(self, message: FindingKind, span: Span, **values: str) -> None:
        """Report a bad part."""
        self.found.add(message.at(span, hint=None, **values))


def _part(span: Span, start: int, end: int) -> Span:
    """Characters `start` to `end` of a span; both stay inside it."""
    length = span.end - span.start
    return Span(span.source, span.start + min(start, length), span.start + min(end, length))


def _trimmed(span: Span) -> Span:
    text = span.text
    return _part(span, len(text) - len(text.lstrip()), len(text.rstrip()))
