"""Signatures of orders to stop and pause that come as datagrams, and of their answers."""
