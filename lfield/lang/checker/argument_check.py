"""Checks the arguments of a deployment against the constant indexes with which `init` reads them.

Only statements that every start executes count: bodies under a condition, in a loop or in a `try` are left
out, and so is an `init` that reads the number of its arguments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from msgspec import Struct, field

from lfield.lang import messages, tree
from lfield.lang.checker.library.sequencing_calls import sequencing_findings
from lfield.lang.checker.together.block_rules import constant_number
from lfield.lang.deployment import DeployedAgent, Deployment
from lfield.lang.language_library import ARRAY_LENGTH, GROWTH
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.text.source_text import Diagnostic, Span
from lfield.text.suggestions import did_you_mean, listed

#: The most missing arguments that a hint writes out.
_MAX_SHOWN = 8
_NEGATIVE = "the first argument is arg[1]; arg[0] is the id of the agent itself"


class ArgumentUses(Struct):
    """The constant indexes that an `init` reads, each with its place, and the resources it finds by them."""

    indexes: dict[int, tree.Expr] = field(default_factory=dict)
    finds: dict[int, str] = field(default_factory=dict)


def argument_findings(units: Sequence[tree.Unit], deployment: Deployment) -> list[Diagnostic]:
    """An error for each missing argument, a warning for each that should be the id of an agent and is not."""
    uses = {unit.name: argument_uses(unit) for unit in units if unit.kind != "class"}
    ids: dict[str, list[str]] = {}
    for agent in deployment.agents:
        ids.setdefault(agent.type, []).append(agent.id)
    found = [finding for agent in deployment.agents for finding in _findings(agent, uses, ids)]
    return [*found, *_unknown_ids(units, ids), *sequencing_findings(units, deployment)]


def _unknown_ids(units: Sequence[tree.Unit], ids: Mapping[str, list[str]]) -> Iterator[Diagnostic]:
    """A warning for each `findR("id")` whose id the deployment does not have."""
    for unit in units:
        for method in unit.methods:
            for statement in all_statements(method.body):
                for expr in statement_expressions(statement):
                    for node in descendants(expr):
                        if isinstance(node, tree.Find) and isinstance(node.id, tree.Literal_):
                            yield from _unknown_id(node.id.span, str(node.id.value), node.resource.name, ids)


def _unknown_id(span: Span, id: str, resource: str, ids: Mapping[str, list[str]]) -> Iterator[Diagnostic]:
    known = ids.get(resource, [])
    if id not in known:
        hint = f"no agent of type {resource} is deployed"
        if known:
            hint = f"ids of type {resource}: {listed(known)}"
        if "," in id:
            hint = f"separate arguments by &: {id.replace(',', '&')}"
        elif actual := next((type for type, names in ids.items() if id in names), None):
            hint = f"'{id}' is a {actual}; {hint}"
        yield messages.UNKNOWN_AGENT.at(span, hint=did_you_mean(id, known) or hint, id=id, type=resource)


def _findings(
    agent: DeployedAgent, uses: Mapping[str, ArgumentUses], ids: Mapping[str, list[str]]
) -> Iterator[Diagnostic]:
    # arg[0] is the id of the agent itself; the arguments of the deployment follow.
    arguments, own = (agent.id, *agent.arguments), uses.get(agent.type, ArgumentUses())
    missing = {index: expr for index, expr in own.indexes.items() if not 0 <= index < len(arguments)}
    if missing:
        index = min(missing)
        line = missing[index].span.line
        number = len(agent.arguments)
        count = f"{number} argument{'s' if number != 1 else ''}"
        yield messages.MISSING_ARGUMENT.at(
            agent.span,
            hint=_NEGATIVE if index < 0 else _separator_hint(agent, max(missing)),
            agent=agent.id,
            count=count,
            index=index,
            line=line,
            given="&".join(_complete(agent, max(missing))),
        )
    for index, resource in own.finds.items():
        if 0 <= index < len(arguments):
            yield from _unknown_id(agent.span, arguments[index], resource, ids)


def _separator_hint(agent: DeployedAgent, needed: int) -> str | None:
    """The hint for arguments that would be enough if they were not separated by commas."""
    arguments = ",".join(agent.arguments).split(",")
    is_split = len(arguments) > len(agent.arguments) and len(arguments) >= needed
    return f"separate arguments by &: ?{'&'.join(arguments)}" if is_split else None


def _complete(agent: DeployedAgent, needed: int) -> list[str]:
    """The arguments of an agent, with placeholders for those that are missing."""
    missing = range(len(agent.arguments) + 1, needed + 1)
    placeholders = [f"ARGUMENT{number}" for number in missing[:_MAX_SHOWN]]
    return [*agent.arguments, *placeholders, *(["..."] if len(missing) > _MAX_SHOWN else [])]


def argument_uses(unit: tree.Unit) -> ArgumentUses:
    """The reads of arguments in the `init` of a unit."""
    uses = ArgumentUses()
    init = next((method for method in unit.methods if method.kind == "init"), None)
    if init is None or not init.parameters:
        return uses
    argument = init.parameters[0]
    nodes = [node for statement in init.body for node in _evaluated(statement)]
    for node in nodes:
        match node:
            case tree.LibraryCall(operation=operation, arguments=[tree.LocalGet(local=local), *_]):
                if operation in (ARRAY_LENGTH, *GROWTH) and local is argument:
                    return ArgumentUses()
            case tree.Element():
                if (index := _argument_index(node, argument)) is not None:
                    uses.indexes.setdefault(index, node)
            case tree.Find(resource=resource, id=tree.Element() as element):
                if (index := _argument_index(element, argument)) is not None:
                    uses.finds[index] = resource.name
    return uses


def _argument_index(element: tree.Element, argument: tree.Local) -> int | None:
    """The constant index with which an element of `argument` is read; None for any other element."""
    if not isinstance(element.array, tree.LocalGet) or element.array.local is not argument:
        return None
    index = constant_number(element.index)
    return None if index is None else int(index)


def _evaluated(node: object) -> Iterator[object]:
    """A statement or expression and the parts that are evaluated whenever it is."""
    waiting = [node]
    while waiting:
        node_part = waiting.pop()
        yield node_part
        if isinstance(node_part, tree.Logical):
            waiting.append(node_part.left)
        elif isinstance(node_part, tree.If):
            waiting.append(node_part.condition)
        elif isinstance(node_part, tree.Loop):
            is_endless = isinstance(node_part.condition, tree.Literal_) and node_part.condition.value is True
            waiting.extend([node_part.condition, *(node_part.body if is_endless else ())])
        elif isinstance(node_part, tree.Try):
            # A body with a catch may read an optional argument.
            waiting.extend([*(() if node_part.catches else node_part.body), *(node_part.last or ())])
        elif isinstance(node_part, tree.Stmt | tree.Expr):
            waiting.extend(_parts(node_part))


def _parts(node: tree.Stmt | tree.Expr) -> Iterator[object]:
    for name in node.__struct_fields__:
        value = getattr(node, name)
        for part in value if isinstance(value, list) else (value,):
            if isinstance(part, tree.Stmt | tree.Expr):
                yield part
