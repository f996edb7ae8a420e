"""Check of the built site: every local link has a target, and no resource is loaded from another site."""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADS = {("script", "src"), ("img", "src"), ("link", "href"), ("iframe", "src"), ("source", "src"), ("object", "data")}
_NO_LOADS = {"canonical", "next", "prev", "index", "search", "author", "license", "copyright", "genindex"}


class _Page(HTMLParser):
    def __init__(self):
        super().__init__()
        self.links, self.loads, self.anchors = [], [], set()

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        for name, key in _LOADS:
            if tag == name and given.get(key) and not _NO_LOADS & set((given.get("rel") or "").split()):
                self.loads.append(given[key])


def read(root):
    """Read the pages of a site, {path: page}."""
    pages = {}
    for path in sorted(p for p in root.rglob("*.html") if "_static" not in p.parts):
        page = _Page()
        page.feed(path.read_text(encoding="utf-8"))
        pages[path.resolve()] = page
    return pages


def faults(root):
    """List local links without a target, and resources from other sites."""
    root = root.resolve()
    pages, found = read(root), []
    for path, page in pages.items():
        where = path.relative_to(root)
        for address in page.loads:
            if urlsplit(address).scheme in ("http", "https") or address.startswith("//"):
                found.append(f"{where}: loads {address} from another site: include the file in the site")
        for address in [*page.links, *page.loads]:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                found.append(f"{where}: {address}: there is no such file")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                found.append(f"{where}: {address}: the page has no such anchor")
    for style in sorted(root.rglob("*.css")):
        for address in re.findall(r"url\(\s*['\"]?(https?:|//)[^)]*\)", style.read_text(encoding="utf-8")):
            found.append(f"{style.relative_to(root)}: loads {address} from another site: include the file in the site")
    return found


if __name__ == "__main__":
    lines = faults(Path(sys.argv[1]))
    print("\n".join(lines) or "every local link has a target, and no resource is loaded from another site")
    sys.exit(bool(lines))
