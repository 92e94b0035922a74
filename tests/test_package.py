"""The package as it is built and installed: nothing missing, nothing foreign."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("handbench", "methods", "metrics", "protocols", "reports")
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def _packages() -> set[str]:
    """The packages that the folders of the checkout make."""
    found = set()
    for folder in FOLDERS:
        for init in (ROOT / folder).rglob("__init__.py"):
            parts = init.parent.relative_to(ROOT).parts
            found.add(".".join(parts if folder == "handbench" else ("handbench", *parts)))
    return found


@cache
def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _modules() -> list[str]:
    """All modules of the installed package, by name."""
    found = []
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts if folder == "handbench" else ("handbench", *parts))
            found.append(name.removesuffix(".__init__"))
    return sorted(found)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what the checkout builds from."""
    copy = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__", ".*"))
    return copy


@pytest.fixture(scope="module")
def wheel(source: Path) -> zipfile.ZipFile:
    """A wheel built from the copy."""
    assert PYPROJECT["build-system"]["build-backend"] == "setuptools.build_meta"
    script = "from setuptools.build_meta import build_wheel as build; build('dist', {'--build-option': '%s'})"
    command = [sys.executable, "-c", script % "--compression=stored"]  # to compress the weights takes longer than all
    done = subprocess.run(command, cwd=source, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    (path,) = (source / "dist").glob("*.whl")
    return zipfile.ZipFile(path)


def test_every_folder_with_code_is_listed() -> None:
    assert set(PYPROJECT["tool"]["setuptools"]["packages"]) == _packages()


def test_the_wheel_has_one_top_level_name(wheel: zipfile.ZipFile) -> None:
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"handbench"}


def test_the_wheel_holds_all_code_and_data(wheel: zipfile.ZipFile, source: Path) -> None:
    packed = {name for name in wheel.namelist() if name.startswith("handbench/")}
    wanted = set()
    for folder in FOLDERS:
        for path in (source / folder).rglob("*"):
            if path.is_file():
                relative = path.relative_to(source).as_posix()
                wanted.add(relative if folder == "handbench" else f"handbench/{relative}")
    assert wanted <= packed, f"not in the wheel: {sorted(wanted - packed)[:5]}; name them in package-data"
    assert {"handbench/py.typed", "handbench/reports/templates/page.html", "handbench/protocols/quick.toml"} <= packed


def test_the_wheel_carries_the_licences(wheel: zipfile.ZipFile) -> None:
    names = wheel.namelist()
    assert any(".dist-info/" in name and name.endswith("/LICENSE") for name in names)
    assert "handbench/metrics/weights/NOTICE" in names
    assert {f"handbench/methods/kit/weights/{name}" for name in ("NOTICE", "alexnet.safetensors")} <= set(names)
    assert {f"handbench/methods/handy/weights/{name}" for name in ("NOTICE", "generator.safetensors")} <= set(names)


def test_no_module_names_pandas_or_a_sibling_by_its_bare_name() -> None:
    banned = {"pandas", "methods", "metrics", "protocols", "reports", "tests"}
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*.py"):
            for node in _imports(_parsed(path)):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.level == 0:
                    names = [node.module or ""]
                assert not {name.split(".")[0] for name in names} & banned, f"{path} line {node.lineno}"


def _imports(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """All imports of a module. Statements hold them, expressions never do."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.stmt | ast.excepthandler | ast.match_case):
            yield from _imports(child)


def test_the_core_loads_no_plug_in_package() -> None:
    """`handbench/` reaches methods, metrics, protocols and reports through the registry, or inside of functions.

    Studies, which nothing else imports, may be of one method.
    """
    plug_ins = {f"handbench.{name}" for name in FOLDERS[1:]}
    for path in (ROOT / "handbench").rglob("*.py"):
        if path.is_relative_to(ROOT / "handbench" / "studies"):
            continue
        for node in _at_module_level(_parsed(path)):
            names = [alias.name for alias in node.names]
            if isinstance(node, ast.ImportFrom):
                depth = len(path.relative_to(ROOT).parts) - node.level
                head = path.relative_to(ROOT).parts[:depth] if node.level else ()
                module = ".".join((*head, *filter(None, [node.module])))
                names = [module, *(f"{module}.{name}" for name in names)]
            assert not {".".join(name.split(".")[:2]) for name in names} & plug_ins, f"{path} line {node.lineno}"


def test_the_fast_path_is_imported_by_the_switch_alone() -> None:
    """Whoever asks for shading gets what the switch chose, and the slow path never depends on the fast one."""
    importing = {
        path.relative_to(ROOT).as_posix()
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("*.py")
        for node in _imports(_parsed(path))
        if "fused" in f"{getattr(node, 'module', '')}.{'.'.join(each.name for each in node.names)}".split(".")
    }
    assert importing == {"handbench/render/shade/switch.py"}


def _at_module_level(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """The imports that importing a module makes; those of type checkers are none."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from _at_module_level(child)


IMPORTS = """
import gc, json, os, sys
from importlib import import_module

gc.disable()
sys.path.insert(0, sys.argv[1])  # with a pandas that tells of any try to load it, even where none is installed
HEAVY = {"torch", "jax", "open3d", "numpy", "scipy", "skimage", "torchvision"}
loaded = lambda: sorted(HEAVY & sys.modules.keys())
found = {}

import handbench

found["top"] = loaded()
for name in ("bench.cell", "bench.run", "bench.describe", "bench.provenance", "metrics"):
    import_module(f"handbench.{name}")
registry = import_module("handbench.registry")
tables = [table for table in vars(registry).values() if isinstance(table, registry.Registry)]
assert len(tables) >= 6 and all(table.entries() for table in tables)
found["bench"] = loaded()
for entry in handbench.metrics.ENTRIES:
    entry.load()
found["metrics"] = loaded()
found["unlisted"] = sorted(set(handbench.__all__) - set(dir(handbench)))
found["missing"] = [name for name in handbench.__all__ if getattr(handbench, name) is None]
from handbench import Method, PosedAvatar, light_samples

for name in sys.argv[2:]:
    import_module(name)
from handbench.lean import open3d

open3d()
found["pandas"] = os.path.exists("pandas-was-loaded")
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def imports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a new process has loaded after it imported more and more, all modules at the end."""
    folder = tmp_path_factory.mktemp("imports")
    (folder / "pandas.py").write_text("open('pandas-was-loaded', 'w').close()\nraise ImportError('no pandas here')\n")
    command = [sys.executable, "-c", IMPORTS, str(folder), *_modules()]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


def test_the_bench_loads_neither_torch_nor_scipy(imports: dict[str, Any]) -> None:
    """A run whose methods need neither starts in a fraction of the time; who draws with atlases loads them."""
    assert not {"torch", "scipy", "open3d", "skimage"} & set(imports["bench"])


def test_no_metric_loads_torchvision(imports: dict[str, Any]) -> None:
    assert "torch" in imports["metrics"] and "torchvision" not in imports["metrics"]


def test_importing_everything_loads_no_pandas(imports: dict[str, Any]) -> None:
    assert imports["pandas"] is False


def test_the_names_of_a_plug_in_are_at_the_top_and_cost_nothing_until_used(imports: dict[str, Any]) -> None:
    assert not {"torch", "jax", "open3d", "numpy"} & set(imports["top"])
    assert imports["unlisted"] == imports["missing"] == []


def test_every_requirement_is_pinned() -> None:
    """Each dependency has an exact version in constraints.txt that its range in pyproject.toml allows."""
    from packaging.requirements import Requirement

    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = dict(line.lower().replace("_", "-").split("==") for line in lines if not line.startswith("#"))
    project = PYPROJECT["project"]
    for text in (*project["dependencies"], *(t for extra in project["optional-dependencies"].values() for t in extra)):
        requirement = Requirement(text)
        if requirement.marker is None or requirement.marker.evaluate({"sys_platform": "linux"}):
            version = pins.get(requirement.name.lower().replace("_", "-"))
            assert version is not None and requirement.specifier.contains(version), text


def test_no_module_binds_a_name_twice() -> None:
    """The second value would silently replace the first; linters do not see it."""
    for path in (path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")):
        bound: list[str] = []
        for line in _parsed(path).body:
            targets = line.targets if isinstance(line, ast.Assign) else []
            bound += [target.id for target in targets if isinstance(target, ast.Name)]
        assert len(bound) == len(set(bound)), f"{path.relative_to(ROOT)}: {sorted(bound)}"


@cache
def _bound(path: Path) -> set[str]:
    """The names that a module's source binds, wherever in it."""
    found = set()
    for node in ast.walk(_parsed(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.alias):
            found.add(node.asname or node.name.partition(".")[0])
    return found


def test_what_benchmarks_and_examples_import_is_there() -> None:
    """Nobody type-checks or runs most of them, and a renamed class would break them unseen."""
    missing = []
    for path in [*(ROOT / "benchmarks").rglob("*.py"), *(ROOT / "examples").rglob("*.py")]:
        for node in _imports(_parsed(path)):
            parts = (node.module or "").split(".") if isinstance(node, ast.ImportFrom) else [""]
            if not isinstance(node, ast.ImportFrom) or parts[0] != "handbench":
                continue
            inner = parts[1:] if parts[1:2] and parts[1] in FOLDERS else parts
            home = ROOT.joinpath(*inner)
            file = home / "__init__.py" if home.is_dir() else home.with_suffix(".py")
            names = _bound(file) if file.is_file() else set()
            beside = {child.stem for child in home.glob("*")} if home.is_dir() else set()
            missing += [
                f"{path.relative_to(ROOT)}: {node.module}.{alias.name}"
                for alias in node.names
                if alias.name not in names and alias.name not in beside
            ]
    assert not missing
