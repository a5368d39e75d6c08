"""Published numbers recomputed: error budgets, their unpublished geometry, and a verdict on each cell."""
