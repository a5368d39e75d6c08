"""Post-processed kinematic positions by RTKLIB, from SBP and RINEX."""
