"""Sphinx extension of the site: generated pages, MathJax from an installed package, and checks of citations and links."""

from importlib import metadata
from pathlib import Path

from sphinx.errors import ExtensionError
from sphinx.util.fileutil import copy_asset

import docs_api
import docs_check
import docs_cites
import docs_claims
import docs_commands
import docs_messages
import docs_results


def generate(app):
    """Write the generated pages, and check the citations of the others.

    Sphinx reads the pages afterwards.
    """
    source = Path(app.srcdir)
    try:
        docs_api.write(source / "reference" / "api")
    except docs_api.UndocumentedError as error:
        raise ExtensionError(str(error)) from error
    docs_commands.write(source / "reference" / "commands")
    docs_messages.write(source / "reference" / "messages.md")
    docs_claims.write(source / "understand" / "trust.md")
    docs_results.write(source / "validation")
    if faults := docs_cites.faults():
        raise ExtensionError("pages cite names that do not exist:\n" + "\n".join(faults))


def mathjax():
    """Return the self-contained file of MathJax from the package sphinx-mathjax-offline."""
    for file in metadata.files("sphinx-mathjax-offline") or ():
        if file.name == "tex-svg.js":
            return Path(str(file.locate()))
    raise ExtensionError("sphinx-mathjax-offline has no tex-svg.js: install matcam[docs]")


def finish(app, error):
    """Copy MathJax and the schemas, then check the links of the whole site."""
    if error is None and app.builder.name == "html":
        copy_asset(str(mathjax()), str(Path(app.outdir) / "_static"))
        for schema in Path(app.srcdir).glob("*.schema.json"):
            copy_asset(str(schema), app.outdir)
        if faults := docs_check.faults(Path(app.outdir)):
            raise ExtensionError("the site has invalid links, or loads files from other sites:\n" + "\n".join(faults))


def setup(app):
    """Connect the functions to the events of a build."""
    app.connect("builder-inited", generate, priority=100)  # before the gallery
    app.connect("build-finished", finish)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
