"""Where the sensors sit on the boat: fields of targets, adjustments, one joint covariance."""
