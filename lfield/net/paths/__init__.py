"""Ways to a host and from it: names, calls, back-off, listening sockets."""
