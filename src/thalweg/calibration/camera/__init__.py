"""The boat's camera: interior orientation and poses in the field."""
