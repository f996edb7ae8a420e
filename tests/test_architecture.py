"""The house's own rules, where import-linter does not already watch them."""

import ast
import inspect

import pytest

import matcam
from tests.conftest import REPOSITORY

SOURCES = sorted((REPOSITORY / "src" / "matcam").rglob("*.py"))


def test_oracle_imports_nothing_of_the_package():
    for path in sorted((REPOSITORY / "tests" / "oracle").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.split(".")[0] in ("matcam", "jax")], path


@pytest.mark.parametrize("name", matcam.__all__)
def test_public_names_load_and_say_what_they_are(name):
    thing = getattr(matcam, name)
    assert inspect.getdoc(thing)
    if inspect.isclass(thing):
        for attribute, member in vars(thing).items():
            if inspect.isfunction(member) and not attribute.startswith("_"):
                assert inspect.getdoc(member), f"{name}.{attribute}"


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError):
        matcam.measure_everything  # noqa: B018


def test_nobody_switches_float64_on_twice():
    users = [p for p in SOURCES if "jax_enable_x64" in p.read_text()]
    assert [p.name for p in users] == ["jax.py"]
    for path in SOURCES:
        if path.name != "jax.py":
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Import):
                    assert not any(alias.name in ("jax", "jax.numpy") for alias in node.names), path


def imports(path):
    """Modules of the package that a file imports, those under TYPE_CHECKING included."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "matcam":
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in MODULES else node.module)
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.split(".")[0] == "matcam"}
    return found


def module_name(path):
    parts = path.relative_to(REPOSITORY / "src").with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in SOURCES}


def test_no_modules_import_each_other_in_a_circle():
    graph = {name: imports(path) & set(MODULES) for name, path in MODULES.items()}
    while free := [name for name, needed in graph.items() if not needed & set(graph)]:
        for name in free:
            del graph[name]
    assert not graph, f"a circle among {sorted(graph)}"


def test_a_folder_is_one_shelf():
    for folder in {path.parent for path in SOURCES} - {REPOSITORY / "src/matcam/cli", REPOSITORY / "src/matcam/files"}:
        assert len([path for path in folder.glob("*.py") if path.name != "__init__.py"]) <= 14, folder


def public_names():
    for stub in (REPOSITORY / "src" / "matcam").rglob("*.pyi"):
        for node in ast.parse(stub.read_text()).body:
            if isinstance(node, ast.Assign):
                yield from ast.literal_eval(node.value)


def test_no_module_bears_the_name_of_a_public_function():
    """But for the commands, each a file, and for the room of `fit`."""
    functions = {
        name for name in public_names() if name not in {path.parent.name for path in SOURCES} | {"io", "targets"}
    }
    modules = {path.stem for path in SOURCES if path.parent.name != "cli" and path.name != "__init__.py"}
    assert modules & functions <= {"rigs", "paper"}


def test_a_class_has_one_name():
    positions = {}
    for path in SOURCES:
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                positions.setdefault(node.name, []).append(path)
    assert {name: found for name, found in positions.items() if len(found) > 1} == {}
