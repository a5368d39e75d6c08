"""Twin of the underwater light-sheet sensor: speckle, scenes, images of laser lines."""
