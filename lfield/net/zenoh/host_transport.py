"""The transport of a process: TCP and Unix sockets, and Zenoh for addresses in a fabric."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.errors import AddressError, LfieldError
from lfield.net.transport import is_zenoh, split_addresses
from lfield.net.zenoh.config import NETWORK

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lfield.net.tcp_transport import TcpTransport
    from lfield.net.transport import Link, LinkHandler, Listener
    from lfield.net.zenoh.transport import ZenohTransport
    from lfield.text.log_messages import LogLine


class CombinedListener:
    """Listeners at several addresses of one host."""

    def __init__(self, listeners: Sequence[Listener]) -> None:
        self._listeners = listeners

    @property
    def address(self) -> str:
        """See `Listener.address`."""
        return ",".join(each.address for each in self._listeners)

    def close(self) -> None:
        """See `Listener.close`."""
        for each in self._listeners:
            each.close()


class HostTransport:
    """`tcp`, and Zenoh as `NETWORK` configures it, with links of the same kind. See `Transport`.

    Of several addresses, all addresses of the kind of the first are tried before the others.
    """

    def __init__(self, tcp: TcpTransport, connect_timeout: float = 5.0) -> None:
        self.tcp, self._connect_timeout = tcp, connect_timeout
        self._zenoh: ZenohTransport | None = None
        self._note: Callable[[LogLine], None] = lambda line: None

    def log_to(self, note: Callable[[LogLine], None]) -> None:
        """Write log lines with `note` from now on."""
        self._note = note
        self.tcp.log_to(note)
        if self._zenoh is not None:
            self._zenoh.log_to(note)

    def close(self) -> None:
        """Leave the fabric; its links end without a message to their peers."""
        if self._zenoh is not None:
            self._zenoh.close()
            self._zenoh = None

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> Listener:
        """See `Transport.listen`."""
        listeners: list[Listener] = []
        try:
            for group in _groups(address):
                if is_zenoh(group):
                    listeners.append(await self._fabric(group).listen(group, on_link))
                else:
                    listeners.append(await self.tcp.listen(group, on_link))
        except LfieldError:
            CombinedListener(listeners).close()
            raise
        return listeners[0] if len(listeners) == 1 else CombinedListener(listeners)

    async def connect(self, address: str, handler: LinkHandler, host: str = "") -> Link:
        """See `Transport.connect`."""
        *earlier, last = _groups(address)
        failures: list[AddressError] = []
        for group in earlier:
            try:
                return await self._connect(group, handler, host)
            except AddressError as error:
                failures.append(error)
        try:
            return await self._connect(last, handler, host)
        except AddressError as error:
            if not failures:
                raise
            reasons = [f"{each.address}: {each.reason}" for each in [*failures, error]]
            raise AddressError(address, "; ".join(reasons)) from None

    async def _connect(self, address: str, handler: LinkHandler, host: str) -> Link:
        if is_zenoh(address):
            return await self._fabric(address).connect(address, handler, host)
        return await self.tcp.connect(address, handler, host)

    def _fabric(self, address: str) -> ZenohTransport:
        if self._zenoh is None:
            if NETWORK.config is None:
                raise AddressError(
                    address, "Zenoh has no router to connect to: the inventory needs a section 'zenoh'"
                )
            # Most hosts have no address in a fabric.
            from lfield.net.zenoh.transport import ZenohTransport

            self._zenoh = ZenohTransport(NETWORK.config, self.tcp.new_link, self._connect_timeout)
            self._zenoh.log_to(self._note)
        return self._zenoh


def _groups(address: str) -> list[str]:
    """The addresses in order; TCP addresses are in one group, because TCP tries them at the same time."""
    addresses = split_addresses(address)
    tcp = ",".join(part for part in addresses if not is_zenoh(part))
    groups = dict.fromkeys(part if is_zenoh(part) else tcp for part in addresses)
    return list(groups)
