"""All sensors of the boat with one joint covariance."""
