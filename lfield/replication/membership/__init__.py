"""Gossip failure detector and ring overlay of a team. Pure."""
