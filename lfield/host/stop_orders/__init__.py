"""Execution of stop and pause orders that arrive over links or as datagrams."""
