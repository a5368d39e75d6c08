"""Where the boat is and how it lies, with covariance: by INS and GNSS, by camera, by all sensors."""
