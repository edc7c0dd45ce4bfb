"""Messages between hosts, as bytes. No sockets."""
