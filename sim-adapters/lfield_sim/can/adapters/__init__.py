"""Client access to the bus: socketcand over TCP, and slcan adapters on ptys."""
