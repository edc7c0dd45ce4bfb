"""How a host shows what happens to those who watch it: their links and timers, and how everything stands."""
