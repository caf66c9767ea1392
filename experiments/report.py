"""All tables and figures anew, from experiments/data alone. Trains nothing.

With --check nothing is written; the status is 1 if a table of the pages is not that of the data.
"""

import importlib
import re
import sys

import pages
import study

STUDIES = ("returns", "last_std", "published", "settings", "race", "speed", "processes",
           "baselines", "robustness", "ablation", "exercises", "more_seeds")


def tables():
    """{name: table} of all studies; their figures are drawn."""
    found = {}
    for name in STUDIES:
        found |= importlib.import_module(name).draw(study.read(name))
    return found


def check():
    """Exits with the names of the tables that the pages show in another form."""
    pages.save = lambda *_: None
    made = tables()
    shown = re.findall(r"<!-- (.+) -->\n\n((?:\|.*\n)+)",
                       "".join(page.read_text("utf-8") for page in pages.files()))
    sys.exit(", ".join(name for name, table in shown if table != made[name]) or 0)


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        check()
    pages.write_tables(tables())
