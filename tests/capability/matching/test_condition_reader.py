"""Conditions are parsed by L's parser, and their checked trees are stored in a bundle."""

from __future__ import annotations

import msgspec
import pytest
from small_registry import ATTRIBUTES

from lfield.capability import condition_parser
from lfield.capability.condition_compiler import compile_constants, compile_constraint
from lfield.capability.condition_encoding import decode_tree, encode_tree


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ('note == "open', '"open'),
        ("note == 'one'", "'one'"),
        ("payload > 2kg", "2kg"),
        ("payload & ready", "&"),
        ("payload > 1e999", "1e999"),
        ("(payload > 1", ""),
        ('note == "\\q"', "\\q"),
        ("payload > § 1", "§"),
        ("payload > /* 1", "/*"),
        ("payload. > 1", ">"),
        ("2(1)", "("),
        ("payload + (reach = 1) > 2", "="),
        ("payload += 1", "+="),
        ("{payload, 1} == 2", "{payload, 1}"),
        ("1" + " + 1" * 400, None),
    ],
)
def test_invalid_condition_has_one_error_at_its_place(text: str, place: str | None) -> None:
    tree, mistakes = condition_parser.parse_condition(text)
    if place == "{payload, 1}":
        assert tree is not None, "the checker reports it"
        return
    (mistake,) = mistakes
    assert tree is None
    if place is not None:
        assert text[mistake.start : mistake.end] == place


@pytest.mark.parametrize(
    "text", ["not <= 1 order by not asc", "payload > async order by typeof desc limit 3"]
)
def test_keywords_of_other_languages_are_names(text: str) -> None:
    query, mistakes = condition_parser.parse_query(text)
    assert query is not None, mistakes
    assert len(query.order) == 1


_CONDITIONS = [
    "payload >= 2.0 && environment == terrestrial || !ready",
    "-9223372036854775808 < - 1 - -1",
    "abs(-noise) / 4 < min(payload, reach, 3)",
    'note == "\\n" && agent != "arm2"',
    " && ".join(["ready", "payload >= 2"] * 60),
]


@pytest.mark.parametrize("text", _CONDITIONS)
def test_tree_of_a_condition_survives_its_encoding(text: str) -> None:
    tree = compile_constraint(text, ATTRIBUTES).tree
    data = msgspec.msgpack.decode(msgspec.msgpack.encode(encode_tree(tree)))
    again = decode_tree(text, data)
    assert (encode_tree(again), again.height) == (encode_tree(tree), tree.height)


def _nested(depth: int) -> list[object]:
    data: list[object] = ["name", 0, 1, "x"]
    for _ in range(depth):
        data = ["unary", 0, 1, "-", data]
    return data


@pytest.mark.parametrize(
    "data",
    [
        None,
        [],
        ["name", 0, 1],
        ["name", 0, 9, "x"],
        ["name", 1, 0, "x"],
        ["name", -1, 1, "x"],
        ["other", 0, 1, "x"],
        ["literal", 0, 1, float("nan")],
        ["literal", 0, 1, b"x"],
        ["unary", 0, 1, "%", ["name", 0, 1, "x"]],
        ["binary", 0, 1, "+", 0, 7, ["name", 0, 1, "x"], ["name", 0, 1, "x"]],
        ["call", 0, 1, ["literal", 0, 1, 1], []],
        _nested(100),
    ],
)
def test_invalid_tree_data_is_refused(data: object) -> None:
    with pytest.raises(ValueError, match="condition"):
        decode_tree("x", data)


def test_only_query_constants_are_compiled() -> None:
    found = compile_constants(["payload >= 2 limit 3", "hello", 7, None, True, "paylod > 1"], ATTRIBUTES)
    assert {text: query.limit for text, query in found.items()} == {"payload >= 2 limit 3": 3}
