"""Hops of coordinators, a two-phase transfer: sender, receiver, records, epochs, terminations. Pure."""
