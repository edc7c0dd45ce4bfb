"""Loss and bytes of a link, from the counters of the kernel."""

import socket
from contextlib import suppress

import pytest

from lfield.net.health import tcp_options
from lfield.net.health.tcp_options import MAX_MARGIN, MIN_MARGIN, margin, read_counts, set_options
from lfield.net.health.traffic import MIN_SEGMENTS, PERIOD, SAMPLE_EVERY, LinkTraffic, TcpCounts


def after(*rows: tuple[float, int, int]) -> LinkTraffic:
    """Counters read at some times: segments sent, and how many of them were repeated."""
    traffic = LinkTraffic()
    for now, segments, repeated in rows:
        traffic.record(TcpCounts(100 * segments, 7, segments, repeated), now)
    return traffic


def test_loss_is_the_share_of_repeated_segments():
    assert after((0.0, 0, 0), (10.0, 50, 10)).loss == pytest.approx(0.2)


def test_too_few_segments_give_no_loss():
    assert after((0.0, 0, 0), (10.0, MIN_SEGMENTS - 1, 2)).loss is None


def test_loss_covers_the_last_minute():
    rows = [(SAMPLE_EVERY * n, 100 * n, 10 * min(n, 4)) for n in range(100)]
    assert after(*rows[:5]).loss == pytest.approx(0.1)
    assert after(*rows).loss == 0.0
    assert len(after(*rows)._samples) <= PERIOD / SAMPLE_EVERY + 2


def test_a_link_with_little_traffic_has_the_loss_of_its_whole_time():
    rows = [(float(second), 20 + second // 60, 10) for second in range(600)]
    assert after(*rows).loss == pytest.approx(10 / 29)


def test_a_kernel_without_counters_gives_no_loss():
    traffic = LinkTraffic()
    traffic.record(None, 1.0)
    assert (traffic.loss, traffic.counts) == (None, None)


def test_the_margin_follows_the_round_trip_within_bounds():
    assert [margin(seconds) for seconds in (0.0, 0.2, 3.0)] == [MIN_MARGIN, 0.1, MAX_MARGIN]


@pytest.fixture
def pair():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        near = socket.create_connection(listener.getsockname())
        far, _ = listener.accept()
    with near, far:
        yield near, far


def test_the_kernel_counts_the_bytes_of_a_connection(pair):
    near, far = pair
    set_options(near)
    near.sendall(bytes(1000))
    left = 1000
    while left:
        left -= len(far.recv(left))
    far.sendall(bytes(50))
    assert near.recv(50)
    counts = read_counts(near)
    if counts is None:
        pytest.skip("this kernel does not count what was sent")
    assert (counts.bytes_sent, counts.bytes_received, counts.repeated) == (1000, 50, 0)
    assert counts.segments >= 1


def test_linear_time_outs_are_set_on_every_kernel(pair):
    near, _ = pair
    set_options(near)
    assert near.getsockopt(socket.IPPROTO_TCP, tcp_options.THIN_LINEAR_TIMEOUTS) == 1
    assert near.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_an_unknown_socket_option_is_left_out(pair, monkeypatch):
    near, _ = pair
    for name in ("RTO_MAX_MS", "RTO_MIN_US", "DELACK_MAX_US"):
        monkeypatch.setattr(tcp_options, name, 9999)
    set_options(near)
    tcp_options.set_time_outs(near, 0.2)
    assert near.getsockopt(socket.IPPROTO_TCP, tcp_options.THIN_LINEAR_TIMEOUTS) == 1


@pytest.mark.parametrize(("round_trip", "linear"), [(0.02, 1), (0.4, 1), (0.5, 0), (3.0, 0)])
def test_a_long_round_trip_makes_time_outs_double(pair, round_trip, linear):
    near, _ = pair
    set_options(near)
    tcp_options.set_time_outs(near, round_trip)
    assert near.getsockopt(socket.IPPROTO_TCP, tcp_options.THIN_LINEAR_TIMEOUTS) == linear
    with suppress(OSError):
        longest = near.getsockopt(socket.IPPROTO_TCP, tcp_options.RTO_MAX_MS)
        assert longest == max(1000, 4000 * round_trip if not linear else 0)


def test_a_unix_socket_has_no_tcp_counts():
    one, other = socket.socketpair()
    with one, other:
        assert read_counts(one) is None
