"""Scheduling of received messages: CPU budgets and fair queues per peer."""
