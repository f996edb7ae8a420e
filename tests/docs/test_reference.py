"""Generated pages: each public name with its parameters, each command with its options, each claim by its test."""

import ast
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import docs_api
import docs_check
import docs_claims
import docs_commands
import docs_messages
import matcam
from docs_names import public_things, signature
from matcam.cli import BAD_INPUT, FAULT, INTERRUPTED
from matcam.inverse.operator.lobe_operator import check_rig

ROOT = Path(__file__).parents[2]
THINGS = {name: thing for name, thing in public_things() if not inspect.ismodule(thing)}


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The generated pages of names, by name of their file."""
    folder = tmp_path_factory.mktemp("api")
    docs_api.write(folder)
    return {path.stem: path.read_text() for path in folder.glob("*.md")}


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    """The generated pages of commands, by name of their file."""
    folder = tmp_path_factory.mktemp("commands")
    docs_commands.write(folder)
    return {path.stem: path.read_text() for path in folder.glob("*.md")}


def test_every_public_name_has_a_page_with_all_parameters(pages):
    entries = {name: text for name, text in pages.items() if text.startswith("# matcam.")}
    assert set(entries) == set(THINGS) - {"rigs.Rig"}
    assert [name for name, text in entries.items() if len(re.findall(r"(?m)^:::::\{py:", text)) != 1] == []
    indices = "\n".join(text for name, text in pages.items() if name not in entries)
    assert [name for name in entries if indices.count(f"[`{name}`]({name}.md)") != 1] == []
    missing = [
        f"{name}: {parameter}"
        for name, text in entries.items()
        for parameter in signature(THINGS[name])
        if f"- **{parameter}**" not in text
    ]
    assert missing == []


def test_a_public_name_on_no_page_is_named():
    with pytest.raises(docs_api.UndocumentedError, match="on no page: measure_everything"):
        docs_api.pages({*THINGS, "measure_everything"})
    with pytest.raises(docs_api.UndocumentedError, match="measure"):
        docs_api.pages(set(THINGS) - {"measure"})


def test_every_command_has_a_page_with_all_options(commands):
    index = commands["index"]
    by_name = {text.split("\n")[0].removeprefix("# matcam "): text for text in commands.values() if text != index}
    found = docs_commands.commands()
    assert set(by_name) == set(found)
    assert [words for words in found if f"({docs_commands.file_of(words)}.md)" not in index] == []
    missing = [
        f"{words} {option}"
        for words, (command, _) in found.items()
        for param in command.params
        if param.param_type_name == "option"
        for option in (*param.opts, *param.secondary_opts)
        if f"`{option}" not in by_name[words]
        and f" {option}`" not in by_name[words]
        and f" {option}," not in by_name[words]
    ]
    assert missing == []
    assert [words for words, text in by_name.items() if f"```sh\nmatcam {words}" not in text] == []
    assert [code for code in (0, 1, BAD_INPUT, FAULT, INTERRUPTED) if f"| {code} |" not in index] == []


def test_values_of_options_are_units_or_choices():
    """No type of Python stands for a unit, and a flag has no value."""
    from matcam.cli import help_page

    kinds = re.compile(r"<|\b(bool|int|float|str|path|text|list)\b")
    wrong = [
        f"{words} {entry.names} {entry.value}"
        for words, (command, context) in docs_commands.commands().items()
        for entry in help_page.entries(command, context)[1]
        if kinds.search(entry.value)
    ]
    assert wrong == []


def test_every_message_is_in_the_index(tmp_path):
    path = tmp_path / "messages.md"
    docs_messages.write(path)
    text = path.read_text()
    own = [m for m in docs_messages.collected() if re.search("[a-z]", m.text.replace("{}", ""))]
    assert len(own) > 350
    assert [str(m) for m in own if docs_messages._as_text(m.text) not in text] == []


@pytest.mark.parametrize("name", docs_claims.claims())
def test_a_claim_names_a_test_that_reads_it(name):
    claim = docs_claims.claims()[name]
    if "benchmark" in claim:
        assert claim["benchmark"] in (ROOT / "benchmarks" / "RESULTS.md").read_text()
        return
    path, _, test = claim["test"].partition("::")
    tree = ast.parse((ROOT / path).read_text())
    assert test in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
    assert f'limit("{name}")' in (ROOT / path).read_text()


def test_readme_names_the_claims_and_the_page_prints_them(tmp_path):
    readme = " ".join((ROOT / "README.md").read_text().split())
    assert "[docs/claims.toml](docs/claims.toml)" in readme
    for name in ("corrected-fresnel", "raw-fresnel", "fresnel-coverage"):
        assert docs_claims.claims()[name]["measured"] in readme
    docs_claims.write(tmp_path / "trust.md")
    assert "\n".join(docs_claims.table(docs_claims.shown_on_page)) in (tmp_path / "trust.md").read_text()


def test_one_sentence_says_which_tables_are_taken(tmp_path):
    """README, the page of claims and the table to which both link agree with the code."""
    assert docs_claims.taken("docs") in " ".join((ROOT / "README.md").read_text().split())
    docs_claims.write(tmp_path / "trust.md")
    assert docs_claims.taken("") in (tmp_path / "trust.md").read_text()
    assert (ROOT / "docs" / "reference" / "supported.md").exists()
    camera, lamps = matcam.rigs.merl().camera, (matcam.DistantLamp(), matcam.NearLamp(28.0))
    for sample in (matcam.Sphere, matcam.Cylinder):
        for distance in (np.inf, 30.0):
            for lamp in lamps:
                check_rig(matcam.Rig(camera, sample(256.0, distance), lamp))
    for lamp in lamps:
        check_rig(matcam.Rig(camera, matcam.Sphere(256.0, 30.0), lamp, lamp_azimuth=0.7))
    with pytest.raises(matcam.MatcamError, match="must be a Sphere or a Cylinder"):
        check_rig(matcam.Rig(camera, matcam.Flat()))


def test_the_first_pages_name_files_that_are_there():
    """`make demo` writes into demo/; a star is measured where its chart is given."""
    assert "matcam correct demo/simulated-chromium.binary" in (ROOT / "docs" / "index.md").read_text()
    assert "matcam calibrate photographs/ --chart chart.json" in (ROOT / "README.md").read_text()


def test_bad_links_and_outside_loads_are_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="b.html">gone</a><a href="#there">gone</a><a href="#here">good</a>'
        '<script src="https://cdn.example/x.js"></script><img src="c.png"><a href="https://example.org">good</a>'
    )
    (tmp_path / "s.css").write_text("@font-face { src: url(https://fonts.example/a.woff2) }")
    found = docs_check.faults(tmp_path)
    assert len(found) == 5
    for words in ("b.html: there is no such file", "#there", "loads https://cdn", "c.png: there is no", "s.css: loads"):
        assert any(words in line for line in found), words
