"""The duration of the ban of a member that sent too much."""

from lfield.net.scheduling.temporary_bans import FIRST_BAN, LONGEST_BAN, RESET_AFTER, TemporaryBans


def test_each_ban_is_twice_as_long_up_to_the_longest():
    bars, now, found = TemporaryBans(), 100.0, []
    for _ in range(6):
        found.append(bars.ban("bravo", now))
        now += found[-1] + 5.0
    assert found == [1.0, 2.0, 4.0, 8.0, 8.0, 8.0]
    assert LONGEST_BAN < 10.0


def test_a_ban_ends_and_is_reset_after_a_while():
    bars = TemporaryBans()
    assert bars.remaining("bravo", 0.0) == 0.0
    bars.ban("bravo", 0.0)
    assert bars.remaining("bravo", 0.25) == FIRST_BAN - 0.25
    assert bars.remaining("charlie", 0.25) == 0.0
    assert bars.remaining("bravo", FIRST_BAN) == 0.0
    assert bars.ban("bravo", FIRST_BAN + RESET_AFTER + 1.0) == FIRST_BAN
