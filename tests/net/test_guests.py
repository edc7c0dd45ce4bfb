"""Who is let in before anything is known of him, and who must go."""

import random

from lfield.net.guests import Guests


def test_all_stay_while_there_is_room():
    guests = Guests(3, random.Random(1))
    assert [guests.enter(n, "here") for n in range(3)] == [None] * 3
    guests.leave(1)
    guests.leave(1)
    guests.leave("nobody")
    assert guests.enter(3, "here") is None
    assert guests.enter(4, "here") in (0, 2, 3)


def test_a_flood_from_one_address_pushes_out_its_own():
    guests = Guests(64, random.Random(1))
    guests.enter("peer", "there")
    pushed = [guests.enter(n, "here") for n in range(10_000)]
    assert "peer" not in pushed
    assert sum(who is not None for who in pushed) == 10_000 - 63
    assert guests.enter("next peer", "elsewhere") not in (None, "peer")


def test_at_the_address_of_a_flood_whoever_calls_again_gets_time_to_greet():
    """Thirty more come before the greeting of a peer is read: two in three get through each time."""
    guests, through = Guests(64, random.Random(1)), 0
    for attempt in range(300):
        peer = f"peer {attempt}"
        guests.enter(peer, "here")
        pushed = [guests.enter((attempt, n), "here") for n in range(30)]
        through += peer not in pushed
        guests.leave(peer)
    assert 150 < through < 250


def test_the_last_that_there_is_room_for_pushes_one_out_and_the_only_one_stays():
    guests = Guests(3, random.Random(1))
    assert guests.enter("a", "field", last=True) is None
    assert guests.enter("b", "field", last=True) == "a"
    assert guests.enter("c", "field") is None
    assert guests.enter("d", "elsewhere", last=True) in ("b", "c")
