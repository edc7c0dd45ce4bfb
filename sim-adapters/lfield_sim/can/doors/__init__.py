"""How clients reach the bus: socketcand over TCP, and slcan dongles on ptys. Protocols first, then doors."""
