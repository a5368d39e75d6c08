"""Error budgets: published tables and own ones, by the formula behind each point's covariance."""
