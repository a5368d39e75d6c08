"""Files of the tests of this folder."""

import pytest


@pytest.fixture
def saved(tmp_path):
    """Saves a file of this name with a text or bytes."""

    def save(name, content):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return save
