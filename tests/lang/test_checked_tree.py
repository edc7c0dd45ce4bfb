"""The checked tree that the compiler reads: expanded syntax, resolved names, conversions as nodes."""

from typing import TypeVar

from lang_expectations import CAPABILITIES, ROVER

from lfield.lang import tree
from lfield.lang.frontend import check_text
from lfield.lang.types import (
    EXCEPTION,
    INT,
    NULL,
    REAL,
    STRING,
    ClassType,
    DeviceType,
    ResourceType,
    Type,
    array_of,
)

Node = TypeVar("Node")


def program(text: str) -> dict[str, tree.Unit]:
    return {unit.name: unit for unit in check_text(text, devices={"Rover": ROVER}).or_raise().units}


def body(statements: str, members: str = "", after: str = "") -> list[tree.Stmt]:
    text = f"resource Arm {{ init(string[] arg) {{ {statements} }} {members} }} {after}"
    return program(text)["Arm"].methods[0].body


def call(statements: str, kind: type[Node], members: str = "", after: str = "") -> Node:
    """The expression of the last statement."""
    last = body(statements, members, after)[-1]
    assert isinstance(last, tree.Evaluate)
    assert isinstance(last.value, kind)
    return last.value


def test_field_initialisers_run_first_in_init_and_every_constructor() -> None:
    units = program(
        "resource Arm { int a = 1; init(string[] arg) { a = 2; } }"
        "class Box { public real size = 3; public Box() { } public Box(int n) { } }"
        "class Plain { public int x = 1; }"
    )
    first, second = units["Arm"].methods[0].body
    assert isinstance(first, tree.Evaluate)
    assert isinstance(first.value, tree.Assign)
    assert isinstance(first.value.target, tree.FieldGet)
    assert isinstance(first.value.target.object, tree.This)
    assert isinstance(second, tree.Evaluate)
    values = []
    for constructor in units["Box"].methods:
        (statement,) = constructor.body
        assert isinstance(statement, tree.Evaluate)
        assert isinstance(statement.value, tree.Assign)
        assert isinstance(statement.value.value, tree.ToReal)
        values.append(statement.value.value)
    assert values[0] is not values[1]
    (default,) = units["Plain"].methods
    assert (default.kind, default.parameters, default.public, len(default.body)) == (
        "constructor",
        [],
        True,
        1,
    )


def test_for_is_a_block_with_a_loop_and_its_step() -> None:
    (block,) = body("for (int i = 0; i < 3; i = i + 1) { if (i == 1) continue; }")
    assert isinstance(block, tree.BlockStmt)
    declare, loop = block.body
    assert isinstance(declare, tree.Declare)
    assert isinstance(loop, tree.Loop)
    assert len(loop.step) == 1
    (endless,) = body("for (;;) yield();")
    assert isinstance(endless, tree.BlockStmt)
    (loop,) = endless.body
    assert isinstance(loop, tree.Loop)
    assert isinstance(loop.condition, tree.Literal_)
    assert loop.condition.value is True


def test_int_is_widened_to_real_in_every_context() -> None:
    (declare,) = body("real x = 1;")
    assert isinstance(declare, tree.Declare)
    assert isinstance(declare.value, tree.ToReal)
    assert isinstance(call("sleep(1);", tree.LibraryCall).arguments[0], tree.ToReal)
    result = (
        program("resource A { init(string[] a) { } private real f() { return 1; } }")["A"].methods[1].body[0]
    )
    assert isinstance(result, tree.Return)
    assert isinstance(result.value, tree.ToReal)
    (plus,) = call("print(1 + 2.0);", tree.LibraryCall).arguments
    assert isinstance(plus, tree.Binary)
    assert isinstance(plus.left, tree.ToReal)
    assert plus.type == REAL
    (less,) = call("print(1.0 < 2);", tree.LibraryCall).arguments
    assert isinstance(less, tree.Binary)
    assert isinstance(less.right, tree.ToReal)


def test_overload_is_the_exact_match_or_has_the_fewest_widenings() -> None:
    members = "private void f(int a, real b) { } private void f(real a, real b) { }"
    members += "private void f(string s, int[] a) { }"
    assert call("f(1, 2);", tree.Call, members).method.signature == "f(int, real)"
    assert call("f(1.0, 2);", tree.Call, members).method.signature == "f(real, real)"
    assert call("f(null, null);", tree.Call, members).method.signature == "f(string, int[])"
    assert call("print(min(1, 2.0));", tree.LibraryCall).operation == "print_float"


def test_null_is_the_right_operand_and_keeps_its_type() -> None:
    (same,) = call("print(null == arg);", tree.LibraryCall).arguments
    assert isinstance(same, tree.Binary)
    assert (same.left.type, same.right.type) == (array_of(STRING), NULL)


def test_smallest_int_is_one_literal() -> None:
    (literal,) = call("print(-9223372036854775808);", tree.LibraryCall).arguments
    assert isinstance(literal, tree.Literal_)
    assert (literal.value, literal.type) == (-(2**63), INT)


def test_operators_have_the_precedence_of_c() -> None:
    def shape(expression: tree.Expr) -> str:
        if isinstance(expression, tree.Binary | tree.Logical):
            return f"({shape(expression.left)}{expression.op}{shape(expression.right)})"
        if isinstance(expression, tree.Not | tree.Negate):
            return f"{'!' if isinstance(expression, tree.Not) else '-'}{shape(expression.operand)}"
        return expression.span.text

    def grouped(text: str) -> str:
        return shape(
            call(f"int a = 1; int b = 2; boolean p; boolean q; print({text});", tree.LibraryCall).arguments[0]
        )

    assert grouped("a - b - 3 * -a % 2") == "((a-b)-((3*-a)%2))"
    assert grouped("p || q && !p == q") == "(p||(q&&(!p==q)))"
    assert grouped("a + 1 < b == p") == "(((a+1)<b)==p)"
    assert grouped("(a + b) * 2") == "((a+b)*2)"


def test_dangling_else_belongs_to_the_nearest_if() -> None:
    (outer,) = body("if (true) if (false) print(1); else print(2);")
    assert isinstance(outer, tree.If)
    (inner,) = outer.then
    assert isinstance(inner, tree.If)
    assert (len(inner.otherwise), outer.otherwise) == (1, [])


def test_portal_calls_and_finds_of_agents() -> None:
    units = program(
        "resource Arm { init(string[] a) { } portal go(real x) emit int { return 1; } }"
        'coordinator Boss { init(string[] a) { Arm x = findArm("a"); Arm[] all = findArm(); all[0].go(1); } }'
    )
    single, several, portal_call = units["Boss"].methods[0].body
    assert isinstance(single, tree.Declare)
    assert isinstance(single.value, tree.Find)
    assert (single.value.resource, single.value.type) == (units["Arm"], ResourceType("Arm"))
    assert isinstance(several, tree.Declare)
    assert isinstance(several.value, tree.Find)
    assert (several.value.id, several.value.type) == (None, array_of(ResourceType("Arm")))
    assert isinstance(portal_call, tree.Evaluate)
    assert isinstance(portal_call.value, tree.PortalCall)
    assert portal_call.value.portal is units["Arm"].methods[1]
    assert isinstance(portal_call.value.arguments[0], tree.ToReal)


def test_device_calls() -> None:
    init = "init(string[] x) { fc.drive(1); print(this.fc.scan(null)[0]); }"
    text = f"resource Arm {{ int a; Rover fc; real b; {init} }}"
    checked = check_text(text, devices={"Rover": ROVER, "Other": ROVER}).or_raise()
    (arm,) = checked.units
    assert [(f.name, f.index) for f in arm.fields] == [("a", 0), ("fc", 1), ("b", 2)]
    assert arm.fields[1].type == DeviceType("Rover")
    first = arm.methods[0].body[0]
    assert isinstance(first, tree.Evaluate)
    assert isinstance(first.value, tree.DeviceCall)
    assert (first.value.device, first.value.instruction.name) == (arm.fields[1], "drive")
    assert isinstance(first.value.arguments[0], tree.ToReal)


def test_throw_and_catch_of_exceptions() -> None:
    statements = body(
        'try throw new NullException("x"); catch (Box b) print(1); catch (Exception e) throw e;',
        "",
        "class Box { }",
    )
    (try_,) = statements
    assert isinstance(try_, tree.Try)
    (thrown,) = try_.body
    assert isinstance(thrown, tree.Throw)
    assert isinstance(thrown.value, tree.New)
    assert (thrown.value.constructor, thrown.value.type) == (None, ClassType("NullException"))
    assert [clause.local.type for clause in try_.catches] == [ClassType("Box"), EXCEPTION]
    message = call('Exception e = new Exception("a"); e.message();', tree.LibraryCall)
    assert (message.operation, message.type) == ("exc_message", STRING)


def test_lengths_of_arrays_and_strings() -> None:
    assert call("arg.length();", tree.LibraryCall).operation == "array_len"
    text = call("arg[0].substring(1, 2);", tree.LibraryCall)
    assert (text.operation, len(text.arguments)) == ("substring", 3)


def test_new_array_has_its_complete_type() -> None:
    allocation = call("int[][] a; a = new int[2][];", tree.Assign).value
    assert isinstance(allocation, tree.NewArray)
    assert (allocation.type, len(allocation.lengths)) == (array_of(array_of(INT)), 1)


def test_this_of_a_resource_has_a_plain_type() -> None:
    assert call("this.f();", tree.Call, "private void f() { }").object.type == Type("Arm")


def test_string_escapes() -> None:
    (text,) = call(r'print("\n\t\r\0\"\\\u{e9}\u{1F916}");', tree.LibraryCall).arguments
    assert isinstance(text, tree.Literal_)
    assert text.value == '\n\t\r\0"\\é\N{ROBOT FACE}'


ARM = "resource Arm { init(string[] arg) { } portal lift(real m) emit real { return m; } portal stop() { } }"


def boss(statements: str, before: str = "") -> list[tree.Stmt]:
    """The statements of a coordinator with an arm."""
    declarations = f'Arm arm = findArm("a"); real x; real[] a = new real[3]; {before}'
    text = f"{ARM} coordinator Boss {{ init(string[] arg) {{ {declarations} {statements} }} }}"
    checked = check_text(text, capabilities=CAPABILITIES).or_raise()
    (init,) = next(unit for unit in checked.units if unit.name == "Boss").methods
    return init.body


def test_together_starts_its_calls() -> None:
    calls = "x = arm.lift(1); if (i > 2) a[i + 1] = arm.lift(2); arm.stop(); print(1);"
    block = boss(f"together {{ {calls} }}", "int i = 1;")[-1]
    assert isinstance(block, tree.Together)
    first, branch, stop, printed = block.body
    assert isinstance(first, tree.StartCall)
    assert isinstance(first.call, tree.PortalCall)
    assert isinstance(first.call.arguments[0], tree.ToReal)
    assert isinstance(first.target, tree.LocalGet)
    assert first.target.local.name == "x"
    assert isinstance(branch, tree.If)
    (second,) = branch.then
    assert isinstance(second, tree.StartCall)
    assert isinstance(second.target, tree.Element)
    assert isinstance(second.target.index, tree.Binary)
    assert isinstance(stop, tree.StartCall)
    assert stop.target is None
    assert isinstance(printed, tree.Evaluate)


def test_nested_together_starts_its_own_calls() -> None:
    outer = boss("together { arm.stop(); try { together { x = arm.lift(1); } } finally { print(1); } }")[-1]
    assert isinstance(outer, tree.Together)
    first, try_ = outer.body
    assert isinstance(first, tree.StartCall)
    assert isinstance(try_, tree.Try)
    (inner,) = try_.body
    assert isinstance(inner, tree.Together)
    assert isinstance(inner.body[0], tree.StartCall)
    assert isinstance(inner.body[0].target, tree.LocalGet)


def test_together_starts_portals_of_offers_and_not_their_own_methods() -> None:
    offers = "Lift[] lifts = findLift();"
    portal = "portal lift(real height) emit real { return height; } portal stop() { }"
    crane = f"resource Crane {{ init(string[] arg) {{ }} {portal} }}"
    text = "together { h = lifts[0].lift(2); lifts[1].stop(); print(lifts[0].score()); lifts[0].way(); }"
    init = f"coordinator Boss {{ init(string[] arg) {{ {offers} real h; {text} }} }}"
    units = check_text(f"{crane} {init}", capabilities=CAPABILITIES).or_raise().units
    block = next(unit for unit in units if unit.name == "Boss").methods[0].body[-1]
    assert isinstance(block, tree.Together)
    kinds = [type(statement) for statement in block.body]
    assert kinds == [tree.StartCall, tree.StartCall, tree.Evaluate, tree.Evaluate]
    first = block.body[0]
    assert isinstance(first, tree.StartCall)
    assert isinstance(first.call, tree.Call)
    assert first.call.method.unit.capability


def test_within_has_its_seconds_as_a_real() -> None:
    (block,) = boss("within (2) { arm.stop(); }")[-1:]
    assert isinstance(block, tree.Within)
    assert isinstance(block.seconds, tree.ToReal)
    (statement,) = block.body
    assert isinstance(statement, tree.Evaluate)
    assert isinstance(statement.value, tree.PortalCall)


def test_finally_is_the_last_part_of_its_try() -> None:
    outer = boss("try try arm.stop(); finally { x = 1; } catch (Exception e) x = 2;")[-1]
    assert isinstance(outer, tree.Try)
    assert (len(outer.catches), outer.last) == (1, None)
    (inner,) = outer.body
    assert isinstance(inner, tree.Try)
    assert inner.catches == []
    assert inner.last is not None
    assert len(inner.last) == 1
    (empty,) = boss("try arm.stop(); finally { }")[-1:]
    assert isinstance(empty, tree.Try)
    assert empty.last == []


def test_every_exception_has_others() -> None:
    others = call("Exception e = new NullException(); e.others();", tree.LibraryCall)
    assert (others.operation, others.type) == ("exc_others", array_of(EXCEPTION))
