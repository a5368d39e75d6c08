"""Section `images`: masks, structure from motion, block adjustment, finished orientations, cloud."""
