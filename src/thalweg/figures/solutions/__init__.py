"""INS, camera and fused solution side by side, on one page."""
