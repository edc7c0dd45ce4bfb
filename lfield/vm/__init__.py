"""Runs programs: the block, the engine, threads. No sockets, files or drivers."""
