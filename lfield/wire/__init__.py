"""Messages between hosts and their encoding. No sockets."""
