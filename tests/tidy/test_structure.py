"""Structural rules of STYLE.md, applied to the code, and each rule applied to code that breaks it."""

from __future__ import annotations

import ast
from functools import cache
from textwrap import dedent

import name_rules
import pytest
import structure
from code_tree import Finding
from structure import Allowed

RULES = ("class", "name", "assignment", "constructor")


@cache
def found() -> dict[str, list[Finding]]:
    return structure.findings_of(
        structure.trees_of(*structure.packages()), structure.trees_of(*structure.named_folders())
    )


@cache
def exceptions() -> list[Allowed]:
    return structure.read_allowed(structure.EXCEPTIONS.read_text(encoding="utf-8"))


def trees(**sources: str) -> dict[str, ast.Module]:
    """Files of a package, `a__b="..."` for `lfield/a/b.py`."""
    return {
        f"lfield/{name.replace('__', '/')}.py": ast.parse(dedent(source)) for name, source in sources.items()
    }


def names(findings: list[Finding]) -> list[tuple[str, int, str]]:
    return [(each.file.removeprefix("lfield/"), each.line, each.name) for each in findings]


@pytest.mark.parametrize("rule", RULES)
def test_code_follows_the_rule(rule: str) -> None:
    assert structure.unexplained(found()[rule], exceptions()) == []


def test_every_exception_is_needed_once_and_has_a_reason() -> None:
    findings = [each for rule in RULES for each in found()[rule]]
    assert structure.unneeded(findings, exceptions()) == []


def test_exceptions_are_matched_by_rule_file_and_name() -> None:
    findings = [
        Finding("assignment", "lfield/a.py", 3, "due", "x.due"),
        Finding("name", "lfield/a.py", 4, "due", ""),
    ]
    lines = structure.read_allowed("# text\n\nassignment lfield/a.py due a reason of words\n")
    assert lines == [Allowed("assignment", "lfield/a.py", "due", "a reason of words")]
    assert structure.unexplained(findings, lines) == ["lfield/a.py:4: "]
    assert structure.unneeded(findings, lines) == []
    assert structure.unneeded(findings, lines * 2) == ["assignment lfield/a.py due"]
    assert structure.unneeded([], lines) == ["assignment lfield/a.py due"]
    assert structure.unneeded(findings, structure.read_allowed("name lfield/a.py due")) == [
        "name lfield/a.py due"
    ]


def test_public_class_name_in_two_modules_is_found() -> None:
    code = trees(
        a="class Entry: ...\nclass _Entry: ...", b="if 1:\n  class Entry: ...", c="class _Entry: ..."
    )
    assert names(structure.repeated_classes(code)) == [("a.py", 1, "Entry"), ("b.py", 2, "Entry")]


def test_the_two_syntax_trees_may_share_class_names() -> None:
    code = trees(lang__syntax="class If: ...", lang__tree="class If: ...")
    assert structure.repeated_classes(code) == []
    assert len(structure.repeated_classes({**code, **trees(vm="class If: ...")})) == 3
    assert (
        len(structure.repeated_classes({**code, **trees(lang__syntax="class If: ...\nclass If: ...")})) == 3
    )


def test_banned_names_of_modules_classes_and_functions_are_found() -> None:
    banned = name_rules.read_banned(
        "word told on_<event>\nword take drain\nname words values\nterm take_over\n"
    )
    code = trees(
        told="",
        a="""\
            class NewsTold:
                def _take_all(self): ...
                async def take_over(self): ...
            def told_by(): ...
            def words(): ...
            def class_words(): ...
            def stake(): ...
            def test_what_was_told(): ...
        """,
    )
    code["lfield/words/__init__.py"] = ast.parse("")
    assert names(name_rules.banned_names(code, banned)) == [
        ("told.py", 1, "told"),
        ("a.py", 1, "NewsTold"),
        ("a.py", 2, "_take_all"),
        ("a.py", 4, "told_by"),
        ("a.py", 5, "words"),
        ("words/__init__.py", 1, "words"),
    ]


@pytest.mark.parametrize(
    "source",
    [
        "told = 1",
        "TOLD: int",
        "class Fields:\n    was_told: bool = False",
        "def f(told): ...",
        "def f(a, *told): ...",
        "f = lambda *, told: 0",
        "def f(self): self._told = 1",
        "f(told=1)",
        "for told in (): ...",
        "[0 for _, told in ()]",
        "if told := 1: ...",
        "with open('f') as told: ...",
        "import news as told",
        "try: ...\nexcept OSError as told: ...",
        "match 1:\n    case [1, *told]: ...",
        "match 1:\n    case {'a': 1, **told}: ...",
        "match 1:\n    case [told]: ...",
    ],
)
def test_banned_names_of_variables_and_fields_are_found(source: str) -> None:
    banned = name_rules.read_banned("word told reported")
    assert len(name_rules.banned_names(trees(a=source), banned)) == 1


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("a.js", "const told = 1;"),
        ("a.js", "  async wasTold(event) {"),
        ("a.js", "    told: null,"),
        ("a.js", "    this.toldAt = 0;"),
        ("a.js", "export const f = (told) => told;"),
        ("a.wat", "(func $told (param $x i32))"),
    ],
)
def test_banned_names_of_javascript_and_webassembly_are_found(file: str, line: str) -> None:
    banned = name_rules.read_banned("word told reported")
    found = name_rules.banned_names_in_text(file, f"// a comment\n{line}", banned)
    assert [finding.line for finding in found] == [2]
    assert name_rules.banned_names_in_text(file, line.replace("old", "otal"), banned) == []


def test_term_may_be_accepted_in_some_folders_only() -> None:
    banned = name_rules.read_banned(
        "name word token\nword roll inventory\nterm word lfield/vm\nterm roll lfield/x"
    )
    code = trees(vm__memory="word = 1", lang="word = 1", x="roll_rate = 1", y="roll_rate = 1")
    assert names(name_rules.banned_names(code, banned)) == [("lang.py", 1, "word"), ("y.py", 1, "roll_rate")]


PART = """
    class Part:
        limit: int
        __slots__ = ("slot",)
        def __init__(self): self.hook = None
        def on_event(self): ...
"""


@pytest.mark.parametrize(
    "statement",
    [
        "part.hook = 1",
        "part.limit += 1",
        "part.slot: int = 1",
        "del part.hook",
        "a, (*b, part.hook) = 1, (2, 3)",
        "[0 for part.hook in ()]",
        "if 1:\n    for part.hook in (): ...",
        "if 1:\n    with open('f') as part.hook: ...",
        "part.on_event = print",
        "setattr(part, 'hook', 1)",
        "object.__setattr__(part, 'hook', 1)",
        "part.inner.hook = 1",
        "part.all[0].hook = 1",
    ],
)
def test_assignment_to_an_attribute_of_another_object_is_found(statement: str) -> None:
    for source in (f"def f(part):\n   {statement}", f"class Whole:\n  def f(self, part):\n   {statement}"):
        assert len(structure.foreign_assignments(trees(a__part=PART, a__whole=source))) == 1
    if "part." in statement:
        own = f"class Whole:\n  def f(self):\n   {statement.replace('part.', 'self.part.')}"
        assert len(structure.foreign_assignments(trees(a__part=PART, a__whole=own))) == 1


@pytest.mark.parametrize(
    "source",
    [
        "def f(self): self.hook = 1",
        "import part\npart.hook = 1",
        "def f(part): part.other_attribute = 1",
        "def f(part): setattr(part, name, 1)",
        "def f(part): part.hook()",
        "def f(part): part['hook'] = 1",
    ],
)
def test_own_attributes_modules_and_library_objects_are_accepted(source: str) -> None:
    assert structure.foreign_assignments(trees(a__part=PART, a__whole=source)) == []


def test_class_may_change_its_new_instances_and_helpers_of_its_file() -> None:
    source = """
        class _Helper:
            count: int
        class Whole:
            hook: int
            @classmethod
            def read(cls, other):
                made = cls.__new__(cls)
                made.hook = 1
                twin: Whole = other.twin()
                twin.hook = 2
                other.hook = 3
            def f(self, helper):
                helper.count = 1
    """
    code = trees(a__part=PART, a__whole=source)
    assert names(structure.foreign_assignments(code)) == [("a/whole.py", 12, "hook")]


def test_class_of_an_object_is_inferred_from_annotations_and_calls() -> None:
    """Each of these statements assigns an attribute that a class of the same file also declares."""
    source = """
        class Whole:
            def __init__(self, part: Part, made, text: "Part"):
                self.hook = None
                self._part = part
                self._made = Part()
                text.hook = 1
            def f(self, one: Part | None):
                self._part.hook = 1
                self._made.hook = 1
                one.hook = 1
        class Other:
            hook: int
    """
    code = trees(a__part=PART, a__whole=source)
    assert [line for _, line, _ in names(structure.foreign_assignments(code))] == [7, 9, 10, 11]


def test_inherited_attributes_belong_to_the_base() -> None:
    whole = "from rich import Console\nclass Own(Part): ...\nclass Screen(Console): ..."
    use = "def f(own: Own): own.hook = 1"
    assert len(structure.foreign_assignments(trees(a__part=PART, a__own=whole, a__use=use))) == 1
    use = "def f(screen: Screen): screen.hook = 1"
    assert structure.foreign_assignments(trees(a__part=PART, a__own=whole, a__use=use)) == []


@pytest.mark.parametrize(
    "head",
    ["@dataclass(slots=True)\nclass Account:", "class Account(Struct):", "class Account(Node, eq=False):"],
)
def test_record_is_filled_within_its_package_only(head: str) -> None:
    record = f"{head}\n  level: int\n  @property\n  def full(self): ..."
    use = "def f(account): account.level = 1"
    assert structure.foreign_assignments(trees(a__account=record, a__use=use)) == []
    assert len(structure.foreign_assignments(trees(a__account=record, b__use=use))) == 1
    behaviour = f"{record}\n  def charge(self): ..."
    assert len(structure.foreign_assignments(trees(a__account=behaviour, a__use=use))) == 1


def test_constructor_with_more_than_7_arguments_is_found() -> None:
    seven = "class A:\n  def __init__(self, a, b, /, c, d=1, *, e, f, {}): ..."
    assert structure.long_constructors(trees(a=seven.format("g"))) == []
    assert names(structure.long_constructors(trees(a=seven.format("g, **more")))) == [("a.py", 1, "A")]
    assert names(structure.long_constructors(trees(a=seven.format("g, h=2")))) == [("a.py", 1, "A")]


def test_dataclass_with_behaviour_and_state_counts_as_a_constructor() -> None:
    fields = "".join(f"  f{n}: int\n" for n in range(8))
    method = "  def f(self): ...\n"

    def count(mark: str, body: str) -> int:
        return len(structure.long_constructors(trees(a=f"@dataclass{mark}\nclass A:\n{body}")))

    assert count("(slots=True)", fields + method) == 1
    assert count("", fields.replace("f0: int", "f0: int = field(repr=False)") + method) == 1
    assert count("(slots=True)", fields) == 0
    assert count("(frozen=True)", fields + method) == 0
    for default in ("int = 0", "int = field(default=0)", "int = field(init=False)", "ClassVar[int]"):
        assert count("", fields.replace("f0: int", f"f0: {default}") + method) == 0
