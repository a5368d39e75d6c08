"""Names that a version promises to keep are those of the list."""

from tests.stable_names import listed, names


def test_no_stable_name_is_gone_or_unlisted():
    found = names()
    assert listed() - found == set(), "gone: a new major version, or put it back (docs/stable.md)"
    assert found - listed() == set(), "new: list them by .venv/bin/python tests/stable_names.py"
    assert {"command thalweg run", "option thalweg bed --crs", "extra images"} <= found
    assert len(found) > 2000
