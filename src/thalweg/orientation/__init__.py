"""Where the boat is and how it lies: trajectories from INS, GNSS and (later rooms permitting) cameras."""
