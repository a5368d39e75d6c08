"""Reference clouds as meshes with sigmas."""
