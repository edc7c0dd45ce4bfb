"""Signatures of stop and pause orders that are sent as datagrams, and of their answers."""
