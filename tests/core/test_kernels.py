"""Machine code that numba keeps belongs to all that it was made from, in other modules too."""

import importlib
import os
import pwd
import re
import sys
import time
from types import SimpleNamespace

import pytest

from thalweg.core import kernels, others_may_write

FILES = {
    "__init__.py": "",
    "constants.py": "import numpy as np\nG = 2.0\nTABLE = np.array([1.0, 2.0])\n",
    "shared.py": (
        "from thalweg.core.kernels import njit\n@njit(cache=True)\ndef twice(x):\n    return 2.0 * x\n"
    ),
    "user.py": (
        "from thalweg.core.kernels import njit\nfrom bench.constants import G, TABLE\n"
        "from bench.shared import twice\n@njit(cache=True)\ndef f(x):\n    return G * twice(x) + TABLE[0]\n"
    ),
    "third.py": (
        "from thalweg.core.kernels import njit\nfrom bench.user import f\n"
        "@njit(cache=True)\ndef g(x):\n    return f(x)\n"
    ),
    "alone.py": "from thalweg.core.kernels import njit\n@njit(cache=True)\ndef h(x):\n    return x\n",
}


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Imports a module of a small package anew, as another process would."""
    for name, text in FILES.items():
        path = tmp_path / "bench" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(kernels, "PACKAGES", {"bench"})
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)

    def forget():
        for name in [name for name in sys.modules if name.split(".")[0] == "bench"]:
            del sys.modules[name]
        for known in [name for name in kernels._folders if name.split(".")[0] == "bench"]:
            del kernels._folders[known]
        importlib.invalidate_caches()

    def load(name):
        forget()
        return importlib.import_module(f"bench.{name}")

    yield load
    forget()


def edit(tmp_path, name, old, new):
    path = tmp_path / "bench" / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    # Python itself takes a file of the same length and second for unchanged
    os.utime(path, (time.time() + len(text), time.time() + 7))


@pytest.mark.parametrize(
    ("name", "old", "new", "changed"),
    [
        ("shared.py", "2.0 *", "3.0 *", {"shared", "user", "third"}),
        ("constants.py", "G = 2.0", "G = 5.0", {"user", "third"}),
        ("constants.py", "[1.0", "[4.0", {"user", "third"}),
        ("alone.py", "return x", "return -x", {"alone"}),
    ],
)
def test_an_edit_reaches_the_kernels_that_take_from_the_file(tmp_path, bench, name, old, new, changed):
    modules = ["shared", "user", "third", "alone"]
    before = {module: kernels.stamp(vars(bench(module))) for module in modules}
    assert before == {module: kernels.stamp(vars(bench(module))) for module in modules}
    edit(tmp_path, name, old, new)
    after = {module: kernels.stamp(vars(bench(module))) for module in modules}
    assert {module for module in modules if before[module] != after[module]} == changed


def test_an_edit_of_a_shared_kernel_gives_another_folder_and_new_numbers(tmp_path, bench):
    def user_folders():
        return {folder.name for folder in (tmp_path / "cache/thalweg/kernels").glob("bench.user-*")}

    assert bench("user").f(1.0) == 2.0 * 2.0 + 1.0
    first = user_folders()
    again = bench("user").f
    assert again(1.0) == 5.0
    assert sum(again.stats.cache_hits.values()) == 1  # kept machine code is used
    assert user_folders() == first
    edit(tmp_path, "shared.py", "2.0 *", "3.0 *")
    edit(tmp_path, "constants.py", "G = 2.0", "G = 5.0")
    assert bench("user").f(1.0) == 5.0 * 3.0 + 1.0
    assert len(user_folders()) == 2


def test_folders_that_are_not_used_for_long_are_removed(tmp_path, bench):
    base = tmp_path / "cache/thalweg/kernels"
    for name, days in (("thalweg.old-0", 31), ("thalweg.new-0", 29)):
        (base / name).mkdir(parents=True)
        os.utime(base / name, (time.time() - days * 86_400,) * 2)
    bench("alone")
    assert {folder.name.split("-")[0] for folder in base.iterdir()} == {"thalweg.new", "bench.alone"}


def test_where_no_cache_can_be_written_machine_code_stands_beside_the_module(tmp_path, bench, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert bench("alone").h(3) == 3
    assert list((tmp_path / "bench/__pycache__").glob("bench.alone-*/*.nbi"))


@pytest.mark.parametrize("mode", [0o777, 0o1777])
def test_machine_code_is_not_taken_from_where_others_may_put_theirs(
    tmp_path, bench, monkeypatch, caplog, mode
):
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", "")
    kernels._tell_shared.cache_clear()
    shared = tmp_path / "cache/thalweg/kernels"
    shared.mkdir(parents=True)
    shared.chmod(mode)
    assert bench("alone").h(3) == 3
    assert list(shared.iterdir()) == []
    assert list((tmp_path / "bench/__pycache__").glob("bench.alone-*/*.nbi"))
    assert "machine code is not kept in" in caplog.text
    assert caplog.text.count("others may write") == 1
    shared.chmod(0o755)
    assert bench("alone").h(3) == 3
    assert len(list(shared.glob("bench.alone-*/*.nbi"))) == 1


def test_whose_folder_it_is(tmp_path, monkeypatch):
    (tmp_path / "sticky").mkdir()
    (tmp_path / "sticky").chmod(0o1777)
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    of_group = tmp_path / "group"
    of_group.mkdir()
    of_group.chmod(0o775)
    assert [
        others_may_write(tmp_path / name) for name in (".", "new", "sticky/new", "sticky", "open/new")
    ] == [*(False, False, False), *(True, True)]
    monkeypatch.setattr("grp.getgrgid", lambda number: SimpleNamespace(gr_name="users"))
    assert others_may_write(of_group)
    name = pwd.getpwuid(os.getuid()).pw_name
    monkeypatch.setattr("grp.getgrgid", lambda number: SimpleNamespace(gr_name=name))
    assert not others_may_write(of_group)
    monkeypatch.setattr("os.getuid", lambda: 4711)
    monkeypatch.setattr("pwd.getpwuid", lambda number: SimpleNamespace(pw_name="another"))
    (tmp_path / "own").mkdir()
    if (tmp_path / "own").stat().st_uid:  # the super-user's is nobody else's
        assert others_may_write(tmp_path / "own")


def test_all_modules_take_numba_from_one_place(repository):
    taken = re.compile(
        r"^\s*(from numba\b|import numba\b.*\bas\b)|THREADING_LAYER|NUMBA_CACHE_DIR", re.MULTILINE
    )
    files = [path for path in (repository / "src").rglob("*.py") if taken.search(path.read_text())]
    assert [path.name for path in files] == ["kernels.py"]
