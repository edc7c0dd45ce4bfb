"""Second pass: expressions. Every one gets its type, its conversions and the meanings of its names."""

from __future__ import annotations

from lfield.lang import messages, syntax, tree
from lfield.lang.checker import call_resolution, name_resolution, operators
from lfield.lang.checker.conversions import require_type, unknown, with_article
from lfield.lang.checker.declaration_pass import first_instruction
from lfield.lang.checker.library.collection_calls import (
    assigned_element,
    check_sort,
    map_element,
    set_element,
)
from lfield.lang.checker.library.future_calls import check_async, check_future_method, is_future_method
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.visibility import visible_type
from lfield.lang.parser.foreign.foreign_words import FOREIGN_NAMES
from lfield.lang.tree_traversal import left_spine, leftmost_operand
from lfield.lang.types import (
    BOOLEAN,
    INT,
    NULL,
    REAL,
    STRING,
    UNKNOWN,
    VOID,
    ArrayType,
    DeviceType,
    MapType,
    Type,
)

_NAMED_ARGUMENT = "arguments have no names: write the value alone; == compares"
_LITERALS: dict[type, Type] = {bool: BOOLEAN, int: INT, float: REAL, str: STRING}


def value(body: BodyContext, raw: syntax.Expr) -> tree.Expr:
    """An expression that must have a value."""
    expression = evaluated(body, raw)
    if expression.type == VOID:
        body.report(messages.VOID_VALUE, expression.span, call=_called(raw))
    elif isinstance(expression.type, DeviceType):
        example = first_instruction(body.symbols, expression.type)
        body.report(messages.DEVICE_USE, expression.span, name=expression.span.text, instruction=example)
    elif isinstance(expression, tree.LoopName):
        body.report(messages.LOOP_VALUE, expression.span, name=expression.span.text)
    elif isinstance(expression, tree.EnumName):
        name, member = expression.enum.name, expression.enum.members[0]
        body.report(messages.ENUM_NAME, expression.span, name=name, member=member)
    elif isinstance(expression, tree.This) and body.unit.kind != "class":
        body.report(messages.THIS_VALUE, expression.span, unit=f"a {body.unit.kind}")
    else:
        return expression
    return unknown(expression.span)


def evaluated(body: BodyContext, raw: syntax.Expr) -> tree.Expr:
    """Any expression: a call without a value, a device, and the `this` of a resource are allowed too."""
    if raw in body.checked:
        return body.checked.pop(raw)
    for operand in left_spine(raw, leftmost_operand):
        body.checked[operand] = _evaluated(body, operand)
    return _evaluated(body, raw)


def _evaluated(body: BodyContext, raw: syntax.Expr) -> tree.Expr:
    match raw:
        case syntax.Name():
            return name_resolution.check_variable(body, raw)
        case syntax.Literal_():
            return tree.Literal_(raw.span, _LITERALS.get(type(raw.value), NULL), raw.value)
        case syntax.Binary():
            return operators.binary(body, raw, value(body, raw.left), value(body, raw.right))
        case syntax.Unary():
            return operators.unary(body, raw, value(body, raw.operand))
        case syntax.Call():
            return _call(body, raw)
        case syntax.Member():
            return name_resolution.check_member(body, raw, evaluated(body, raw.object))
        case syntax.Index():
            return _index(body, raw)
        case syntax.Async():
            return check_async(body, raw, evaluated(body, raw.call))
        case syntax.This():
            if not body.function:
                return body.this(raw.span)
            body.report(messages.NO_THIS, raw.span, function=body.method.name)
        case syntax.New():
            return call_resolution.check_new(
                body, raw, [_constructor_argument(body, argument) for argument in raw.arguments]
            )
        case syntax.NewArray():
            return _new_array(body, raw)
        case syntax.Elements():
            if raw.type is None:
                body.report(messages.ELEMENTS_TYPE, raw.span)
            return elements(body, raw, UNKNOWN)
        case syntax.Assign():
            hint = None if raw.operator == "=" else "it is a statement of its own"
            body.report(messages.ASSIGNMENT_HERE, raw.sign, hint=hint)
    return unknown(raw.span)


def _constructor_argument(body: BodyContext, raw: syntax.Expr) -> tree.Expr:
    """An argument of a constructor: a value, or a device."""
    found = evaluated(body, raw)
    if isinstance(found.type, DeviceType):
        return found
    body.checked[raw] = found
    return value(body, raw)


def condition(body: BodyContext, raw: syntax.Expr) -> tree.Expr:
    """The boolean in the head of an if or a loop."""
    return require_type(body.symbols, value(body, raw), BOOLEAN, messages.CONDITION)


def assignment(body: BodyContext, raw: syntax.Assign) -> tree.Expr:
    """`target = value`, where a statement or another assignment allows it."""
    if (element := map_target(body, raw.target)) is not None:
        assigned_value = assigned(body, raw.value, element.type)
        return set_element(body, raw.span, element, assigned_value)
    place = target(body, raw.target)
    assigned_value = assigned(body, raw.value, UNKNOWN if place is None else place.type)
    return unknown(raw.span) if place is None else tree.Assign(raw.span, place.type, place, assigned_value)


def assigned(body: BodyContext, raw: syntax.Expr, expected: Type) -> tree.Expr:
    """The right side of an assignment as the type of the left."""
    if isinstance(raw, syntax.Elements) and raw.type is None:
        return elements(body, raw, expected)
    plain = isinstance(raw, syntax.Assign) and raw.operator == "="
    if isinstance(raw, syntax.Assign) and plain:
        return require_type(body.symbols, assignment(body, raw), expected)
    argument = _constructor_argument(body, raw) if isinstance(expected, DeviceType) else value(body, raw)
    return require_type(body.symbols, argument, expected)


def elements(body: BodyContext, raw: syntax.Elements, expected: Type) -> tree.Expr:
    """An array of these elements, of the written type or else of the expected one."""
    kind = expected if raw.type is None else visible_type(body.symbols, body.unit, raw.type)
    if not isinstance(kind, ArrayType) and kind is not UNKNOWN:
        body.report(messages.ELEMENTS, raw.span, expected=with_article(kind))
        return unknown(raw.span)
    element_type = kind.element if isinstance(kind, ArrayType) else UNKNOWN
    return tree.Elements(raw.span, kind, [_element(body, element, element_type) for element in raw.elements])


def _element(body: BodyContext, raw: syntax.Expr, expected: Type) -> tree.Expr:
    if isinstance(raw, syntax.Elements) and raw.type is None:
        return elements(body, raw, expected)
    return require_type(body.symbols, value(body, raw), expected)


def map_target(body: BodyContext, raw: syntax.Expr) -> tree.Call | None:
    """The element of a map on the left side of an assignment; None for any other target."""
    if not isinstance(raw, syntax.Index):
        return None
    found = body.checked[raw] = evaluated(body, raw)
    element = assigned_element(raw, found)
    if element is not None:
        del body.checked[raw]
    return element


def target(body: BodyContext, raw: syntax.Expr) -> tree.LocalGet | tree.FieldGet | tree.Element | None:
    """The left side of an assignment; None after a report."""
    found = evaluated(body, raw)
    if _may_hold_device(body, found):
        assert isinstance(found, tree.FieldGet)
        return found
    body.checked[raw] = found
    found = value(body, raw)
    if isinstance(found, tree.LocalGet | tree.FieldGet | tree.Element):
        return found
    if found.type is not UNKNOWN:
        is_named = isinstance(found, tree.Literal_) and not isinstance(raw, syntax.Literal_)
        hint = f"{raw.span.text} is a constant: its declaration has its value" if is_named else None
        body.report(messages.NOT_ASSIGNABLE, raw.span, hint=hint)
    return None


def _may_hold_device(body: BodyContext, found: tree.Expr) -> bool:
    """Whether an expression is an own field for a device, in the constructor that is given the device."""
    own = isinstance(found, tree.FieldGet) and isinstance(found.object, tree.This)
    return own and isinstance(found.type, DeviceType) and body.method.kind == "constructor"


def _called(raw: syntax.Expr) -> str:
    """A call without a value, for a message."""
    function = raw.function if isinstance(raw, syntax.Call) else None
    return f"{function.name}()" if function is not None else "this"


def _call(body: BodyContext, raw: syntax.Call) -> tree.Expr:
    function = raw.function
    if isinstance(function, syntax.Name):
        arguments = _arguments(body, raw)
        return (
            unknown(raw.span)
            if arguments is None
            else call_resolution.check_bare_call(body, raw, function, arguments)
        )
    owner = evaluated(body, function.object)
    if owner.type is UNKNOWN and function.object.span.text in FOREIGN_NAMES:
        return unknown(raw.span)  # `rclpy.spin(node)`: the arguments are foreign too.
    if function.name == "sort" and isinstance(owner.type, ArrayType):
        return check_sort(body, raw, owner)
    if is_future_method(body, function.name, owner):
        return check_future_method(body, raw, owner)
    arguments = _arguments(body, raw)
    if arguments is None:
        return unknown(raw.span)
    return call_resolution.check_member_call(body, raw, function, owner, arguments)


def _arguments(body: BodyContext, raw: syntax.Call) -> list[tree.Expr] | None:
    """The values of the arguments; None if one has a name, as in `f(n=1)`, which is reported."""
    if named := [argument for argument in raw.arguments if isinstance(argument, syntax.Assign)]:
        body.report(messages.ASSIGNMENT_HERE, named[0].sign, hint=_NAMED_ARGUMENT)
        return None
    return [value(body, argument) for argument in raw.arguments]


def _index(body: BodyContext, raw: syntax.Index) -> tree.Expr:
    array = value(body, raw.array)
    if isinstance(array.type, MapType):
        return map_element(body, raw, array, value(body, raw.index))
    index = require_type(body.symbols, value(body, raw.index), INT)
    if isinstance(array.type, ArrayType):
        return tree.Element(raw.span, array.type.element, array, index)
    if array.type is not UNKNOWN:
        hint = "write s.substring(i, i + 1)" if array.type == STRING else None
        body.report(messages.NOT_AN_ARRAY, raw.array.span, hint=hint, given=with_article(array.type))
    return unknown(raw.span)


def _new_array(body: BodyContext, raw: syntax.NewArray) -> tree.Expr:
    lengths = [require_type(body.symbols, value(body, length), INT) for length in raw.lengths]
    kind = visible_type(body.symbols, body.unit, raw.type)
    return tree.NewArray(raw.span, kind, lengths)
