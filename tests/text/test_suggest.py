"""Suggestions: the most similar names, with a bounded search for any number and length of names."""

from __future__ import annotations

from unittest.mock import patch

from lfield.text import suggestions


def test_most_similar_name_is_found_in_any_case() -> None:
    assert suggestions.closest("cuont", ["count", "mount", "x"]) == "count"
    assert suggestions.closest("COUNT", ["count"]) == "count"
    assert suggestions.closest("wing", ["count"]) is None


def test_search_among_thousands_is_limited_to_near_names() -> None:
    known = [f"value{number:05}" for number in range(10_000)]
    assert suggestions.closest("valeu05000", [*known, "valeur05000"]) == "valeur05000"
    with patch.object(suggestions, "get_close_matches", return_value=[]) as search:
        suggestions.closest("valeu05000", known)
    assert len(search.call_args.args[1]) <= suggestions.MAX_NAMES


def test_overlong_name_has_no_similar_name() -> None:
    long = "a" * 10_000
    assert suggestions.closest(long, [f"{long}b"]) is None


NAMES = ["arm", "land", "goTo", "goToGlobal", "setSpeed", "mode", "hold", "orbit", "yaw"]


def test_few_names_are_listed_and_many_are_reduced() -> None:
    assert suggestions.choice("driveTo", NAMES[:8], "it has") == f"it has {', '.join(NAMES[:7])} and orbit"
    assert suggestions.choice("driveTo", NAMES, "it has") == "similar names: goTo and goToGlobal"
    assert suggestions.choice("modus", NAMES, "it has") == "similar names: mode"
    assert suggestions.choice("zzz", NAMES, "it has") == f"it has {', '.join(NAMES[:8])}, ..."


def test_similar_names_are_bounded() -> None:
    known = [f"setValue{number}" for number in range(10_000)]
    assert len(suggestions.similar("getValue", known)) == suggestions.MAX_SIMILAR
    assert suggestions.similar("getValue9999", known[suggestions.MAX_NAMES :]) != []
    assert suggestions.similar("land", [*known, "landing"]) == []
    assert suggestions.similar("a" * 10_000, ["a"]) == []
