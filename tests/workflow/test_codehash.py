"""The code version of a rule follows the modules that its script reaches, and nothing else."""

from pathlib import Path

import pytest

from thalweg.core import InputError
from thalweg.workflow import codehash

FILES = {
    "pkg/__init__.py": "",
    "pkg/core/__init__.py": "",
    "pkg/core/a.py": 'def f():\n    """Old words."""\n    return 1\n',
    "pkg/lidar/__init__.py": "",
    "pkg/lidar/b.py": "from pkg.core.a import f\n",
    "pkg/lidar/lazy.py": "def g():\n    from pkg.core import a\n    return a.f()\n",
    "pkg/figures/__init__.py": "",
    "pkg/figures/c.py": "x = 1\n",
    "scripts/direct.py": "from pkg.lidar.b import f\n",
    "scripts/lazy.py": "import pkg.lidar.lazy\n",
    "scripts/picture.py": "from pkg.figures import c\n",
}


def versions(root: Path) -> dict[str, str]:
    for cached in vars(codehash).values():
        if hasattr(cached, "cache_clear"):
            cached.cache_clear()
    return {
        name: codehash.code_version(name, scripts=root / "scripts", source=root)
        for name in ("direct", "lazy", "picture")
    }


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """Facts of these files stay out of the user's cache."""
    place = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(place))
    codehash._new.clear()
    return place


def changed(before, after):
    return [name for name in before if before[name] != after[name]]


@pytest.fixture
def house(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_an_edit_reaches_exactly_its_users(house):
    before = versions(house)
    (house / "pkg/core/a.py").write_text("def f():\n    return 2\n")
    after = versions(house)
    assert changed(before, after) == ["direct", "lazy"]
    (house / "pkg/figures/c.py").write_text("x = 2\n")
    last = versions(house)
    assert changed(after, last) == ["picture"]
    (house / "pkg/figures/look.mplstyle").write_text("font.size: 8\n")
    assert changed(last, versions(house)) == ["picture"]


def test_what_a_script_calls_by_name_counts(house):
    """The script of all pictures imports none of their modules: each picture follows its own."""

    def drawn():
        versions(house)
        called = ("pkg.lidar.b:f", "pkg.lidar.lazy:g", "pkg.figures.c:draw")
        return {
            name: codehash.code_version("picture", name, scripts=house / "scripts", source=house)
            for name in called
        }

    (house / "scripts/picture.py").write_text("")
    before = drawn()
    assert len(set(before.values())) == 3
    (house / "pkg/figures/c.py").write_text("x = 2\n")
    after = drawn()
    assert changed(before, after) == ["pkg.figures.c:draw"]
    (house / "pkg/core/a.py").write_text("def f():\n    return 2\n")
    last = drawn()
    assert changed(after, last) == ["pkg.lidar.b:f", "pkg.lidar.lazy:g"]
    (house / "pkg/figures/look.mplstyle").write_text("font.size: 8\n")
    assert [name for name in last if drawn()[name] != last[name]] == ["pkg.figures.c:draw"]


def test_an_unknown_module_is_named(house):
    with pytest.raises(InputError, match=r"no module pkg\.figures\.nothing"):
        codehash.code_version("picture", "pkg.figures.nothing:f", scripts=house / "scripts", source=house)


def test_a_name_from_a_front_door_counts_as_its_module(house):
    (house / "pkg/core/__init__.pyi").write_text("from .a import f as f\nfrom .d import h as h\n")
    (house / "pkg/core/d.py").write_text("def h():\n    return 1\n")
    (house / "pkg/lidar/b.py").write_text("from pkg.core import f\n")
    before = versions(house)
    (house / "pkg/core/d.py").write_text("def h():\n    return 2\n")
    (house / "pkg/core/__init__.pyi").write_text("from .a import f as f\n")
    assert versions(house) == before
    (house / "pkg/core/a.py").write_text("def f():\n    return 2\n")
    after = versions(house)
    assert changed(before, after) == ["direct", "lazy"]


def test_words_cost_no_rerun(house):
    before = versions(house)
    (house / "pkg/core/a.py").write_text('# why\ndef f():\n    """New words."""\n    return 1\n')
    assert versions(house) == before


def test_an_unknown_script_is_named():
    with pytest.raises(InputError, match=r"no_such_rule\.py: entry script not found"):
        codehash.code_version("no_such_rule")


def test_what_was_parsed_once_is_read_from_the_cache(house, own_cache, monkeypatch):
    first = versions(house)
    codehash._keep()
    (kept,) = (own_cache / "thalweg").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(codehash.ast, "parse", lambda *_: pytest.fail("parsed again"))
        assert versions(house) == first
    # another file is parsed, the others are not
    (house / "pkg/core/a.py").write_text("def f():\n    return 2\n")
    assert versions(house)["direct"] != first["direct"]
    # a damaged cache costs time and nothing else
    kept.write_text('{"abc": 7}')
    (house / "pkg/core/a.py").write_text(FILES["pkg/core/a.py"])
    assert versions(house) == first


def test_a_cache_that_cannot_be_written_does_no_harm(house, monkeypatch):
    (house / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(house / "file"))
    assert versions(house)
    codehash._keep()


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("def _f(x):\n    y = 1\n    return y\n\nN = 3\n", True),  # no words, no types
        (
            "from typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n    from pkg.figures.c import x\n\n"
            'def _f(x: int) -> int:\n    """Words."""\n    y: int = 1\n    return y\n\n'
            'N: Final = 3\n"""What N is."""\n',
            False,  # an import is a statement that runs
        ),
        ('def _f(x: int) -> int:\n    """F."""\n    y: int = 1\n    return y\n\nN: int = 3\n"N."\n', True),
        ("def _f(x: int) -> int:\n    y: int = 2\n    return y\n\nN: int = 3\n", False),
    ],
)
def test_words_and_types_do_not_run(house, text, same):
    module = house / "pkg/figures/c.py"
    module.write_text("def _f(x: str) -> str:\n    y = 1\n    return y\n\nN = 3\n")
    before = versions(house)["picture"]
    module.write_text(text)
    assert (versions(house)["picture"] == before) is same


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("class A:\n    x: int = 1\n", "class A:\n    x: float = 1\n"),
        ("def read(path: str): ...\n", "def read(path: Path): ...\n"),
    ],
    ids=["a field of a document", "a parameter of a job"],
)
def test_types_that_convert_values_count(house, before, after):
    module = house / "pkg/figures/c.py"
    module.write_text(before)
    old = versions(house)["picture"]
    module.write_text(after)
    assert versions(house)["picture"] != old


def test_imports_for_types_reach_nothing(house):
    head = "from typing import TYPE_CHECKING\n\n"
    module = house / "pkg/figures/c.py"
    module.write_text(head)
    before = versions(house)["picture"]
    module.write_text(head + "if TYPE_CHECKING:\n    from pkg.core.a import f\n")
    assert versions(house)["picture"] == before
