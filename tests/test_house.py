"""Rules that no single package can keep: imports, lock file, rules, scripts, tracked files."""

import ast
import importlib
import json
import re
import runpy
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from graphlib import TopologicalSorter
from importlib.metadata import packages_distributions
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pydantic import BaseModel

from tests.conftest import real_recordings_skipped
from tests.counted import compared, count_by_folder, count_tests
from thalweg.core import read_yaml
from thalweg.settings import Campaign
from thalweg.workflow.codehash import imported_modules, modules_behind, reached_modules
from thalweg.workflow.figures import rows_of

# ---------------------------------------------------------------- lock file


def locked(repository: Path) -> dict[str, list[str]]:
    """Versions of each package in the lock file; packages with markers may have several."""
    found: dict[str, list[str]] = {}
    for name, version in re.findall(
        r"(?m)^([\w.-]+)==([\w.+]+)", (repository / "envs/requirements.lock").read_text()
    ):
        found.setdefault(canonicalize_name(name), []).append(version)
    return found


def test_every_locked_package_has_its_hash_and_names_no_place(repository):
    text = (repository / "envs/requirements.lock").read_text()
    # pip's own rule: a line that ends in a backslash goes on in the next
    lines = [
        line
        for line in text.replace("\\\n", " ").splitlines()
        if line.strip() and not line.lstrip().startswith("#")
    ]
    assert len(lines) > 50
    form = re.compile(r"[\w.-]+==[\w.+]+( ; [^#]+?)?(\s+--hash=sha256:[0-9a-f]{64})+\s*")
    assert [line[:60] for line in lines if not form.fullmatch(line)] == []
    place = re.compile(r"https?:|index-url|find-links|file:| @ |(?<![\w.])[/~][\w.-]+/|[A-Za-z]:\\")
    assert [line for line in text.splitlines() if place.search(line)] == []


def test_every_dependency_is_locked_at_a_version_that_fits(repository):
    settings = tomllib.loads((repository / "pyproject.toml").read_text())
    project = settings["project"]
    extras = project["optional-dependencies"]
    of_extras = chain.from_iterable(extras[name] for name in sorted(set(extras) - {"all", "ouster"}))
    wanted = [*project["dependencies"], *of_extras, *settings["build-system"]["requires"]]
    versions = locked(repository)
    for requirement in map(Requirement, wanted):
        found = versions.get(canonicalize_name(requirement.name), [])
        assert found, f"{requirement} is not in the lock file: run `make lock`"
        assert all(version in requirement.specifier for version in found), (requirement, found)


def test_every_dependency_is_used_and_has_its_why_and_licence(repository):
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    extras = [project["optional-dependencies"][name] for name in ("images", "mesh", "gnss", "e57", "report")]
    wanted = [*project["dependencies"], *chain.from_iterable(extras)]
    here = [r for r in map(Requirement, wanted) if r.marker is None or r.marker.evaluate()]
    told = runpy.run_path(str(repository / "docs/make_pages.py"))["dependencies"](repository)
    assert [name for name, _, _ in told] == [r.name for r in here]  # each line has its remark
    assert all(re.search(r"MIT|BSD|Apache|Python Software Foundation", licence) for _, _, licence in told), (
        told
    )
    files = [p for name in ("src", "workflow") for p in (repository / name).rglob("*.py")]
    tops = {name.split(".")[0] for path in files for name, _ in imports(path)}
    gives = {
        canonicalize_name(one)
        for top, each in packages_distributions().items()
        if top in tops
        for one in each
    }
    behind = {"snakemake", "lazy-loader"}  # the command, and front doors
    unused = {canonicalize_name(r.name) for r in here} - gives - behind
    assert unused == set()


def test_the_conda_environment_keeps_step_with_the_lock(repository):
    listed = yaml.safe_load((repository / "envs/thalweg.yaml").read_text())["dependencies"]
    pins = [text for entry in listed for text in (entry["pip"] if isinstance(entry, dict) else [entry])]
    versions = locked(repository)
    of_lock = {canonicalize_name(conda): name for name, conda in CONDA_NAMES.items()}
    for text in pins:
        name, *pinned = re.split("==?", text)
        if name in ("python", "pip"):
            continue
        assert pinned, f"{name} is not pinned"
        found = versions[of_lock.get(canonicalize_name(name), canonicalize_name(name))]
        assert any(f"{v}.".startswith(f"{pinned[0]}.") for v in found), (text, found)


def test_actions_are_pinned_by_commit(repository):
    """A tag can be moved to other code; the tag that a commit had stands behind it, for people."""
    text = (repository / ".github/workflows/ci.yml").read_text()
    uses = re.findall(r"uses: (.*)", text)
    assert len(uses) == text.count("uses:") > 5
    assert [
        each for each in uses if not re.match(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+\b", each)
    ] == []


CONDA_NAMES = {"matplotlib": "matplotlib-base", "lazrs": "lazrs-python", "lazy-loader": "lazy_loader"}
"""Where conda-forge calls a package otherwise."""
BEHIND_OTHERS = {"pydantic-core", "contourpy"}
"""Comes with a package that is listed."""


def test_every_import_is_provided_by_lock_and_conda_environment(repository):
    files = [*(repository / "src").rglob("*.py"), *(repository / "workflow/scripts").glob("*.py")]
    tops = {name.split(".")[0] for path in files for name, _ in imports(path)}
    # the extra `ouster` cannot be locked together with Snakemake: docs/decisions.md
    foreign = tops - set(sys.stdlib_module_names) - {"thalweg", "thalweg_lab", "ouster"}
    foreign -= {"snakemake"}  # what forks its jobs runs in Snakemake's own environment
    of_import = packages_distributions()
    wanted = {canonicalize_name(of_import[top][0]) for top in foreign} - BEHIND_OTHERS
    assert {"numpy", "opencv-python-headless", "pillow"} <= wanted
    assert wanted - set(locked(repository)) == set()
    listed = yaml.safe_load((repository / "envs/thalweg.yaml").read_text())["dependencies"]
    texts = [text for entry in listed for text in (entry["pip"] if isinstance(entry, dict) else [entry])]
    conda = {re.split("[=<>]", text)[0] for text in texts}
    assert {name for name in wanted if CONDA_NAMES.get(name, name) not in conda} == set()


# ---------------------------------------------------------------- Open3D without libusb

NO_LIBUSB = """\
import ctypes, ctypes.util, sys
ctypes.util.find_library = lambda name: None
loaded, real = [], ctypes.CDLL
class Watched(real):
    def __init__(self, name, *rest, **more):
        loaded.append(name)
        super().__init__(name, *rest, **more)
ctypes.CDLL = Watched
{broken}
from thalweg.core.errors import ThalwegError
from thalweg.core.geometry.raycast import _open3d
try:
    print(_open3d().__name__, any("usb" in str(name) for name in loaded))
except ThalwegError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("broken", "answers"),
    [
        ("", ["open3d True"]),
        (
            "sys.modules['libusb_package'] = None",
            ["needs the package libusb_package", "the extra 'mesh' of thalweg", "thalweg[mesh]"],
        ),
        (
            "import libusb_package; libusb_package.get_library_path = lambda: 'damaged.so'",
            ["Open3D cannot be loaded", "damaged.so", "on Debian the packages libgl1 and libgomp1"],
        ),
    ],
    ids=["the wheel's libusb", "no wheel", "a damaged wheel"],
)
def test_open3d_on_a_system_without_libusb(repository, broken, answers):
    """Minimal systems lack libusb-1.0, and Open3D's import failed there with a bare OSError."""
    run = subprocess.run(
        [sys.executable, "-c", NO_LIBUSB.format(broken=broken)],
        cwd=repository / "src",
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    for answer in answers:
        assert answer in run.stdout


# ---------------------------------------------------------------- one entrance for each kind of file

ENTRANCES = {
    r"\bjson\.loads?\(": {"core/documents.py", "ingest/ppk/worker.py"},  # the worker is a process without us
    r"\byaml\.(?:safe_|full_|unsafe_)?load|\byaml\.Loader": {"core/documents.py"},
    r"\bElementTree\.(?:parse|fromstring|XML|iterparse)\(|\bET\.(?:parse|fromstring)\(|XMLParser\(": {
        "core/documents.py"
    },
    r"\brasterio\.open\(\s*(?:\w+|\w+\[\w+\])\s*\)": {"core/raster.py"},
}
"""What opens files of others or takes them apart, and the only modules that may."""
INSIDE = ("figures", "workflow")
"""Parts that read what jobs wrote, which each job checks (`workflow.provenance`), and no files of others."""


def entrances_passed(source: Path) -> list[str]:
    """Places that read JSON, YAML, XML or rasters on their own: a failure there would be a traceback."""
    return [
        f"{inside}: {found[0]}"
        for path in sorted(source.rglob("*.py"))
        if not set(INSIDE) & set((inside := path.relative_to(source)).parts)
        for pattern, allowed in ENTRANCES.items()
        if inside.as_posix() not in allowed
        for found in re.finditer(pattern, path.read_text())
    ]


def test_files_of_others_come_through_one_entrance_each(repository, tmp_path):
    assert entrances_passed(repository / "src/thalweg") == []
    text = "json.loads(a)\nyaml.safe_load(b)\nElementTree.parse(c)\nrasterio.open(d)\nrasterio.open(e, 'w')\n"
    (tmp_path / "a.py").write_text(text)
    assert len(entrances_passed(tmp_path)) == 4


# ---------------------------------------------------------------- who imports whom

PACKAGES = (
    "core",
    "settings",
    "ingest",
    "clocks",
    "calibration",
    "images",
    "navigation",
    "lidar",
    "panorama",
    "surface",
    "budgets",
    "bathymetry",
    "fusion",
    "accuracy",
    "deformation",
    "figures",
    "lightsheet",
)
"""Data flow down this list."""

MAY_IMPORT = {
    **{name: set(PACKAGES[: i + 1]) for i, name in enumerate(PACKAGES)},
    "workflow": {"core", "settings", "workflow"},
    "commands": {*PACKAGES, "workflow", "commands"},
    "cli": {*PACKAGES, "workflow", "commands", "cli"},
    "__main__": {"cli"},
    "__init__": set(),
}

DRAWING = {"matplotlib", "mpl_toolkits", "cmcrameri"}


def imports(path: Path) -> tuple[tuple[str, int], ...]:
    """Dotted names that a file imports, at its head or lazily, with their lines."""
    return tuple(code_of(path.read_text()).imports)


@dataclass
class Code:
    """What tests ask of a file's code."""

    imports: list[tuple[str, int]] = field(default_factory=list)
    defaults: list[tuple[str, ast.expr]] = field(default_factory=list)
    words: set[Any] = field(default_factory=set)


WORD_OF = {ast.Attribute: "attr", ast.Name: "id", ast.arg: "arg", ast.keyword: "arg", ast.Constant: "value"}


@cache  # several tests ask for those of all files, which takes 3 s
def code_of(text: str) -> Code:
    """Imports with their lines, stated defaults (`stated_defaults`) and words (`words`) of a file."""
    code = Code()
    for node in ast.walk(ast.parse(text)):
        if (word := WORD_OF.get(type(node))) is not None:
            code.words.add(getattr(node, word))
            continue
        match node:
            case ast.Import():
                code.imports += ((alias.name, node.lineno) for alias in node.names)
            case ast.ImportFrom():
                module = "." * node.level + (node.module or "")
                code.imports += (
                    (f"{module}.{alias.name}" if module == "thalweg" else module, node.lineno)
                    for alias in node.names
                )
            case ast.Call(func=ast.Name("optional"), args=[ast.Constant(str(module))]):
                code.imports.append((module, node.lineno))
            case ast.ClassDef():
                code.defaults += (
                    (item.target.id, item.value)
                    for item in node.body
                    if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name) and item.value
                )
            case ast.FunctionDef(args=a):
                last = [*a.posonlyargs, *a.args][-len(a.defaults) :] if a.defaults else []
                pairs = [*zip(last, a.defaults, strict=True), *zip(a.kwonlyargs, a.kw_defaults, strict=True)]
                code.defaults += ((arg.arg, value) for arg, value in pairs if value is not None)
    code.words = {word for word in code.words if isinstance(word, str)}  # None of `**`, numbers
    return code


def violations(source: Path) -> list[str]:
    """Imports that break the order of the packages, or that the product takes from the laboratory."""
    found = []
    for path in sorted(source.rglob("*.py")):
        inside = path.relative_to(source)
        product = inside.parts[0] == "thalweg"
        own = inside.parts[1].removesuffix(".py")
        for name, line in imports(path):
            top, *rest = name.split(".")
            if product and top == "thalweg" and rest and rest[0] not in MAY_IMPORT[own] | {"__version__"}:
                found.append(f"{inside}:{line}: {own} imports {rest[0]}")
            if product and top == "thalweg_lab":
                found.append(f"{inside}:{line}: the product imports the laboratory")
            if top in DRAWING and "figures" not in inside.parts:
                found.append(f"{inside}:{line}: {top} outside figures")
            if not top:
                found.append(f"{inside}:{line}: a relative import, which code_version does not follow")
    return found


def dotted(path: Path, source: Path) -> str:
    """Name of a module or, for its ``__init__.py``, of a package."""
    inside = path.relative_to(source)
    return ".".join((inside.parent if path.name == "__init__.py" else inside.with_suffix("")).parts)


def packages_above(source: Path) -> dict[str, set[str]]:
    """Which packages each package imports, at all levels; a module beside packages counts as one.

    A name from a front door counts as the module that defines it.
    """
    beside = {door.parent.parent for door in source.rglob("__init__.py")}
    package = {
        path: dotted(path if path.parent in beside else path.with_name("__init__.py"), source)
        for path in source.rglob("*.py")
        if path.name != "__init__.py"
    }
    found: dict[str, set[str]] = {name: set() for name in package.values()}
    for path, own in package.items():
        found[own] |= {package[each] for each in imported_modules(path, source) if each in package} - {own}
    return found


def past_the_door(files: list[Path], source: Path) -> list[str]:
    """Imports from a module of another package; a package is entered by its front door, ``__init__.pyi``."""
    modules = {dotted(p, source) for p in source.rglob("*.py") if p.name != "__init__.py"}
    own = {p: ".".join(p.relative_to(source).parent.parts) if p.is_relative_to(source) else "" for p in files}
    return [
        f"{path.name}:{line}: imports from {name}, not from {name.rpartition('.')[0]}"
        for path in files
        for name, line in imports(path)
        if name in modules and name.count(".") > 1 and name.rpartition(".")[0] != own[path]
    ]


def test_packages_are_entered_by_their_front_doors(repository):
    source = repository / "src"
    files = [*source.rglob("*.py"), *(repository / "workflow/scripts").glob("*.py")]
    assert past_the_door(files, source) == []


def test_a_way_past_the_door_is_found(tmp_path):
    for name, text in {
        "thalweg/lidar/__init__.py": "",
        "thalweg/lidar/filters.py": "",
        "thalweg/lidar/cloud.py": "from thalweg.lidar.filters import f\n",
        "thalweg/figures/cloud.py": "def f():\n    from thalweg.lidar.filters import f\n",
        "thalweg/figures/map.py": "from thalweg.lidar import f\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = past_the_door(sorted(tmp_path.rglob("*.py")), tmp_path)
    assert found == ["cloud.py:2: imports from thalweg.lidar.filters, not from thalweg.lidar"]


def test_every_front_door_opens(repository):
    """Each exported name is there, and no package shows a name twice."""
    source = repository / "src"
    stubs = sorted(source.rglob("__init__.pyi"))
    assert len(stubs) > 40
    for stub in stubs:
        package = importlib.import_module(dotted(stub.with_suffix(".py"), source))
        aliases = [
            alias.name
            for node in ast.parse(stub.read_text()).body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        ]
        assert sorted(aliases) == sorted(package.__all__), stub
        for name in aliases:
            getattr(package, name)


def test_packages_import_each_other_without_circles(repository):
    graph = packages_above(repository / "src")
    assert len(graph) > 50
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_no_package_imports_a_lower_one(repository):
    package = repository / "src/thalweg"
    assert {p.name for p in package.iterdir() if (p / "__init__.py").is_file()} <= set(MAY_IMPORT)
    assert violations(repository / "src") == []


def test_the_order_is_that_of_the_contributing_page(repository):
    text = (repository / "CONTRIBUTING.md").read_text()
    order = re.search(r"none imports a lower one:(.*?)\. `workflow`", text, re.S)
    assert order
    assert tuple(re.findall(r"`(\w+)`", order.group(1))) == PACKAGES


UNREACHED = {
    "__main__.py": "the command line",
    "cli.py": "the command line",
    **dict.fromkeys(
        (
            "bathymetry/through_water.py",
            "calibration/lens.py",
            "figures/catalogue.py",
            "figures/survey/gnss.py",
            "ingest/photos/video.py",
            "ingest/recordings.py",
            "ingest/registry/clouds.py",
            "ingest/registry/formats.py",
            "ingest/registry/images.py",
            "ingest/registry/others.py",
            "workflow/cluster.py",
        ),
        "called by the command line",
    ),
    "workflow/cluster.py": "called by the rules",
    "workflow/failures.py": "called by the rules",
    "workflow/codehash.py": "called by the rules",
    "workflow/campaign_files.py": "called by the rules",
    "workflow/figures.py": "called by the rules",
    "workflow/forked.py": "called by the rules",
    "workflow/preload.py": "loaded by what forks jobs",
}
"""Modules of the product outside `settings` that no entry script imports, and why."""


def test_code_versions_cover_the_library(repository):
    """A module that is reached in another way than by imports could be edited without a rerun."""
    package = repository / "src/thalweg"
    reached = {m for p in (repository / "workflow/scripts").glob("*.py") for m in reached_modules(p)}
    pictures, _ = rows_of(read_yaml(repository / "workflow/figures.yaml"))
    for row in pictures:
        reached |= modules_behind(row.draw.split(":")[0]) if row.draw else set()
    modules = {m for m in package.rglob("*.py") if m.relative_to(package).parts[0] != "settings"}
    for path in (repository / "workflow/rules").glob("*.smk"):
        for called in re.findall(r'calls(?:\(|": )"([\w.]+):\w+"', path.read_text()):
            reached |= modules_behind(called)
    for path in (repository / "config/studies").glob("*.yaml"):  # loaded by name
        entry = yaml.safe_load(path.read_text())
        reached |= modules_behind(entry["study"].split(":")[0]) if "study" in entry else set()
    laboratory = repository / "src/thalweg_lab"
    assert set(laboratory.rglob("*.py")) - reached == {
        laboratory / "campaign_files.py",  # called by the rules
        laboratory / "settings/checks.py",  # called by the library's check of campaign files, by name
        laboratory / "studies/by_hand/__init__.py",  # run by hand: print tables of real_consistency.md
        laboratory / "studies/by_hand/soundings.py",  # the same
        laboratory / "studies/by_hand/ground.py",  # a command of its own
    }
    left = {m.relative_to(package).as_posix() for m in modules - reached}
    assert {name for name in left if not name.startswith("commands/")} == set(UNREACHED)


@pytest.mark.parametrize(
    ("path", "text", "answer"),
    [
        ("thalweg/core/a.py", "def f():\n    from thalweg.lidar.cloud import g\n", "core imports lidar"),
        ("thalweg/ingest/a.py", "from thalweg import accuracy\n", "ingest imports accuracy"),
        ("thalweg/accuracy/a.py", "import thalweg_lab.truth\n", "the product imports the laboratory"),
        ("thalweg/workflow/a.py", "from thalweg.ingest import anpp\n", "workflow imports ingest"),
        ("thalweg_lab/river/a.py", "import matplotlib\n", "matplotlib outside figures"),
        ("thalweg/lidar/a.py", "import matplotlib.pyplot as plt\n", "matplotlib outside figures"),
        ("thalweg/lidar/a.py", "from .cloud import g\n", "relative import"),
    ],
)
def test_a_wrong_import_is_found(tmp_path, path, text, answer):
    (tmp_path / path).parent.mkdir(parents=True)
    (tmp_path / path).write_text(text)
    (found,) = violations(tmp_path)
    assert answer in found


# ---------------------------------------------------------------- each setting once

OF_OTHER_THINGS = {
    ("clocks/track.py", "correlation_time_s"),  # of the INS's attitude
    ("clocks/track.py", "white_share"),
    ("ingest/velodyne/reader.py", "max_points"),  # of a block in memory
    ("ingest/ouster.py", "max_points"),
    ("ingest/recorders/ros.py", "max_points"),
    ("ingest/readers.py", "max_points"),
    ("core/adjustment.py", "max_iterations"),
    ("core/las.py", "chunk_points"),
    ("navigation/camera/trajectory.py", "attitude_time_s"),  # where section images.cloud says auto
    ("navigation/camera/trajectory.py", "position_time_s"),
    ("navigation/fusion/model.py", "attitude_time_s"),  # where section fused says auto
}
"""Defaults that have name and value of a setting, and are none."""


def stated_defaults(path: Path) -> list[tuple[str, ast.expr]]:
    """Name and value of each default of a class's field or of a function's parameter."""
    return code_of(path.read_text()).defaults


def settings_of(section: type[BaseModel]) -> Iterator[tuple[str, Any]]:
    """Keys and defaults of a section and of those within it; not of the twin."""
    for name, info in section.model_fields.items():
        default = info.get_default(call_default_factory=True)
        if isinstance(default, BaseModel):
            yield from settings_of(type(default))
        elif name != "twin":
            yield name, default


def second_defaults(source: Path, settings: set[tuple[str, Any]]) -> list[tuple[str, str]]:
    """Where the library states a setting's number again; 0, 1 and single words name too many things."""
    found = []
    for path in sorted(source.rglob("*.py")):
        inside = path.relative_to(source)
        for name, value in stated_defaults(path):
            number = isinstance(value, ast.Constant) and isinstance(value.value, int | float)
            stated = value.value if number and isinstance(value, ast.Constant) else 0
            if inside.parts[0] not in {"settings", "figures"} and "_" in name and stated not in {0, 1}:
                found += [(inside.as_posix(), name)] if (name, stated) in settings else []
    return found


def test_no_default_of_a_setting_stands_twice(repository):
    """`Filters().isolated_radius_m` says it again without stating it."""
    numbers = {(key, value) for key, value in settings_of(Campaign) if isinstance(value, int | float)}
    assert {("interior_variance", 2.0), ("footprint_share", 0.177), ("sigma_time_s", 1e-6)} <= numbers
    assert set(second_defaults(repository / "src/thalweg", numbers)) - OF_OTHER_THINGS == set()


def test_a_second_default_is_found(tmp_path):
    (tmp_path / "a.py").write_text("def f(x, cell_m: float = 0.05, *, edge_m: float = 2): ...\n")
    (tmp_path / "b.py").write_text("class A:\n    cell_m: float = 0.05\n    edge_m: float = A().edge_m\n")
    found = second_defaults(tmp_path, {("cell_m", 0.05), ("edge_m", 3.0)})
    assert found == [("a.py", "cell_m"), ("b.py", "cell_m")]


# ---------------------------------------------------------------- files are opened by Python

NATIVE = {
    "read_parquet",
    "read_table",
    "ParquetFile",
    "ParquetDataset",
    "memory_map",
    "OSFile",  # Arrow, pandas
    "imread",
    "imreadmulti",
    "imcount",
    "VideoCapture",
    "FileStorage",  # OpenCV
    "read_triangle_mesh",
    "read_point_cloud",
    "read_image",
    "Database",
    "Reconstruction",  # Open3D, COLMAP
}
"""What opens the path that it is given in C or C++."""
LIBRARIES = {"pd", "pq", "pa", "cv2", "o3d", "pycolmap", "pandas", "pyarrow"}


def native_opens(path: Path) -> list[str]:
    """Calls that open a file in C++: no audit event tells `thalweg.workflow.truth` of it."""
    found, text = [], path.read_text()
    if not any(name in text for name in NATIVE):
        return []
    for node in ast.walk(ast.parse(text)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
            continue
        base = node.func.value
        while isinstance(base, ast.Attribute):
            base = base.value
        of_library = isinstance(base, ast.Name) and base.id in LIBRARIES
        streams = [isinstance(each, ast.Name) and each.id == "stream" for each in node.args[:1]]
        if of_library and node.func.attr in NATIVE and streams != [True]:
            found.append(f"{path.name}:{node.lineno}: {node.func.attr} of a path; give it an open stream")
    return found


def test_no_library_opens_a_file_behind_the_check_of_the_truth(repository):
    files = [*(repository / "src").rglob("*.py"), *(repository / "workflow/scripts").glob("*.py")]
    assert [line for path in files for line in native_opens(path)] == []


@pytest.mark.parametrize(
    ("text", "n"),
    [
        ("pd.read_parquet(path)\n", 1),
        ("pq.ParquetFile(where=path)\n", 1),
        ("cv2.imread(str(path))\n", 1),
        ("o3d.io.read_point_cloud(str(path))\n", 1),
        ("with path.open('rb') as stream:\n    pq.read_table(stream)\n", 0),
        ("read_parquet(path)\nread_table(path, KIND)\n", 0),
    ],
)
def test_an_opening_in_another_language_is_found(tmp_path, text, n):
    (tmp_path / "a.py").write_text(text)
    assert len(native_opens(tmp_path / "a.py")) == n


# ---------------------------------------------------------------- rules and entry scripts

FIELDS = (
    "input",
    "output",
    "log",
    "wildcard_constraints",
    "priority",
    "threads",
    "resources",
    "params",
    "script",
)
"""As snakefmt leaves them; the docstring stands before."""
OPTIONAL = {"input", "log", "wildcard_constraints", "priority", "threads", "params"}
"""Rules of the twin may begin from nothing; few are urgent, or have wildcards or a log of their own."""


def rule_fields(repository: Path) -> dict[str, list[str]]:
    """Fields of each rule as they stand in the file."""
    found = {}
    for path in sorted((repository / "workflow/rules").glob("*.smk")):
        parts = re.split(r"(?m)^(?=\S)(?!#)", path.read_text())
        # `use rule` takes the fields that it does not name from another rule
        for part in [p for p in parts if p.startswith(("rule ", "checkpoint "))]:
            text = part.split(" ", 1)[1]
            name = re.match(r"\w+", text)
            assert name, path
            assert text.split("\n")[1].startswith('    """'), f"{name.group()} has no docstring"
            found[name.group()] = re.findall(r"(?m)^    (\w+):", text)
        # that of all pictures stands in a loop over their table, which describes each
        for text in re.split(r"(?m)^    rule:\n", path.read_text())[1:]:
            fields = re.findall(r"(?m)^        (\w+):", text)
            assert fields[0] == "name"
            found["plot"] = fields[1:]
    return found


def test_the_fields_of_a_rule_stand_in_one_order(repository):
    rules = rule_fields(repository)
    assert len(rules) >= 26
    assert {name for name, fields in rules.items() if set(FIELDS) - OPTIONAL - set(fields)} == set()
    assert {
        name: fields for name, fields in rules.items() if fields != [f for f in FIELDS if f in fields]
    } == {}


def test_functions_of_rules_stand_apart_from_rules(repository):
    """One common file a room: rules ask `CAMPAIGNS` through them, and Snakemake's linter wants no mixture."""
    for path in sorted((repository / "workflow/rules").glob("*.smk")):
        text = path.read_text()
        rules = re.search(r"(?m)^ *(?:use )?(?:rule|checkpoint)[ :]", text)
        functions = re.search(r"(?m)^def ", text)
        assert bool(functions) == path.name.startswith("common"), path.name
        assert bool(rules) != path.name.startswith("common"), path.name


def test_entry_scripts_only_unpack_and_call(repository):
    scripts = sorted((repository / "workflow/scripts").glob("*.py"))
    assert len(scripts) >= 26
    for path in scripts:
        text = path.read_text()
        assert text.endswith('\n\nif "snakemake" in globals():\n    run_job(main, snakemake)\n'), path.name
        assert "__future__" not in text, path.name  # a SyntaxError in a `script:` file
        assert not {name.split(".")[0] for name, _ in imports(path)} & DRAWING, path.name
        (main,) = [n for n in ast.parse(text).body if isinstance(n, ast.FunctionDef) and n.name == "main"]
        assert not main.args.args, f"{path.name}: run_job passes keywords"
        assert all(argument.annotation for argument in main.args.kwonlyargs), path.name


# ---------------------------------------------------------------- tracked files

HOST = re.compile(r"https?://[\w.-]*(?:pypi\.org|pythonhosted|debian\.org|npmjs)[\w./-]*")
MACHINE_PATH = re.compile(r"(?<![\w.])/(?:work|farm|root|tmp|home|Users)/[\w.-]+")


@pytest.fixture(scope="module")
def tracked(repository):
    if not (repository / ".git").exists():
        pytest.skip("not a git checkout: which files are tracked is unknown")
    run = subprocess.run(
        ["git", "-C", str(repository), "ls-files", "-z"], capture_output=True, text=True, check=True
    )
    return [p for name in run.stdout.split("\0") if name and (p := repository / name).is_file()]


def test_no_tracked_file_names_a_registry_or_a_machine(tracked, repository):
    found, texts = [], 0
    for path in tracked:
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        texts += 1
        found += [
            f"{path.relative_to(repository)}: {hit.group()}"
            for hit in (HOST.search(text), MACHINE_PATH.search(text))
            if hit
        ]
    assert texts > 100
    assert found == []


def test_the_patterns_find_what_they_are_for():
    # put together here, so that this file itself stays clean
    assert HOST.search("see https:" + "//files.pythonhosted.org/packages/x.whl")
    assert MACHINE_PATH.search("read('/" + "home/anna/survey.pcap')")
    assert not MACHINE_PATH.search("src/work/a.py and https://example.org/home/page and ../tmp/x")


def test_no_tracked_file_is_above_a_megabyte(tracked, repository):
    sizes = {str(p.relative_to(repository)): p.stat().st_size for p in tracked}
    assert {name: size for name, size in sizes.items() if size > 1_000_000} == {}


# ---------------------------------------------------------------- tests that are there


def test_every_test_file_holds_a_test(repository):
    """A merge once left one line of a file of 747."""
    files = sorted((repository / "tests").rglob("test_*.py"))
    assert len(files) > 400
    assert [path.name for path in files if count_tests(path) == 0] == []


def test_every_test_that_documents_name_exists(repository):
    """As a file, as a function, or as ``file.py::function``."""
    names = set[str]()  # of modules and of functions
    for path in (repository / "tests").rglob("*.py"):
        names |= {path.stem, *re.findall(r"def (test_\w+)", path.read_text())}
    pages = [*repository.glob("*.md"), *(repository / "docs").rglob("*.md")]
    texts = {p: p.read_text() for p in pages if p.name != "mutants.md"}  # that page shows lines of source
    told = {(p.name, name) for p, text in texts.items() for name in re.findall(r"\btest_\w+", text)}
    assert len(told) > 50
    assert sorted((page, name) for page, name in told if name not in names) == []
    files = {(p.name, name) for p, text in texts.items() for name in re.findall(r"\btests/[\w/]+\.py", text)}
    assert sorted((page, name) for page, name in files if not (repository / name).is_file()) == []


def test_tests_that_a_merge_loses_are_missed(tmp_path):
    """The figure may fall only with a row that says why; both sides' figures stand after a merge."""
    (tmp_path / "lidar").mkdir()
    (tmp_path / "lidar/test_a.py").write_text("def test_1(): ...\nclass TestB:\n    def test_2(self): ...\n")
    found = count_by_folder(tmp_path)
    assert found == {"lidar": 2}
    assert compared(found, []) == ([], [["lidar", "2", ""]])
    (lost,), _ = compared(found, [["lidar", "3", ""], ["lidar", "4", ""]])
    assert "tests/lidar has 2 tests, 2 fewer" in lost
    why = ["lidar", "2", "went with their reader"]
    assert compared(found, [["lidar", "4", ""], why]) == ([], [["lidar", "4", ""], why])
    (lost,), _ = compared(found, [["lidar", "5", ""], why])
    assert "1 fewer" in lost
    assert compared(found, [["lidar", "3", ""], why])[1] == [["lidar", "4", ""], why]
    (lost,), _ = compared(found, [["clocks", "1", ""]])
    assert "tests/clocks has 0 tests" in lost


# ---------------------------------------------------------------- settings

WITHOUT_USE: dict[str, str] = {}
"""Keys of a campaign file that no code uses yet, and why they are accepted all the same."""


def leaf_keys(node: dict[str, Any], defs: dict[str, Any], prefix: str = "") -> Iterator[str]:
    """Dotted keys of a campaign file that hold a value, not a section."""
    for key, value in node["properties"].items():
        sections = [part["$ref"] for part in (value, *value.get("anyOf", [])) if "$ref" in part]
        for section in sections:
            yield from leaf_keys(defs[section.rsplit("/", 1)[1]], defs, f"{prefix}{key}.")
        if not sections:
            yield prefix + key


def words(path: Path) -> set[str]:
    """Names and whole texts in a file's code; comments and docstrings do not count."""
    return code_of(path.read_text()).words


def test_every_setting_is_used_or_says_why_not(repository):
    """By the name of the key alone: a name that several sections share counts for all of them."""
    schema = json.loads((repository / "config/schema.json").read_text())
    keys = list(leaf_keys(schema, schema["$defs"]))
    assert len(keys) > 100
    source = repository / "src"
    used: set[str] = set()
    for path in source.rglob("*.py"):
        if path.relative_to(source).parts[:2] != ("thalweg", "settings"):
            used |= words(path)
        else:  # what a section computes from its own keys
            used |= set(re.findall(r"self\.(\w+)", path.read_text()))
    for path in (repository / "workflow/scripts").glob("*.py"):
        used |= words(path)
    for path in (repository / "workflow/rules").glob("*.smk"):
        used |= set(re.findall(r"\w+", re.sub(r"#.*", "", path.read_text())))
    for row in rows_of(read_yaml(repository / "workflow/figures.yaml"))[0]:
        used |= {str(key).rsplit(".", 1)[-1] for key in row.settings.values()}
    unused = {key for key in keys if key.rsplit(".", 1)[-1] not in used}
    # both ways: a key that found its use must leave the list
    assert unused == set(WITHOUT_USE)
    assert all(WITHOUT_USE.values())


def test_a_run_without_real_recordings_says_so_at_its_end():
    """Counted are tests that missed the recordings, not those that missed a program."""
    reports = [
        SimpleNamespace(longrepr=("a.py", 3, f"Skipped: {why}"))
        for why in (
            "no real recordings at data: set THALWEG_DATA to their folder",
            "tshark is not there",
            "no real recordings at data: set THALWEG_DATA to their folder",
        )
    ]
    assert real_recordings_skipped(reports).startswith("2 tests on real recordings skipped: set THALWEG_DATA")
    assert real_recordings_skipped(reports[1:2]) == ""


# ---------------------------------------------------------------- size


def test_no_package_grows_beyond_what_the_page_of_the_architecture_states(repository):
    size = runpy.run_path(str(repository / "docs/make_size.py"))
    stated, now = size["stated"](), size["measured"]()
    grown = {name: n for name, n in now.items() if n > size["SLACK"] * stated.get(name, 0)}
    assert grown == {}, "state them: .venv/bin/python docs/make_size.py --write"
    assert set(stated) == set(now)


def test_size_weighs_code_and_neither_words_about_it_nor_its_layout(repository):
    tokens_of = runpy.run_path(str(repository / "docs/make_size.py"))["tokens_of"]
    plain = "def f(a):\n    return a + 1\n"
    layout = "    return (\n        a + 1\n    )\n"
    words = '"""Words."""\n\n# more words\ndef f(\n    a,\n):\n    """Words."""\n'
    assert tokens_of(plain) == 10
    assert tokens_of(words + layout) == 13  # a comma and two parentheses
    assert tokens_of('x = "a string that is no docstring"\n') == 3
