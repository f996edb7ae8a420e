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


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(REPOSITORY / "src")))
def test_a_file_is_one_sitting(path):
    assert len(path.read_text().splitlines()) <= 450


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
