"""The list of modules that get deliberate mistakes names what exists, also after modules were moved."""

import importlib.util
import sys
from pathlib import Path

import pytest
import yaml

HERE = Path(__file__).parent


@pytest.fixture
def run(monkeypatch):
    """`run.py` as a module; it begins nothing by itself."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    spec = importlib.util.spec_from_file_location("mutants_run", HERE / "run.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "mutants_run", module)  # its dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


def test_every_module_with_numbers_has_tests_that_answer(run, repository):
    """The rule finds them; the list of exceptions names what exists."""
    modules = {target.module: target.tests for target in run.targets()}
    assert {"thalweg/core/rigid", "thalweg/deformation/volumes", "thalweg_lab/truth/points"} <= set(modules)
    assert not [name for name in modules if "figures" in name or "settings" in name]
    assert [name for name, tests in modules.items() if not tests] == []
    own = {f"bathymetry/test_{name}.py" for name in ("crossings_values", "crossings", "lake")}
    assert own <= set(modules["thalweg/bathymetry/crossings"])
    assert all(test.startswith("bathymetry/") for test in modules["thalweg/bathymetry/crossings"])
    listed = yaml.safe_load((HERE / "targets.yaml").read_text())
    assert set(listed) - set(modules) == set()
    assert [t for tests in listed.values() for t in tests if not (repository / "tests" / t).is_file()] == []


@pytest.mark.parametrize(
    ("text", "mistakes"),
    [
        ("x = cho_factor(m, True)\n", 0),
        ("x = np.full(n, -1)\n", 2),  # no minus, arguments swapped, but not -2
        ("for _ in range(3):\n    f()\n", 0),
        ("for i in levels(3):\n    f(i)\n", 1),
        ("CHUNK: int = 1000\n", 0),
        ("x = max(s, 1e-12)\n", 1),  # min
        ("minimize(f, x, options={'maxiter': 90, 'fatol': 1e-3})\n", 1),  # arguments swapped
        ("x = t * 1e-9\n", 2),
        ("path.mkdir(parents=True, exist_ok=True)\n", 0),
        ("options.use_gpu = False\n", 0),
        ("options.num_threads = max(1, n)\n", 0),
        ("x = np.zeros((0, 2), np.int64)\n", 1),  # arguments swapped, but not ones
        ("x = np.ones(0)\n", 0),
        ("x = np.zeros((n, 3))\n", 1),  # ones
        ("x = max(0, n)\n", 2),  # min, 1
        ("x = pd.concat(parts, ignore_index=True)\n", 0),
        ("x = connected_components(m, directed=False)\n", 0),
        ("x = minimum(m, directed=False)\n", 2),  # maximum, True
        ("x = reach(a, steps=40, width=3)\n", 1),  # width alone
        ("q = x @ M @ x\n", 1),  # M @ x @ x, but not x @ (x @ M)
        ("q = x @ np.linalg.solve(M, x)\n", 1),  # arguments swapped alone
        ("def f(x, seed=3, *, rounds=4, limit=5.0):\n    return np.random.default_rng(seed + 1)\n", 1),
        ("x = np.linspace(a, b, 600)\n", 1),  # arguments swapped, but not 601
        ("x = np.where(s > 0, s, 1.0)\n", 3),  # <= 0, > 1, arguments swapped, but not 2.0
        ("x = np.where(s > 0, t, 1.0)\n", 4),
        ("def f():\n    return InputError('less', n + 1)\n", 0),
    ],
)
def test_what_no_test_of_results_can_see_is_left_alone(run, text, mistakes):
    assert len(run.mutations.sites(text)) == mistakes


def test_an_edit_elsewhere_draws_the_same_mistakes_of_a_function(run, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "SOURCE", tmp_path)
    target = run.Target("module", ())
    function = "def f(a, b):\n    return (a - b) * 2 if a < b else -a / 3\n"

    def drawn(text: str, count: int) -> list[str]:
        """Mistakes of `f` among the first ones."""
        (tmp_path / "module.py").write_text(text)
        run.mistakes.cache_clear()
        found = run.draw([target], count, 1)
        return sorted(run.mutations.in_words(text, site) for _, site in found if site.function == "f")

    edited = "LIMIT = 3.0\n\n\ndef g(x):\n    return x + LIMIT * max(x, 1)\n\n\n" + function
    for count in range(1, 12):
        of_f = drawn(edited, count)
        assert of_f == drawn(function, len(of_f))
    assert len(drawn(edited, 100)) == len(drawn(function, 100)) > len(drawn(edited, 6)) > 0


LIBRARY = """
SCALE = 3.0

def double(x):
    return x + x

def early(x):
    return -x

def never(x):
    return -x

MINUS = early(SCALE)
"""
TESTS = """
from functools import cache
from small_library import values

@cache
def made():
    return values.double(3.0)

def test_makes_what_another_looks_at():
    made()

def test_looks_at_it():
    assert made() == 6.0

def test_what_is_made_at_import():
    assert (values.SCALE, values.MINUS) == (3.0, -3.0)
"""
ASIDE = """
from pathlib import Path
from small_library import values

def test_something_else():
    with Path("marks").open("a") as file:
        file.write(".")
"""


def test_selection_loses_no_mistake_that_all_tests_find(run, tmp_path, monkeypatch):
    """Also one that a test finds which does not execute its line; what no test executes survives at once."""
    texts = {
        "src/small_library/values.py": LIBRARY,
        "tests/small/test_values.py": TESTS,
        "tests/small/test_aside.py": ASIDE,
        "pytest.ini": "[pytest]\npythonpath = src\nmarkers = slow\n workflow\n real\n",
    }
    for name, text in texts.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    for name, folder in {"REPOSITORY": "", "SOURCE": "src"}.items():
        monkeypatch.setattr(run, name, tmp_path / folder)
    monkeypatch.chdir(tmp_path)
    target = run.Target("small_library/values", ("small/test_aside.py", "small/test_values.py"))
    runs = [
        run.Run(target, site, tmp_path / f"{number}.txt", number)
        for number, site in enumerate(run.mistakes(target))
    ]
    assert run.judge(runs, 1, 5.0) == set()
    assert {each.site.function: each.verdict for each in runs} == {
        "": "failed",
        "double": "failed",
        "early": "failed",
        "never": "survived",
    }
    assert [each.site.function for each in runs if not each.cpu_s] == ["never"]
    assert len((tmp_path / "marks").read_text()) == 1 + 2  # once for the lines, and with imports
