"""The transport over Zenoh against the kit: over one router, two linked routers, and from peer to peer."""

import pytest
from certificates import Team
from fabric import Router, ZenohBench, free_endpoint, running_router

from lfield.net.tls import TlsIdentity
from lfield.net.zenoh.config import ZenohConfig
from lfield.testing.transport_kit import TransportKit

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
pytestmark = pytest.mark.process
router = pytest.fixture(running_router, scope="module")


@pytest.fixture(scope="module")
def linked_router(router):
    made = Router(router.endpoint)
    yield made
    made.kill()


class TestOneRouter(TransportKit):
    @pytest.fixture
    def bench(self, router):
        config = ZenohConfig((router.endpoint,))
        bench = ZenohBench(config, config)
        yield bench
        bench.close()


class TestTwoRouters(TransportKit):
    @pytest.fixture
    def bench(self, router, linked_router):
        bench = ZenohBench(
            ZenohConfig((router.endpoint,)),
            ZenohConfig((linked_router.endpoint,)),
            tls=TlsIdentity(Team().host("alpha")),
        )
        yield bench
        bench.close()


class TestPeers(TransportKit):
    @pytest.fixture
    def bench(self):
        endpoint = free_endpoint()
        bench = ZenohBench(
            ZenohConfig((endpoint,), listen=("tcp/127.0.0.1:0",)),
            ZenohConfig(listen=(endpoint,)),
            tls=TlsIdentity(Team().host("alpha")),
        )
        yield bench
        bench.close()
