"""The list of modules that get deliberate mistakes names what exists, also after modules were moved."""

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

HERE = Path(__file__).parent


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Any:
    """`run.py` as a module; it begins nothing by itself."""
    monkeypatch.setattr(sys, "path", [*sys.path])
    spec = importlib.util.spec_from_file_location("mutants_run", HERE / "run.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "mutants_run", module)  # its dataclasses look themselves up
    spec.loader.exec_module(module)
    return module


def test_modules_tests_and_explained_mistakes_exist(run: Any, repository: Path) -> None:
    listed = yaml.safe_load((HERE / "targets.yaml").read_text())
    targets = [run.Target(name, tuple(tests)) for name, tests in listed.items()]
    assert [target.module for target in targets if not target.path.is_file()] == []
    assert [t for target in targets for t in target.tests if not (repository / "tests" / t).is_file()] == []
    explained = run.explanations(targets)  # refuses a mistake that its function no longer has
    rows = (HERE / "explained.csv").read_text().splitlines()
    assert len(explained) == len(rows) - 1, "a row of explained.csv names no module of targets.yaml"


def test_an_edit_elsewhere_draws_the_same_mistakes_of_a_function(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "SOURCE", tmp_path)
    target = run.Target("module", ())
    function = "def f(a, b):\n    return (a - b) * 2 if a < b else -a / 3\n"

    def drawn(text: str, count: int) -> list[str]:
        """Mistakes of `f` among the first ones."""
        (tmp_path / "module.py").write_text(text)
        run.mistakes.cache_clear()
        found = run.draw([target], count, 1, ())
        return sorted(run.mutations.in_words(text, site) for _, site in found if site.function == "f")

    edited = "LIMIT = 3.0\n\n\ndef g(x):\n    return x + LIMIT * max(x, 1)\n\n\n" + function
    for count in range(1, 12):
        of_f = drawn(edited, count)
        assert of_f == drawn(function, len(of_f))
    assert len(drawn(edited, 100)) == len(drawn(function, 100)) > len(drawn(edited, 6)) > 0
