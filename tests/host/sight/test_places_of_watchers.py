"""Who watches where sixteen may: nobody shuts all others out."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from lfield.host.watching.watchers import MOST, giving_way


def test_who_has_all_places_gives_the_oldest_to_somebody_else() -> None:
    assert giving_way(["anna"] * MOST, "root") == 0
    assert giving_way(["root", *["anna"] * (MOST - 1)], "ben") == 1
    assert giving_way(["anna"] * MOST, "anna") is None
    assert giving_way([f"person {n}" for n in range(MOST)], "root") is None


@given(st.lists(st.sampled_from("abcde"), min_size=MOST, max_size=200))
def test_whoever_comes_often_has_no_more_than_a_share(comers: list[str]) -> None:
    """Whoever has come as often as that has a share, give or take one: what it wants, or an equal part."""
    taken = comers[:MOST]
    for comes in [*comers[MOST:], *"abcde" * MOST]:
        way = giving_way(taken, comes)
        if way is not None:
            del taken[way]
            taken.append(comes)
    shares = [taken.count(name) for name in "abcde"]
    assert sum(shares) == MOST
    assert max(shares) - min(shares) <= 1
