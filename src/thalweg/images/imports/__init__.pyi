from .poses import import_orientations as import_orientations
