"""The virtual machine: blocks, engines, threads. No sockets, files or drivers."""
