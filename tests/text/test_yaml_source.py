"""YAML files: values, places of nodes, diagnostics, and typed fields."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.errors import InputFileError
from lfield.text.source_text import Diagnostics, Source
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import MAX_BYTES, YamlList, YamlMapping, decode, parse, read


def value(text: str):
    """The values of a text as plain Python."""
    found = Diagnostics()
    node = parse(Source("t.yaml", text), found)
    assert found.errors == []
    return plain(node)


def plain(node):
    if isinstance(node, YamlMapping):
        return {key: plain(entry.value) for key, entry in node.entries.items()}
    if isinstance(node, YamlList):
        return [plain(item) for item in node.items]
    return node.value


def errors(text: str) -> str:
    found = Diagnostics()
    assert parse(Source("t.yaml", text), found) is None
    return "\n".join(d.render() for d in found.errors)


def test_scalar_and_nested_values():
    text = "a: 1\nb: [1.5, -2, 1e3, 0x1F]\nc: {d: true, e: null, f: ~, g:}\nh: 'it'\ni: |\n  two\n  lines\n"
    assert value(text) == {
        "a": 1,
        "b": [1.5, -2, 1000.0, 31],
        "c": {"d": True, "e": None, "f": None, "g": None},
        "h": "it",
        "i": "two\nlines\n",
    }


def test_words_of_yaml_1_1_are_text():
    assert value("[no, yes, on, 1:30, 010, 0o7, 2001-01-01, 'true']") == [
        "no", "yes", "on", "1:30", 10, "0o7", "2001-01-01", "true",
    ]  # fmt: skip


def test_empty_document_is_null():
    assert value("") is None
    assert value("# only a comment\n") is None


def test_nodes_have_their_places():
    found = Diagnostics()
    node = parse(Source("t.yaml", "# c\na:\n  b: 12\n"), found)
    assert isinstance(node, YamlMapping)
    inner = node.entries["a"].value
    assert isinstance(inner, YamlMapping)
    entry = inner.entries["b"]
    assert (entry.key_span.line, entry.key_span.column, entry.key_span.text) == (3, 3, "b")
    assert (entry.value.span.line, entry.value.span.column, entry.value.span.text) == (3, 6, "12")


@pytest.mark.parametrize(
    ("text", "diagnostic"),
    [
        (
            "a: [1\nb: 2",
            "t.yaml:2:2: error[Y101]: this [ ... ] list is not closed or lacks a comma\n    b: 2\n     ^",
        ),
        (
            "a: &x 1\n",
            "t.yaml:1:4: error[Y103]: anchors and aliases are not allowed\n    a: &x 1\n       ^~~~",
        ),
        ("a: *x\n", "t.yaml:1:4: error[Y103]: anchors and aliases are not allowed\n    a: *x\n       ^~"),
        ("a: !!python/name:os.system 1\n", "t.yaml:1:4: error[Y104]: tags are not allowed"),
        (
            "a: 1\nb: 2\na: 3\n",
            "t.yaml:3:1: error[Y105]: the key 'a' occurs twice; first on line 1\n    a: 3\n    ^",
        ),
        ("[a]: 1\n", "t.yaml:1:1: error[Y106]: a key must be plain text"),
        ("a: .nan\n", "t.yaml:1:4: error[Y107]: '.nan' is not a finite number\n    a: .nan\n       ^~~~"),
        ("a: -.inf\n", "t.yaml:1:4: error[Y107]"),
        ("a: 1e999\n", "t.yaml:1:4: error[Y107]: 1e999 is larger than any real number"),
        (
            "a: 9223372036854775808\n",
            "t.yaml:1:4: error[Y107]: 9223372036854775808 does not fit into 64 bits",
        ),
        ("a: 1\n---\nb: 2\n", "error[Y108]: one file holds one document"),
        ('a: "\\ud800"\n', "t.yaml:1:4: error[Y109]"),
        ('b: 1\na: "\\UFFFFFFFF"\n', "t.yaml:2:5: error[Y101]: this escape is not a character"),
        ('a: "\\q"\n', "t.yaml:1:6: error[Y101]: an escape that YAML does not have"),
        ('a: "\\xZZ"\n', "t.yaml:1:7: error[Y101]: an escape lacks hexadecimal digits"),
        ("a: \x07\n", "t.yaml:1:4: error[Y101]: the character U+0007 is not allowed in YAML"),
        ("a: |x\n", "t.yaml:1:5: error[Y101]: a | or > must be the last character of its line"),
        ("a: {b: c}}\nd: 1\n", "t.yaml:1:10: error[Y101]: one } too many"),
        ("a:\n  - [1]]\n", "t.yaml:2:8: error[Y101]: one ] too many"),
        ("{a: {b: 1}}}\n", "t.yaml:1:12: error[Y101]: one } too many"),
        ("a: ]\n", "t.yaml:1:4: error[Y101]: one ] too many"),
        ("a: {b: [1}}\n", "t.yaml:1:10: error[Y101]: this [ ... ] list is not closed"),
        ("[" * 40, "error[Y102]: more than 32 levels deep"),
    ],
)
def test_invalid_yaml_is_refused_at_its_place(text, diagnostic):
    assert diagnostic in errors(text)


def test_oversized_or_undecodable_file_is_refused():
    found = Diagnostics()
    assert decode("t.yaml", b"#" * (MAX_BYTES + 1), found) is None
    assert found.errors[0].code == "Y102"
    found = Diagnostics()
    assert decode("t.yaml", b"a: 1\nb: \xff\n", found) is None
    assert (found.errors[0].code, found.errors[0].span.line, found.errors[0].span.column) == ("Y109", 2, 4)
    assert "0xFF at offset 8" in found.errors[0].message
    assert found.errors[0].hint == "save it as UTF-8 text"


def test_missing_yaml_file_is_an_input_file_error(tmp_path):
    with pytest.raises(InputFileError, match="No such file"):
        read(str(tmp_path / "none.yaml"), Diagnostics())


@settings(max_examples=300, deadline=None)
@given(
    st.one_of(
        st.text(),
        st.text(alphabet="ab:-[]{}&*!|>'\"\\#,. \n0x~%@"),
        st.binary().map(lambda b: b.decode("latin-1")),
    )
)
def test_any_text_gives_a_value_or_a_diagnostic(text):
    found = Diagnostics()
    node = parse(Source("t.yaml", text), found)
    assert (node is None) == bool(found.errors)
    for diagnostic in found.errors:
        assert diagnostic.render().startswith("t.yaml:")


def parsed_with(text: str, libyaml: bool) -> tuple[object, list[str]]:
    """The nodes of a text with their places, and the diagnostics, with or without the C library."""
    found = Diagnostics()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(yaml, "__with_libyaml__", libyaml)
        node = parse(Source("t.yaml", text), found)
    return with_places(node) if node is not None else None, [d.render() for d in found.errors]


def with_places(node):
    """A node as plain data with its source range; an empty node has none."""
    if not isinstance(node, YamlMapping | YamlList) and not node.value:
        return node.value, type(node.value)
    place = (node.span.start, node.span.end)
    if isinstance(node, YamlMapping):
        entries = node.entries.items()
        return place, {key: (e.key_span.start * bool(key), with_places(e.value)) for key, e in entries}
    if isinstance(node, YamlList):
        return place, [with_places(item) for item in node.items]
    return place, node.value, type(node.value)


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML was built without the C library")
@settings(max_examples=400, deadline=None)
@given(
    st.one_of(
        st.text(alphabet="ab:-[]{},#'\"\\|>!&*%\n 01.é\U0001f600\ufeff\r\x85\u2028"),
        st.lists(
            st.sampled_from(
                [
                    "a: ",
                    "b: ",
                    "- ",
                    "[",
                    "]",
                    "{",
                    "}",
                    ", ",
                    "'x'",
                    '"\\u00e9"',
                    "1.5",
                    "é",
                    "\n",
                    "\n  ",
                    "|\n",
                    "# c",
                ]
            )
        ).map("".join),
    )
)
def test_c_library_and_python_parser_read_equal_values(text):
    # The C library accepts a few spellings that PyYAML refuses, such as a tab between key and value.
    fast, slow = parsed_with(text, True), parsed_with(text, False)
    assert fast == slow or (slow[0] is None and fast[1] == [])


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_give_a_value_or_a_diagnostic(data):
    found = Diagnostics()
    assert (decode("t.yaml", data, found) is None) == bool(found.errors)


def fields(text: str) -> tuple[YamlFields, Diagnostics]:
    found = Diagnostics()
    node = parse(Source("t.yaml", text), found)
    assert node is not None
    return YamlFields(node, found, "a thing"), found


def test_fields_report_all_errors_at_once():
    top, found = fields("name: 5\nspeed: -1\nkind: coptr\nflag: maybe\ncount: 1.5\nmore: x\nlist: 3\n")
    top.text("name")
    top.number("speed", minimum=0.0)
    top.text("kind", choices=("copter", "rover"))
    top.flag("flag")
    top.integer("count")
    top.items("list")
    top.text("needed", required=True)
    top.report_unread()
    assert [f"{d.code} {d.message}" for d in found.errors] == [
        "Y110 a thing needs 'needed'",
        "Y112 'name' must be text, not the number 5",
        "Y113 'speed' must be at least 0, not -1",
        "Y113 'kind' must be one of copter, rover",
        "Y112 'flag' must be true or false, not the text 'maybe'",
        "Y112 'count' must be a whole number, not the number 1.5",
        "Y111 a thing has no key 'more'",
        "Y112 'list' must be a list, not the number 3",
    ]
    assert found.errors[3].hint == "did you mean 'copter'?"


def test_section_that_is_no_mapping_is_reported():
    top, found = fields("a: [1]\nb:\n")
    assert list(top.section("a").entries()) == []
    assert list(top.section("b").entries()) == []
    assert [d.message for d in found.errors] == ["'a' must be a mapping, not a list"]
