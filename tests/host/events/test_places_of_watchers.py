"""The limit of sixteen subscriptions: no client excludes the others."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from lfield.host.subscriptions.subscription_server import MAX_SUBSCRIPTIONS, subscription_to_evict


def test_a_client_with_all_subscriptions_loses_its_oldest_to_another() -> None:
    assert subscription_to_evict(["anna"] * MAX_SUBSCRIPTIONS, "root") == 0
    assert subscription_to_evict(["root", *["anna"] * (MAX_SUBSCRIPTIONS - 1)], "ben") == 1
    assert subscription_to_evict(["anna"] * MAX_SUBSCRIPTIONS, "anna") is None
    assert subscription_to_evict([f"person {n}" for n in range(MAX_SUBSCRIPTIONS)], "root") is None


@given(st.lists(st.sampled_from("abcde"), min_size=MAX_SUBSCRIPTIONS, max_size=200))
def test_subscriptions_are_shared_equally_among_clients(clients: list[str]) -> None:
    """A client that subscribes often enough has its share, give or take one: what it requests, or an equal
    part."""
    subscribers = clients[:MAX_SUBSCRIPTIONS]
    for client in [*clients[MAX_SUBSCRIPTIONS:], *"abcde" * MAX_SUBSCRIPTIONS]:
        evicted = subscription_to_evict(subscribers, client)
        if evicted is not None:
            del subscribers[evicted]
            subscribers.append(client)
    shares = [subscribers.count(name) for name in "abcde"]
    assert sum(shares) == MAX_SUBSCRIPTIONS
    assert max(shares) - min(shares) <= 1
