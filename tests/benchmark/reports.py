"""Figures and tables of README and docs, from the rows in docs/data alone.

A table stands between <!-- report: STUDY.NAME … --> and <!-- end -->. In its mark, and in the
metadata of a figure, stands a fingerprint of the rows and the code that it was made from.
"""

import hashlib
import importlib
import inspect
import re

from benchmark import common
from PIL import Image

MARKED = re.compile(r"<!-- report: (\w+)\.(\w+) (\S+) -->\n(.*?)<!-- end -->", re.DOTALL)


def fingerprint(*texts):
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:12]


def studies(names):
    """Those that have rows: name, module, path of the rows, fingerprint of what they show."""
    for name in names:
        path = common.DATA / f"{name}.csv"
        if path.exists():
            study = importlib.import_module(f"benchmark.{name}")
            code = inspect.getsource(study), inspect.getsource(common)
            yield name, study, path, fingerprint(path.read_text("utf-8"), *code)


def documents():
    return [common.ROOT / "README.md", *sorted(common.DOCS.glob("*.md"))]


def drawn_from(picture):
    """The fingerprint in a figure, or None."""
    if not picture.exists():
        return None
    with Image.open(picture) as image:
        return image.info.get("Source")


def stale(names):
    """What is not up to date."""
    found, text = [], "".join(x.read_text("utf-8") for x in documents())
    for name, study, _, source in studies(names):
        for document in documents():
            for owner, table, mark, inside in MARKED.findall(document.read_text("utf-8")):
                if owner == name and mark != f"{source}-{fingerprint(inside)}":
                    found.append(f"{document.name}: table {name}.{table}")
        found += [f"docs/{picture}.png" for picture in study.FIGURES if f"{picture}.png" in text
                  and drawn_from(common.DOCS / f"{picture}.png") != source]
    return found


def report(names):
    """Make all figures and tables of each study of which something is not up to date."""
    common.style()
    for name, study, path, source in studies(names):
        data, machines = common.read_rows(path)
        if "digest" in data and (count := sum(~common.is_current(data))):
            print(f"{path.name}: {count} of {len(data)} rows are of another text of their script")
        if stale([name]):
            tables = study.report(data, lambda figure, picture, source=source: figure.savefig(
                common.DOCS / f"{picture}.png", metadata={"Source": source}))
            tables["machine"] = "\n".join(f"- {x}" for x in machines)
            for picture in study.FIGURES:
                link = f"![{picture.replace('_', ' ')}]({picture}.png)"
                tables[picture] = link if (common.DOCS / f"{picture}.png").exists() else ""
            for document in documents():
                write_tables(document, name, tables, source)


def write_tables(document, study, tables, source):
    """Put the tables of a study between their marks."""

    def replaced(match):
        owner, name, _, _ = match.groups()
        if owner != study:
            return match.group()
        text = f"\n{tables[name]}\n\n"
        mark = f"{source}-{fingerprint(text)}"
        return f"<!-- report: {owner}.{name} {mark} -->\n{text}<!-- end -->"

    old = document.read_text("utf-8")
    new = MARKED.sub(replaced, old)
    if new != old:
        document.write_text(new, encoding="utf-8")
