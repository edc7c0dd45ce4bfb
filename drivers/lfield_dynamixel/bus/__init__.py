"""The half-duplex bus: packets, a port, serialised exchanges, and access to control tables."""
