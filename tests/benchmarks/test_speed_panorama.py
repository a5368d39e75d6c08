"""Speed of a panorama of the size that a Ricoh Theta V gives, and of the colours of ten million points."""
