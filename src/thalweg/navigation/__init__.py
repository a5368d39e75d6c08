"""Trajectories of the boat with covariances: by INS and GNSS, by camera, by all sensors."""
