"""For how long a member that sent too much is not accepted again."""

from lfield.net.waiting.bars import FIRST_BAR, FORGOTTEN_AFTER, LONGEST_BAR, Bars


def test_each_time_it_is_twice_as_long_and_never_over_the_longest():
    bars, now, found = Bars(), 100.0, []
    for _ in range(6):
        found.append(bars.bar("bravo", now))
        now += found[-1] + 5.0
    assert found == [1.0, 2.0, 4.0, 8.0, 8.0, 8.0]
    assert LONGEST_BAR < 10.0


def test_it_is_over_by_itself_and_forgotten_later():
    bars = Bars()
    assert bars.left("bravo", 0.0) == 0.0
    bars.bar("bravo", 0.0)
    assert bars.left("bravo", 0.25) == FIRST_BAR - 0.25
    assert bars.left("charlie", 0.25) == 0.0
    assert bars.left("bravo", FIRST_BAR) == 0.0
    assert bars.bar("bravo", FIRST_BAR + FORGOTTEN_AFTER + 1.0) == FIRST_BAR
