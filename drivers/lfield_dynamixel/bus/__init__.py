"""The half-duplex bus: packets, a port, one exchange at a time, and control tables read and written by it."""
