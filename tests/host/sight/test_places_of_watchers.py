"""Who watches where sixteen may: nobody shuts all others out."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from lfield.host.subscriptions.subscription_server import MAX_SUBSCRIPTIONS, subscription_to_evict


def test_who_has_all_places_gives_the_oldest_to_somebody_else() -> None:
    assert subscription_to_evict(["anna"] * MAX_SUBSCRIPTIONS, "root") == 0
    assert subscription_to_evict(["root", *["anna"] * (MAX_SUBSCRIPTIONS - 1)], "ben") == 1
    assert subscription_to_evict(["anna"] * MAX_SUBSCRIPTIONS, "anna") is None
    assert subscription_to_evict([f"person {n}" for n in range(MAX_SUBSCRIPTIONS)], "root") is None


@given(st.lists(st.sampled_from("abcde"), min_size=MAX_SUBSCRIPTIONS, max_size=200))
def test_whoever_comes_often_has_no_more_than_a_share(comers: list[str]) -> None:
    """Whoever has come as often as that has a share, give or take one: what it wants, or an equal part."""
    taken = comers[:MAX_SUBSCRIPTIONS]
    for comes in [*comers[MAX_SUBSCRIPTIONS:], *"abcde" * MAX_SUBSCRIPTIONS]:
        way = subscription_to_evict(taken, comes)
        if way is not None:
            del taken[way]
            taken.append(comes)
    shares = [taken.count(name) for name in "abcde"]
    assert sum(shares) == MAX_SUBSCRIPTIONS
    assert max(shares) - min(shares) <= 1
