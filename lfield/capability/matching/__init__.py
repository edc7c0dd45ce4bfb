"""From a wish to offers, best first: conditions, ranking, the search for combinations, and why not."""
