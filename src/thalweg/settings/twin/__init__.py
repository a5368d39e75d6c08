"""Section `twin`: what the digital twin simulates."""
