"""Three folders, one import name: how the tree has to look for that to work."""

import ast
import importlib
import re
import subprocess
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest
from tests.support.tree import PROJECT, ROOTS, modules, packages, parsed, shown, statements

LONGEST = 600
LEAST_PART = 80
"""Lines from which half a module is a module."""
TOP_LEVEL = {
    "services", "workers", "shared", "deploy", "tests", "docker-compose.yml", "pyproject.toml", "README.md", "Makefile", "LICENSE",
    "CHANGELOG.md", "docs",
}  # fmt: skip
HOOKS = {"pause_reading", "process_bind_param", "process_result_value", "resume_reading"}
"""Methods that a library calls and documents."""
BUILT = {"build", "dist"}
"""Folders that tools make and git ignores."""
FOLDERS = sorted({path.parent for path in modules()})

every_package = pytest.mark.parametrize("name", sorted(name for root in ROOTS for name in packages(root)))


def test_the_top_level_holds_what_the_floor_plan_names_and_nothing_else() -> None:
    result = {path.name for path in PROJECT.iterdir() if not path.name.startswith(".")}
    assert result - BUILT <= TOP_LEVEL


@pytest.mark.parametrize("root", ROOTS, ids=shown)
def test_a_root_holds_packages_only(root: Path) -> None:
    """An `__init__.py` here would hide the other two roots; a module here would have no package."""
    assert [path.name for path in root.iterdir() if path.is_file()] == []


def test_no_two_roots_own_the_same_package() -> None:
    owners = Counter(name for root in ROOTS for name in packages(root))
    assert [name for name, count in owners.items() if count > 1] == []


@every_package
def test_a_package_is_typed_and_says_what_it_is_for(name: str) -> None:
    package = importlib.import_module(name)
    assert package.__file__ is not None
    assert (Path(package.__file__).parent / "py.typed").is_file()
    assert package.__doc__


@every_package
def test_a_package_is_imported_from_this_tree(name: str) -> None:
    """Else every other test here would look at the wrong files."""
    (folder,) = importlib.import_module(name).__path__
    assert Path(folder).parent in ROOTS


def test_a_folder_of_modules_is_a_package() -> None:
    assert [shown(folder) for folder in FOLDERS if not (folder / "__init__.py").is_file()] == []


def test_readmes_name_files_and_folders_that_exist() -> None:
    """A path as it ends, without the suffix where a README leaves it out."""
    files = subprocess.run(["git", "ls-files"], cwd=PROJECT, capture_output=True, text=True, check=True).stdout.splitlines()
    tree = "".join(f"/{file}\n" for file in files)
    for readme in (PROJECT / file for file in files if file.endswith("README.md")):
        prose = re.sub(r"^```.*?^```", "", readme.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        assert [name for name in re.findall(r"`(\w[\w.-]*/[\w./-]+)`", prose) if f"/{name}" not in tree] == [], readme


def test_a_module_can_be_read_in_one_sitting() -> None:
    files = (*modules(), *(PROJECT / "tests").rglob("*.py"))
    lengths = {shown(path): len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    assert {name: length for name, length in lengths.items() if length > LONGEST} == {}


@pytest.mark.slow
def test_whatever_is_public_is_documented() -> None:
    missing = {}
    for path in modules():
        tree = parsed(path)
        missing[shown(path)] = [*([] if ast.get_docstring(tree) else ["the module"]), *undocumented(tree, "")]
    assert {name: names for name, names in missing.items() if names} == {}


@cache
def classes() -> list[ast.ClassDef]:
    """Every class of the three roots."""
    return [node for path in modules() for node in statements(parsed(path)) if isinstance(node, ast.ClassDef)]


@cache
def documented_methods() -> Counter[str]:
    """How many classes of the three roots document a method of each name."""
    functions = (each for node in classes() for each in node.body if isinstance(each, (ast.FunctionDef, ast.AsyncFunctionDef)))
    return Counter(child.name for child in functions if ast.get_docstring(child))


def methods_of(node: ast.ClassDef) -> set[str]:
    return {child.name for child in node.body if isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef))}


@cache
def protocols() -> list[set[str]]:
    """The methods of every protocol of the three roots."""
    return [methods_of(node) for node in classes() if any(ast.unparse(base) == "Protocol" for base in node.bases)]


def is_described_elsewhere(node: ast.Module | ast.ClassDef, name: str) -> bool:
    """Returns whether a base class, a protocol or a library documents the method."""
    if not isinstance(node, ast.ClassDef) or name in HOOKS:
        return name in HOOKS
    implements = any(name in protocol and protocol <= methods_of(node) for protocol in protocols())
    return implements or (bool(node.bases) and documented_methods()[name] > 0)


def undocumented(node: ast.Module | ast.ClassDef, prefix: str) -> list[str]:
    """Returns public classes, functions and methods without a docstring. Names inside a function, or with a leading _, are not public."""
    result: list[str] = []
    for child in node.body:
        if isinstance(child, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and not child.name.startswith("_"):
            if not ast.get_docstring(child) and not (is_described_elsewhere(node, child.name)):
                result.append(prefix + child.name)
            if isinstance(child, ast.ClassDef):
                result += undocumented(child, f"{prefix}{child.name}.")
    return result


def bound(node: ast.stmt) -> set[str]:
    """Returns the names that a statement of a module binds."""
    if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
        return {node.name}
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return {
        each.id
        for target in targets
        if isinstance(target, (ast.Name, ast.Tuple))
        for each in ast.walk(target)
        if isinstance(each, ast.Name)
    }


def is_glued(tree: ast.Module, length: int) -> bool:
    """Returns whether a module falls into two parts of at least `LEAST_PART` lines, and neither part uses names of the other."""
    nodes = [node for node in tree.body if bound(node)]
    used = [{each.id for each in ast.walk(node) if isinstance(each, ast.Name)} for node in nodes]
    for place, node in enumerate(nodes):
        if min(node.lineno - nodes[0].lineno, length - node.lineno) >= LEAST_PART:
            before, after = set[str]().union(*map(bound, nodes[:place])), set[str]().union(*map(bound, nodes[place:]))
            if not before & set().union(*used[place:]) and not after & set().union(*used[:place]):
                return True
    return False


def test_a_module_is_not_two_modules_one_after_the_other() -> None:
    """The documents of a contract may know nothing of each other."""
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in modules() if "contracts" not in path.parts}
    long = [path for path, length in lengths.items() if length >= 2 * LEAST_PART]
    assert [shown(path) for path in long if is_glued(parsed(path), lengths[path])] == []


def test_a_module_binds_a_name_once() -> None:
    """A second constant of the same name would be another value for whatever asks later."""
    names = {shown(path): Counter(name for node in parsed(path).body for name in bound(node)) for path in modules()}
    assert {module: name for module, counts in names.items() for name, count in counts.items() if count > 1} == {}


def test_a_class_name_means_one_class() -> None:
    names = Counter(node.name for node in classes())
    assert [name for name, count in names.items() if count > 1 and not name.startswith("_")] == []


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = grimp.build_graph("drivecal", cache_dir=None)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    TopologicalSorter(imports).prepare()  # raises CycleError, which names the circle
