"""Checks over several sections: files, area, place, mounts."""
