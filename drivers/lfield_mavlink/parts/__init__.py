"""What a vehicle can do, by topic: the `do_...` of its manifest, and what they share."""
