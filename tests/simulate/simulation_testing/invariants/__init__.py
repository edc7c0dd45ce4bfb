"""Whether a run kept the promises, judged from what was seen of it."""
