"""UDP datagrams with stop and pause orders: the sockets of a host, on the ports of its listening sockets."""
