"""INS, camera and fused solution side by side."""
