"""No link is closed falsely in an hour at 20 % loss; a dead link is still found."""

import pytest
from lossy_link import Kernel, Path, ends_after

from lfield.net.health import link_heartbeats
from lfield.net.health.link_heartbeats import LOST_AFTER, MAX_SILENCE, PING_EVERY

HOUR = 3600.0
#: Kernels that have all options of `tcp_options`, and those that have only linear time-outs.
RECENT, OLD = Kernel(0.02, 1.0), Kernel(0.2, 120.0)
NEAR, FAR = Path(0.01, 0.2), Path(0.1, 0.2)


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("path", [NEAR, FAR], ids=["20 ms", "200 ms"])
@pytest.mark.parametrize("kernel", [RECENT, OLD], ids=["recent", "old"])
def test_no_link_is_closed_in_an_hour_at_20_percent_loss(kernel, path, seed):
    for end in ends_after(HOUR, path, kernel, seed):
        assert end.lost == []
        assert end.beats.round_trip.mean is not None


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize(
    ("path", "every"), [(NEAR, 5.5), (FAR, 3.5), (Path(0.05, 0.05), 6.4)], ids=["20 ms", "200 ms", "5 %"]
)
def test_no_idle_link_is_closed_in_an_hour_of_loss_and_heartbeats_stay_rare(path, every, seed):
    ends = ends_after(HOUR, path, OLD, seed, is_idle=True)
    assert [end.lost for end in ends] == [[], []]
    assert sum(end.beats._token for end in ends) <= HOUR / every


def test_a_fixed_time_out_closes_links_at_the_same_loss(monkeypatch):
    """Shows that the loss above distinguishes a good time-out from a bad one."""
    monkeypatch.setattr(link_heartbeats, "MAX_SILENCE", LOST_AFTER)
    lost = [end.lost for seed in range(3) for end in ends_after(HOUR, FAR, OLD, seed)]
    assert any(lost)


@pytest.mark.parametrize(
    ("path", "within"), [(Path(0.01, 0.0), LOST_AFTER), (FAR, MAX_SILENCE)], ids=["calm", "lossy"]
)
def test_a_dead_path_is_found_within_the_time_out(path, within):
    near, far = ends_after(60.0, path, OLD, seed=1)
    simulation = near.simulation
    simulation.path = Path(path.delay, 1.0)
    simulation.run(90.0)
    for end in (near, far):
        assert 0.0 < end.lost[0] - 60.0 <= within + PING_EVERY
