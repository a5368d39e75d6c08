"""Views of the river as a camera on the boat would see it."""
