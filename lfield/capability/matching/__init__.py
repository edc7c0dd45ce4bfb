"""From a query to offers, best first: conditions, ranking, the search for combinations, explanations."""
